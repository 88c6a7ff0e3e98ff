#include "effigy/body/view.h"

#include <algorithm>

namespace effigy {
namespace {

constexpr int kMargin = 8;  // pixels around the mask, where Gaussians must not be

struct Box {
  int x0, y0, x1, y1;
};

Box box_of(const Image8& mask) {
  Box box{mask.width, mask.height, 0, 0};
  for (int y = 0; y < mask.height; ++y)
    for (int x = 0; x < mask.width; ++x)
      if (*mask.at(x, y) > 0)
        box = {std::min(box.x0, x), std::min(box.y0, y), std::max(box.x1, x + 1),
               std::max(box.y1, y + 1)};
  if (box.x0 >= box.x1) return {0, 0, mask.width, mask.height};
  return {std::max(box.x0 - kMargin, 0), std::max(box.y0 - kMargin, 0),
          std::min(box.x1 + kMargin, mask.width), std::min(box.y1 + kMargin, mask.height)};
}

// A part of [low, high) of at most `size`.
void shorten(int size, Random& random, int& low, int& high) {
  if (high - low <= size) return;
  low += static_cast<int>(random.below(static_cast<uint64_t>(high - low - size + 1)));
  high = low + size;
}

}  // namespace

BodyView load_body_view(const StageCapture& capture, int frame, int camera, int crop,
                        Random& random) {
  const Image8 image = capture.load_image(camera, frame), mask = capture.load_mask(camera, frame);
  Box box = box_of(mask);
  if (crop > 0) {
    shorten(crop, random, box.x0, box.x1);
    shorten(crop, random, box.y0, box.y1);
  }
  const int width = box.x1 - box.x0, height = box.y1 - box.y0;
  BodyView view;
  view.x = box.x0;
  view.y = box.y0;
  view.camera = capture.cameras[static_cast<size_t>(camera)].camera.cropped(box.x0, box.y0, width,
                                                                            height, width, height);
  view.target.display = capture.display;
  view.target.image = Planes(width, height, 3);
  view.target.mask.resize(view.target.image.pixels());
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      const size_t p = static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x);
      const uint8_t* pixel = image.at(box.x0 + x, box.y0 + y);
      for (int c = 0; c < 3; ++c)
        view.target.image.plane(c)[p] = static_cast<float>(pixel[c]) / 255;
      view.target.mask[p] = static_cast<float>(*mask.at(box.x0 + x, box.y0 + y)) / 255;
    }
  return view;
}

}  // namespace effigy
