// L1 over the bands of a Laplacian pyramid (Burt and Adelson 1983) of the difference of two images:
// errors of every size count alike, so that a small shift or a blur is seen where plain L1 hardly
// changes.
#pragma once

#include "effigy/image/image.h"

namespace effigy {

// Levels halve (rounding up) by the binomial kernel 1 4 6 4 1 with repeated borders. The loss is
// the mean over levels of the mean absolute value of the band (the last level is the low-pass
// rest). Adds `weight` times its gradient to the first `channels` planes of d_colour when that is
// not null; the gradient of |x| at 0 is 0. Images have the same size and at least `channels`
// planes. Results do not depend on the thread count.
double pyramid_loss(const Planes& colour, const Planes& target, int channels, int levels,
                    float weight, Planes* d_colour);

}  // namespace effigy
