#include "effigy/track/face.h"

#include <algorithm>
#include <cmath>

#include "effigy/base/error.h"
#include "effigy/base/threads.h"
#include "effigy/track/mediapipe.h"

namespace effigy {
namespace {

constexpr int kDetectorSide = 128;
constexpr double kLeastScore = 0.5;
constexpr double kLeastPresence = 0.5;
constexpr double kRegionScale = 1.5;        // MediaPipe's margin around a face
constexpr int kLookForOthers = 25;          // frames between looks for further people
constexpr double kSmallestOther = 1.0 / 3;  // of the followed face
constexpr double kOtherPresence = 0.8;
constexpr int kThoroughEvery = 8;  // lost frames between thorough searches

// Samples a turned square of the frame into side x side RGB floats = value * gain + offset,
// averaging n x n samples a pixel when shrinking. Outside the frame: the edge, or `outside` when >=
// 0.
void sample_square(const Image8& frame, double cx, double cy, double side, double angle, int size,
                   float gain, float offset, int outside, float* out) {
  const double scale = side / size;
  const int samples = std::clamp(static_cast<int>(std::ceil(scale / 1.5)), 1, 8);
  const double step = scale / samples;
  const float cosine = static_cast<float>(std::cos(angle) * step);
  const float sine = static_cast<float>(std::sin(angle) * step);
  const int total = size * samples;
  const float weight = gain / static_cast<float>(samples * samples);
  const int width = frame.width, height = frame.height;
  parallel_for(static_cast<size_t>(size), 32, [&](size_t first, size_t last, int) {
    std::fill(out + first * size * 3, out + last * size * 3, offset);
    for (int v = static_cast<int>(first) * samples; v < static_cast<int>(last) * samples; ++v) {
      float* row = out + static_cast<size_t>(v / samples) * size * 3;
      const float dv = static_cast<float>(v) + 0.5f - 0.5f * static_cast<float>(total);
      for (int u = 0; u < total; ++u) {
        const float du = static_cast<float>(u) + 0.5f - 0.5f * static_cast<float>(total);
        const float x = static_cast<float>(cx) + cosine * du - sine * dv - 0.5f;
        const float y = static_cast<float>(cy) + sine * du + cosine * dv - 0.5f;
        float* pixel = row + (u / samples) * 3;
        if (outside >= 0 && (x < -0.5f || y < -0.5f || x > static_cast<float>(width) - 0.5f ||
                             y > static_cast<float>(height) - 0.5f)) {
          for (int c = 0; c < 3; ++c) pixel[c] += weight * static_cast<float>(outside);
          continue;
        }
        const float xc = std::clamp(x, 0.0f, static_cast<float>(width - 1));
        const float yc = std::clamp(y, 0.0f, static_cast<float>(height - 1));
        const int x0 = static_cast<int>(xc), y0 = static_cast<int>(yc);
        const int x1 = std::min(x0 + 1, width - 1), y1 = std::min(y0 + 1, height - 1);
        const float fx = xc - static_cast<float>(x0), fy = yc - static_cast<float>(y0);
        const uint8_t *a = frame.at(x0, y0), *b = frame.at(x1, y0);
        const uint8_t *c0 = frame.at(x0, y1), *d = frame.at(x1, y1);
        const float wa = (1 - fx) * (1 - fy) * weight, wb = fx * (1 - fy) * weight;
        const float wc = (1 - fx) * fy * weight, wd = fx * fy * weight;
        for (int c = 0; c < 3; ++c)
          pixel[c] += wa * static_cast<float>(a[c]) + wb * static_cast<float>(b[c]) +
                      wc * static_cast<float>(c0[c]) + wd * static_cast<float>(d[c]);
      }
    }
  });
}

double sigmoid(double x) {
  return 1.0 / (1.0 + std::exp(-std::clamp(x, -100.0, 100.0)));
}

// BlazeFace short range: 16x16 cells with 2 anchors, then 8x8 cells with 6, all of unit size.
struct Anchor {
  double x, y;
};
std::vector<Anchor> anchors() {
  std::vector<Anchor> result;
  for (const auto& [cells, copies] : {std::pair{16, 2}, std::pair{8, 6}})
    for (int y = 0; y < cells; ++y)
      for (int x = 0; x < cells; ++x)
        for (int copy = 0; copy < copies; ++copy)
          result.push_back({(x + 0.5) / cells, (y + 0.5) / cells});
  return result;
}

double overlap_of(const FaceBox& a, const FaceBox& b) {
  const double w = std::min(a.x + a.width, b.x + b.width) - std::max(a.x, b.x);
  const double h = std::min(a.y + a.height, b.y + b.height) - std::max(a.y, b.y);
  if (w <= 0 || h <= 0) return 0;
  const double both = w * h;
  return both / (a.width * a.height + b.width * b.height - both);
}

Network load(const std::vector<uint8_t>& bytes, const std::string& name,
             const std::vector<int64_t>& input, size_t outputs) {
  Network network = Network::from_tflite(bytes, name);
  if (network.input_shapes().size() != 1 || network.input_shapes()[0] != input ||
      network.output_shapes().size() < outputs)
    throw Error(name +
                ": not the expected network (its input or outputs have another shape); "
                "replace it by the published file.");
  return network;
}

Network load_landmarks(const ModelSet& models) {
  const int64_t side = models.landmark_count == 478 ? 256 : 192;
  return load(models.landmarks, "the landmark network of " + models.landmarks_path.string(),
              {1, side, side, 3}, 2);
}

}  // namespace

std::vector<FaceBox> suppress_overlaps(std::vector<FaceBox> boxes, double overlap) {
  std::stable_sort(boxes.begin(), boxes.end(),
                   [](const FaceBox& a, const FaceBox& b) { return a.score > b.score; });
  std::vector<FaceBox> kept;
  while (!boxes.empty()) {
    const FaceBox best = boxes.front();
    FaceBox mean;
    double weight = 0;
    std::vector<FaceBox> rest;
    for (const FaceBox& box : boxes) {
      if (overlap_of(best, box) <= overlap) {
        rest.push_back(box);
        continue;
      }
      weight += box.score;
      mean.x += box.score * box.x;
      mean.y += box.score * box.y;
      mean.width += box.score * box.width;
      mean.height += box.score * box.height;
      for (int k = 0; k < 6; ++k)
        for (int c = 0; c < 2; ++c) mean.points[k][c] += box.score * box.points[k][c];
    }
    if (weight <= 0) break;  // the rest are boxes without area
    mean.x /= weight;
    mean.y /= weight;
    mean.width /= weight;
    mean.height /= weight;
    for (auto& point : mean.points)
      for (double& value : point) value /= weight;
    mean.score = best.score;
    kept.push_back(mean);
    boxes = std::move(rest);
  }
  return kept;
}

FaceDetector::FaceDetector(const ModelSet& models)
    : network_(load(models.detector, "the face detector of " + models.landmarks_path.string(),
                    {1, kDetectorSide, kDetectorSide, 3}, 2)),
      input_({1, kDetectorSide, kDetectorSide, 3}) {
  const auto& shapes = network_.output_shapes();
  if (shapes[0] != std::vector<int64_t>{1, 896, 16} || shapes[1] != std::vector<int64_t>{1, 896, 1})
    throw Error(network_.name() +
                ": not BlazeFace short range (its outputs have another shape); replace it by the "
                "published file.");
}

std::vector<FaceBox> FaceDetector::detect_in(const Image8& frame, double x, double y, double side) {
  sample_square(frame, x + 0.5 * side, y + 0.5 * side, side, 0, kDetectorSide, 2.0f / 255.0f, -1.0f,
                0, input_.data.data());
  static const std::vector<Anchor> kAnchors = anchors();
  const std::vector<Array> outputs = network_.run({input_});
  std::vector<FaceBox> boxes;
  for (size_t a = 0; a < kAnchors.size(); ++a) {
    const double score = sigmoid(outputs[1].data[a]);
    if (!(score >= kLeastScore)) continue;
    const float* raw = outputs[0].data.data() + 16 * a;
    const auto px = [&](double value) {
      return x + (value / kDetectorSide + kAnchors[a].x) * side;
    };
    const auto py = [&](double value) {
      return y + (value / kDetectorSide + kAnchors[a].y) * side;
    };
    FaceBox box;
    box.score = score;
    box.width = raw[2] / kDetectorSide * side;
    box.height = raw[3] / kDetectorSide * side;
    if (!(box.width > 0 && box.height > 0)) continue;
    box.x = px(raw[0]) - 0.5 * box.width;
    box.y = py(raw[1]) - 0.5 * box.height;
    for (int k = 0; k < 6; ++k) {
      box.points[k][0] = px(raw[4 + 2 * k]);
      box.points[k][1] = py(raw[5 + 2 * k]);
    }
    boxes.push_back(box);
  }
  return boxes;
}

std::vector<FaceBox> FaceDetector::detect(const Image8& frame, bool thorough) {
  const double longer = std::max(frame.width, frame.height);
  const double shorter = std::min(frame.width, frame.height);
  const auto whole = [&] {
    return detect_in(frame, 0.5 * (frame.width - longer), 0.5 * (frame.height - longer), longer);
  };
  std::vector<FaceBox> boxes = suppress_overlaps(whole(), 0.3);
  if (!boxes.empty() || !thorough) return boxes;
  for (const double side : {shorter, 0.6 * shorter}) {
    const int columns = std::max(1, static_cast<int>(std::ceil(1.6 * frame.width / side - 0.61)));
    const int rows = std::max(1, static_cast<int>(std::ceil(1.6 * frame.height / side - 0.61)));
    for (int r = 0; r < rows; ++r)
      for (int c = 0; c < columns; ++c) {
        const double x =
            columns == 1 ? 0.5 * (frame.width - side) : (frame.width - side) * c / (columns - 1);
        const double y =
            rows == 1 ? 0.5 * (frame.height - side) : (frame.height - side) * r / (rows - 1);
        const std::vector<FaceBox> part = detect_in(frame, x, y, side);
        boxes.insert(boxes.end(), part.begin(), part.end());
      }
    boxes = suppress_overlaps(std::move(boxes), 0.3);
    if (!boxes.empty()) break;
  }
  return boxes;
}

FaceTracker::FaceTracker(const ModelSet& models)
    : detector_(models),
      landmarks_(load_landmarks(models)),
      input_(landmarks_.input_shapes()[0]),
      landmark_count_(models.landmark_count) {
  if (landmarks_.output_shapes()[0].back() != 3 * landmark_count_)
    throw Error(landmarks_.name() + ": it does not give " + std::to_string(landmark_count_) +
                " points; replace it by the published file.");
  if (!models.blendshapes.empty()) {
    blendshapes_ =
        load(models.blendshapes, "the blendshape network of " + models.landmarks_path.string(),
             {1, 146, 2}, 1);
    if (blendshapes_->output_shapes()[0] != std::vector<int64_t>{52})
      throw Error(blendshapes_->name() +
                  ": it does not give 52 scores; replace it by the published file.");
  }
}

FaceTracker::Region FaceTracker::region_of(const FaceBox& box) {
  Region region;
  region.x = box.x + 0.5 * box.width;
  region.y = box.y + 0.5 * box.height;
  region.side = kRegionScale * std::max(box.width, box.height);
  region.angle =
      std::atan2(box.points[1][1] - box.points[0][1], box.points[1][0] - box.points[0][0]);
  return region;
}

// The square around the points, turned by the line through the outer corners of the eyes.
FaceTracker::Region FaceTracker::region_of(const std::vector<float>& landmarks) const {
  const float* right = landmarks.data() + 3 * mediapipe::kOuterCornerRight;
  const float* left = landmarks.data() + 3 * mediapipe::kOuterCornerLeft;
  Region region;
  region.angle = std::atan2(left[1] - right[1], left[0] - right[0]);
  const double cosine = std::cos(region.angle), sine = std::sin(region.angle);
  double low[2] = {1e30, 1e30}, high[2] = {-1e30, -1e30};
  for (int i = 0; i < std::min(landmark_count_, mediapipe::kFirstIris); ++i) {
    const double x = landmarks[3 * i], y = landmarks[3 * i + 1];
    const double u[2] = {cosine * x + sine * y, -sine * x + cosine * y};
    for (int c = 0; c < 2; ++c) {
      low[c] = std::min(low[c], u[c]);
      high[c] = std::max(high[c], u[c]);
    }
  }
  const double cu = 0.5 * (low[0] + high[0]), cv = 0.5 * (low[1] + high[1]);
  region.x = cosine * cu - sine * cv;
  region.y = sine * cu + cosine * cv;
  region.side = kRegionScale * std::max(high[0] - low[0], high[1] - low[1]);
  return region;
}

bool FaceTracker::measure(const Image8& frame, const Region& region, FaceObservation& observation) {
  if (!(region.side >= 8) || region.side > 8.0 * std::max(frame.width, frame.height)) return false;
  const int size = static_cast<int>(input_.shape[1]);
  sample_square(frame, region.x, region.y, region.side, region.angle, size, 1.0f / 255.0f, 0.0f, -1,
                input_.data.data());
  const std::vector<Array> outputs = landmarks_.run({input_});
  observation.presence = sigmoid(outputs[1].data[0]);
  if (!(observation.presence >= kLeastPresence)) return false;
  const double scale = region.side / size;
  const double cosine = std::cos(region.angle) * scale, sine = std::sin(region.angle) * scale;
  observation.landmarks.resize(3 * static_cast<size_t>(landmark_count_));
  for (int i = 0; i < landmark_count_; ++i) {
    const float* raw = outputs[0].data.data() + 3 * i;
    const double u = raw[0] - 0.5 * size, v = raw[1] - 0.5 * size;
    observation.landmarks[3 * i] = static_cast<float>(region.x + cosine * u - sine * v);
    observation.landmarks[3 * i + 1] = static_cast<float>(region.y + sine * u + cosine * v);
    observation.landmarks[3 * i + 2] = static_cast<float>(raw[2] * scale);
  }
  for (const float value : observation.landmarks)
    if (!std::isfinite(value)) return false;
  // A face whose middle lies outside the picture has left it.
  const Region found = region_of(observation.landmarks);
  return found.x >= 0 && found.y >= 0 && found.x <= frame.width && found.y <= frame.height;
}

void FaceTracker::score(FaceObservation& observation) {
  if (!blendshapes_ || !observation.found) return;
  Array points({1, 146, 2});
  for (size_t i = 0; i < mediapipe::kBlendshapeInput.size(); ++i)
    for (int c = 0; c < 2; ++c)
      points.data[2 * i + c] = observation.landmarks[3 * mediapipe::kBlendshapeInput[i] + c];
  observation.scores = blendshapes_->run({points})[0].data;
  for (float& value : observation.scores)
    value = std::isfinite(value) ? std::clamp(value, 0.0f, 1.0f) : 0.0f;
}

std::optional<FaceBox> FaceTracker::choose(const std::vector<FaceBox>& boxes,
                                           const Image8& frame) const {
  const double diagonal = std::hypot(frame.width, frame.height);
  std::optional<FaceBox> best;
  double best_value = -1;
  for (const FaceBox& box : boxes) {
    const double x = box.x + 0.5 * box.width, y = box.y + 0.5 * box.height;
    double value;
    if (last_known_) {
      // The one where the face was last; the longer ago, the wider the search.
      const double reach = (0.5 + 0.1 * lost_) * last_known_->side;
      const double distance = std::hypot(x - last_known_->x, y - last_known_->y);
      const double growth = std::log(kRegionScale * box.width / last_known_->side);
      if (distance > reach && lost_ < 30) continue;
      value = std::exp(-distance / reach - std::abs(growth));
    } else {
      const double off = std::hypot(x - 0.5 * frame.width, y - 0.5 * frame.height) / diagonal;
      value = box.width * box.height * (1.0 - off);
    }
    if (value > best_value) {
      best_value = value;
      best = box;
    }
  }
  return best;
}

// The followed face and the others beside it.
int FaceTracker::count_faces(const Image8& frame, const Region& followed) {
  int count = 1;
  for (const FaceBox& box : detector_.detect(frame, false)) {
    const Region region = region_of(box);
    const double distance = std::hypot(region.x - followed.x, region.y - followed.y);
    if (region.side < kSmallestOther * followed.side || distance < 0.5 * followed.side) continue;
    FaceObservation other;
    if (measure(frame, region, other) && other.presence >= kOtherPresence) ++count;
  }
  return count;
}

FaceObservation FaceTracker::observe(const Image8& frame) {
  FaceObservation observation = locate(frame);
  score(observation);
  return observation;
}

FaceObservation FaceTracker::locate(const Image8& frame) {
  EFFIGY_CHECK_EQ(frame.channels, 3);
  FaceObservation observation;
  if (next_) observation.found = measure(frame, *next_, observation);
  if (!observation.found) {
    const bool thorough = lost_ % kThoroughEvery == 0;
    const std::vector<FaceBox> boxes = detector_.detect(frame, thorough);
    if (const auto box = choose(boxes, frame)) {
      observation.found = measure(frame, region_of(*box), observation);
      // A second look from the points themselves: the detector's box is coarse.
      if (observation.found)
        observation.found = measure(frame, region_of(observation.landmarks), observation);
    }
  }
  if (!observation.found) {
    ++lost_;
    next_.reset();
    observation.landmarks.clear();
    return observation;
  }
  lost_ = 0;
  next_ = region_of(observation.landmarks);
  last_known_ = next_;
  if (frame_++ % kLookForOthers == 0) {
    observation.faces = count_faces(frame, *next_);
    most_faces_ = std::max(most_faces_, observation.faces);
    if (observation.faces > 1) ++crowded_looks_;
  }
  return observation;
}

void smooth_landmarks(std::vector<FaceObservation>& frames, double sigma, double scale) {
  if (sigma <= 0 || frames.empty()) return;
  const int reach = static_cast<int>(std::ceil(2.5 * sigma));
  const int count = static_cast<int>(frames.size());
  std::vector<std::vector<float>> smooth(frames.size());
  for (int f = 0; f < count; ++f) {
    if (!frames[f].found) continue;
    const std::vector<float>& here = frames[f].landmarks;
    std::vector<double> sum(here.begin(), here.end());
    std::vector<double> weight(here.size() / 3, 1.0);
    for (int side = -1; side <= 1; side += 2)
      for (int d = 1; d <= reach; ++d) {
        const int g = f + side * d;
        if (g < 0 || g >= count || !frames[g].found) break;
        const std::vector<float>& there = frames[g].landmarks;
        const double near = std::exp(-0.5 * d * d / (sigma * sigma));
        for (size_t i = 0; i < weight.size(); ++i) {
          const double dx = there[3 * i] - here[3 * i], dy = there[3 * i + 1] - here[3 * i + 1];
          const double w = near * std::exp(-0.5 * (dx * dx + dy * dy) / (scale * scale));
          weight[i] += w;
          for (int c = 0; c < 3; ++c) sum[3 * i + c] += w * there[3 * i + c];
        }
      }
    smooth[f].resize(here.size());
    for (size_t i = 0; i < here.size(); ++i)
      smooth[f][i] = static_cast<float>(sum[i] / weight[i / 3]);
  }
  for (int f = 0; f < count; ++f)
    if (frames[f].found) frames[f].landmarks = std::move(smooth[f]);
}

}  // namespace effigy
