#include "effigy/track/torso.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "effigy/image/resample.h"
#include "effigy/track/mediapipe.h"
#include "effigy/track/photo.h"

namespace effigy {
namespace {

constexpr int kForehead = 10, kChin = 152;
constexpr double kEyeSpan = 32;  // working pixels between the outer corners of the eyes
constexpr size_t kMostPixels = 3000;
constexpr double kLeastPixels = 300;
constexpr double kLeastGradient = 0.006;  // per working pixel, of values in [0, 1]
constexpr double kLeastCorrelation = 0.6;
constexpr int kCoarseSteps = 8, kFineSteps = 10;

Vec2d landmark(const FaceObservation& face, int point) {
  const float* p = face.landmarks.data() + 3 * static_cast<size_t>(point);
  return {p[0], p[1]};
}

// The least of the segmentation around a point, so that the person's outline, which borders on a
// background that stands still, does not count.
double surely_person(const Image& person, double x, double y) {
  float least = 1;
  for (const double dx : {-3.0, 0.0, 3.0})
    for (const double dy : {-3.0, 0.0, 3.0}) {
      float value = 0;
      sample_bilinear(person, x + dx, y + dy, &value);
      least = std::min(least, value);
    }
  return std::clamp((least - 0.5) / 0.4, 0.0, 1.0);
}

float median_magnitude(std::vector<float> values) {
  for (float& v : values) v = std::abs(v);
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace

Image TorsoFollower::window(const Image8& picture) const {
  return grey_part(picture, left_, top_, width_, height_, columns_, rows_);
}

void TorsoFollower::begin(const Image8& picture, const FaceObservation& face) {
  const Vec2d chin = landmark(face, kChin);
  const double tall = (chin - landmark(face, kForehead)).norm();
  const double span =
      (landmark(face, mediapipe::kOuterCornerRight) - landmark(face, mediapipe::kOuterCornerLeft))
          .norm();
  if (!(span > 4)) return;
  scale_ = std::min(kEyeSpan / span, 1.0);
  left_ = std::clamp(chin.x() - 1.7 * tall, 0.0, picture.width - 1.0);
  top_ = std::clamp(chin.y() - 0.1 * tall, 0.0, picture.height - 1.0);
  width_ = std::clamp(chin.x() + 1.7 * tall, left_ + 1, 1.0 * picture.width) - left_;
  height_ = std::clamp(chin.y() + 1.4 * tall, top_ + 1, 1.0 * picture.height) - top_;
  columns_ = static_cast<int>(std::lround(width_ * scale_));
  rows_ = static_cast<int>(std::lround(height_ * scale_));
  if (columns_ < 24 || rows_ < 12) return;
  const Image grey = window(picture);
  const Image person = segmenter_ != nullptr ? segmenter_->segment(picture) : Image();

  std::vector<Level> levels;
  for (const double sigma : {3.0, 1.0}) {
    const Image smooth = gaussian_blur(grey, sigma);
    struct Pixel {
      float strength, weight, gx, gy;
      int x, y;
    };
    std::vector<Pixel> pixels;
    for (int y = 2; y < rows_ - 2; ++y)
      for (int x = 2; x < columns_ - 2; ++x) {
        const float gx = 0.5f * (*smooth.at(x + 1, y) - *smooth.at(x - 1, y));
        const float gy = 0.5f * (*smooth.at(x, y + 1) - *smooth.at(x, y - 1));
        const float gradient = std::hypot(gx, gy);
        if (gradient < kLeastGradient) continue;
        const double px = left_ + (x + 0.5) / scale_, py = top_ + (y + 0.5) / scale_;
        // The neck's skin turns with the head: what is close below the chin counts little.
        double weight = std::clamp((py - chin.y() - 0.05 * tall) / (0.3 * tall), 0.0, 1.0);
        if (!person.data.empty() && weight > 0)
          weight *= surely_person(person, px * person.width / picture.width,
                                  py * person.height / picture.height);
        if (weight > 0.02)
          pixels.push_back(
              {gradient * static_cast<float>(weight), static_cast<float>(weight), gx, gy, x, y});
      }
    if (pixels.size() < kLeastPixels) return;
    if (pixels.size() > kMostPixels) {
      std::nth_element(pixels.begin(), pixels.begin() + kMostPixels, pixels.end(),
                       [](const Pixel& a, const Pixel& b) {
                         return a.strength != b.strength ? a.strength > b.strength
                                                         : (a.y != b.y ? a.y < b.y : a.x < b.x);
                       });
      pixels.resize(kMostPixels);
    }
    Level level;
    level.sigma = sigma;
    if (levels.empty()) {
      center_.setZero();
      for (const Pixel& p : pixels) center_ += Vec2d(p.x + 0.5, p.y + 0.5);
      center_ /= static_cast<double>(pixels.size());
    }
    for (const Pixel& p : pixels) {
      const float x = static_cast<float>(p.x + 0.5 - center_.x());
      const float y = static_cast<float>(p.y + 0.5 - center_.y());
      level.x.push_back(x);
      level.y.push_back(y);
      level.value.push_back(*smooth.at(p.x, p.y));
      level.weight.push_back(p.weight);
      level.along[0].push_back(p.gx * x + p.gy * y);
      level.along[1].push_back(p.gy * x - p.gx * y);
      level.along[2].push_back(p.gx);
      level.along[3].push_back(p.gy);
    }
    levels.push_back(std::move(level));
  }
  levels_ = std::move(levels);
  last_ = {};
}

// Improves `motion`; false when the picture does not look like the first view any more.
bool TorsoFollower::align(const Level& level, const Image& image, int steps,
                          PlaneSimilarity& motion) const {
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  const size_t n = level.x.size();
  std::vector<float> residual(n), seen(n);
  double gain = 1, offset = 0, correlation = 0;
  for (int step = 0; step < steps; ++step) {
    for (size_t i = 0; i < n; ++i) {
      const double x = center_.x() + motion.a * level.x[i] - motion.b * level.y[i] + motion.u;
      const double y = center_.y() + motion.b * level.x[i] + motion.a * level.y[i] + motion.v;
      sample_bilinear(image, x, y, &seen[i]);
      residual[i] = seen[i] - static_cast<float>(gain * level.value[i] + offset);
    }
    const double reach = std::max(4.685 * 1.4826 * median_magnitude(residual), 0.01);
    Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Zero();
    Vector6 right = Vector6::Zero();
    double sums[6] = {};
    for (size_t i = 0; i < n; ++i) {
      const double r = residual[i] / reach;
      if (std::abs(r) >= 1) continue;
      const double tukey = (1 - r * r) * (1 - r * r), w = level.weight[i] * tukey;
      const double t = level.value[i], s = seen[i];
      Vector6 row;
      row << level.along[0][i], level.along[1][i], level.along[2][i], level.along[3][i], t, 1;
      normal.selfadjointView<Eigen::Lower>().rankUpdate(row, w);
      right += w * residual[i] * row;
      const double terms[6] = {1, t, s, t * t, s * s, t * s};
      for (int k = 0; k < 6; ++k) sums[k] += w * terms[k];
    }
    const double total = std::max(sums[0], 1e-9), mt = sums[1] / total, ms = sums[2] / total;
    correlation =
        (sums[5] / total - mt * ms) /
        std::sqrt(std::max((sums[3] / total - mt * mt) * (sums[4] / total - ms * ms), 1e-12));
    // The torso keeps its size more than its place: scale and turn are held a little.
    normal(0, 0) *= 1.02;
    normal(1, 1) *= 1.02;
    normal.diagonal().array() += 1e-6 * total;
    const Vector6 d = normal.selfadjointView<Eigen::Lower>().ldlt().solve(right);
    if (!d.allFinite()) return false;
    // motion <- motion after the inverse of the step.
    const double a = 1 + d[0], b = d[1], length = a * a + b * b;
    if (!(length > 0.25)) return false;
    const double ia = a / length, ib = -b / length;
    const double iu = -(ia * d[2] - ib * d[3]), iv = -(ib * d[2] + ia * d[3]);
    motion = {motion.a * ia - motion.b * ib, motion.b * ia + motion.a * ib,
              motion.a * iu - motion.b * iv + motion.u, motion.b * iu + motion.a * iv + motion.v};
    gain += d[4];
    offset += d[5];
    if (d.segment<2>(2).norm() < 0.003 && d.head<2>().norm() < 1e-4) break;
  }
  return correlation > kLeastCorrelation && std::abs(motion.a - 1) < 0.5 &&
         std::abs(motion.b) < 0.5;
}

TorsoMotion TorsoFollower::follow(const Image8& picture, const FaceObservation& face) {
  TorsoMotion result;
  if (levels_.empty()) {
    if (!face.found) return result;
    begin(picture, face);
    if (levels_.empty()) return result;
  }
  const Image grey = window(picture);
  PlaneSimilarity motion = last_;
  for (const Level& level : levels_) {
    const bool good = align(level, gaussian_blur(grey, level.sigma),
                            &level == &levels_.back() ? kFineSteps : kCoarseSteps, motion);
    result.found = good;
  }
  if (!result.found) {
    // Looked for where it was last, and at its first place when that fails for long.
    last_ = {0.9 * last_.a + 0.1, 0.9 * last_.b, 0.9 * last_.u, 0.9 * last_.v};
    return result;
  }
  last_ = motion;
  const Vec2d c = Vec2d(left_, top_) + center_ / scale_;
  result.here_from_start = {motion.a, motion.b,
                            c.x() - motion.a * c.x() + motion.b * c.y() + motion.u / scale_,
                            c.y() - motion.b * c.x() - motion.a * c.y() + motion.v / scale_};
  return result;
}

}  // namespace effigy
