// The processes of an MPI job (mpirun, srun). Only this part of the room knows MPI.
#pragma once

#include <memory>

#include "effigy/learn/ranks.h"

namespace effigy {

// The processes of the job that this one was started in; without touching MPI where job_size()
// is 1. Call once; MPI ends with the object.
std::unique_ptr<Ranks> start_ranks();

}  // namespace effigy
