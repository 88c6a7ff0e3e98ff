// Scenes described in JSON (docs/synth.md), for pictures of one's own meshes and for comparison
// with other renderers.
#pragma once

#include "effigy/base/file.h"
#include "effigy/synth/path_tracer.h"

namespace effigy {

struct DescribedScene {
  TraceScene scene;
  Camera camera;
  TraceOptions options;
};

// Files named in the description are relative to it. Throws Error naming file and field.
DescribedScene read_scene(const Path& path);

}  // namespace effigy
