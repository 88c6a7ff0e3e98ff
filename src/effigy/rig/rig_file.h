// Rigs on disk: our own rig.safetensors, and finding and loading the user's rigs.
#pragma once

#include "effigy/rig/rig.h"

namespace effigy {

// Our own format: everything in Rig, float32. Reading checks all of it.
Rig read_rig(const Path& path);
void write_rig(const Path& path, const Rig& rig);
// Bytes of that file, but for its names.
int64_t rig_file_bytes(const Rig& rig);

// A rig from anything we know: our .safetensors (or a folder, such as an avatar's, with
// rig.safetensors), a FLAME .pkl (rig/flame.h), a folder with ICT-FaceKit's packed file or the
// original repository's OBJ files (rig/ict.h). `models` may be empty; it may hold the MediaPipe
// geometry file used for ICT's landmark embeddings, and FLAME's UV layout. Throws Error for unknown
// ones.
Rig load_rig(const Path& path, const Path& models);

}  // namespace effigy
