#include "effigy/body/stage_views.h"

#include <algorithm>
#include <condition_variable>
#include <mutex>
#include <thread>
#include <utility>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/base/random.h"
#include "effigy/base/threads.h"

namespace effigy {
namespace {

constexpr int kAttempts = 64;          // views tried in place of a damaged one
constexpr size_t kTriedAtFirst = 100;  // before which missing views are measured against so many
constexpr int kBody = 128;             // of the mask: less is not the body
constexpr size_t kMaskDraws = 64;      // random pixels tried before the body's box does

using Transform = std::array<float, 12>;

Mat3d linear_of(const Transform& m) {
  Mat3d r;
  r << m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10];
  return r;
}

// Points moved by the inverse of `m`.
std::vector<float> moved_back(const Transform& m, const float* points, size_t count) {
  const Mat3d inverse = linear_of(m).inverse();
  const Vec3d from(m[3], m[7], m[11]);
  std::vector<float> out(3 * count);
  for (size_t i = 0; i < count; ++i) {
    const Vec3d moved = inverse * (Vec3f(&points[3 * i]).cast<double>() - from);
    for (size_t c = 0; c < 3; ++c) out[3 * i + c] = static_cast<float>(moved[c]);
  }
  return out;
}

struct Box {
  int left = 0, top = 0, right = 0, bottom = 0;  // the last two excluded
};

Box body_box(const Image8& mask) {
  Box box{mask.width, mask.height, 0, 0};
  for (int y = 0; y < mask.height; ++y)
    for (int x = 0; x < mask.width; ++x) {
      if (mask.at(x, y)[0] < kBody) continue;
      box.left = std::min(box.left, x);
      box.right = std::max(box.right, x + 1);
      box.top = std::min(box.top, y);
      box.bottom = std::max(box.bottom, y + 1);
    }
  if (box.left >= box.right) box = {0, 0, mask.width, mask.height};  // nothing of the body is seen
  return box;
}

int random_start(Random& random, int shown, int side, int size) {
  const int low = std::clamp(shown - side + 1, 0, size - side);
  const int high = std::clamp(shown, 0, size - side);
  return low + static_cast<int>(random.below(static_cast<uint64_t>(high - low + 1)));
}

Box crop_box(const Image8& mask, const StageCrop& crop, uint64_t number) {
  const int width = mask.width, height = mask.height;
  if (crop.side <= 0) {
    if (crop.border < 0) return {0, 0, width, height};
    const Box box = body_box(mask);
    return {std::max(box.left - crop.border, 0), std::max(box.top - crop.border, 0),
            std::min(box.right + crop.border, width), std::min(box.bottom + crop.border, height)};
  }
  const Box box = body_box(mask);
  Random random(crop.seed, number);
  int x = 0, y = 0;
  for (size_t draw = 0; draw < kMaskDraws; ++draw) {
    x = box.left + static_cast<int>(random.below(static_cast<uint64_t>(box.right - box.left)));
    y = box.top + static_cast<int>(random.below(static_cast<uint64_t>(box.bottom - box.top)));
    if (mask.at(x, y)[0] >= kBody) break;
  }
  const int w = std::min(crop.side, width), h = std::min(crop.side, height);
  const int left = random_start(random, x, w, width), top = random_start(random, y, h, height);
  return {left, top, left + w, top + h};
}

}  // namespace

StageSource::StageSource(const StageCapture& capture) : capture_(capture) {
  for (size_t f = 0; f < capture.frames.size(); ++f)
    for (const Transform* m : {&capture.body_from_rest[f], &capture.face_from_rest[f]})
      if (!(std::abs(linear_of(*m).determinant()) > 1e-6))
        throw Error((capture.folder / "tracking.safetensors").string() + ": frame " +
                    std::to_string(capture.frames[f].number) +
                    " has a root frame without an inverse; make the capture again.");
  Vec3d sum = Vec3d::Zero();
  size_t count = capture.body_keypoints.size() / 3;
  for (size_t i = 0; i < count; ++i) sum += Vec3f(&capture.body_keypoints[3 * i]).cast<double>();
  if (count == 0) {
    count = capture.lights.size();
    for (const StageLight& light : capture.lights) sum += light.position.cast<double>();
  }
  center_ = (sum / static_cast<double>(std::max<size_t>(count, 1))).cast<float>();
}

StageMoment StageSource::moment(int frame) const {
  const auto f = static_cast<size_t>(frame);
  const StageFrame& described = capture_.frames.at(f);
  StageMoment moment;
  moment.frame = frame;
  moment.vertices = load_frame_arrays(capture_, frame).tracked;
  const auto keypoints = [&](const std::vector<float>& all, size_t count, const Transform& m) {
    return moved_back(m, all.data() + 3 * count * f, count);
  };
  moment.body_keypoints = keypoints(capture_.body_keypoints, capture_.body_keypoint_names.size(),
                                    capture_.body_from_rest[f]);
  moment.face_keypoints = keypoints(capture_.face_keypoints, capture_.face_keypoint_names.size(),
                                    capture_.face_from_rest[f]);
  moment.lights.falloff = true;
  moment.lights.center = center_;
  for (const StageLight& light : capture_.lights_of(frame)) {
    const float distance = std::max((light.position - center_).squaredNorm(), 1e-12f);
    moment.lights.lights.push_back({light.position, light.intensity / distance, false});
  }
  moment.fully_lit = described.fully_lit;
  if (!described.environment.empty()) moment.environment = capture_.folder / described.environment;
  return moment;
}

std::array<float, 256> linear_table(DisplayTransform display) {
  std::array<float, 256> table{};
  for (size_t i = 0; i < 256; ++i) {
    const float x = linear_from_srgb(static_cast<float>(i) / 255);
    table[i] = display == DisplayTransform::kSrgb ? x : x / std::max(1 - x, 0.01f);
  }
  return table;
}

void put_on_black(StageView& view) {
  if (view.background.data.empty()) return;
  view.background = {};
  for (int c = 0; c < 3; ++c)
    for (size_t p = 0; p < view.mask.size(); ++p) view.image.plane(c)[p] *= view.mask[p];
}

StageView StageSource::view(const StageViewKey& key, const StageCrop& crop, uint64_t number) const {
  const Image8 image = capture_.load_image(key.camera, key.frame);
  const Image8 mask = capture_.load_mask(key.camera, key.frame);
  const Box box = crop_box(mask, crop, number);
  const int width = box.right - box.left, height = box.bottom - box.top;
  StageView view;
  view.number = number;
  view.frame = key.frame;
  view.camera = key.camera;
  view.left = box.left;
  view.top = box.top;
  view.view = capture_.cameras.at(static_cast<size_t>(key.camera))
                  .camera.cropped(box.left, box.top, width, height, width, height);
  view.image = Planes(width, height, 3);
  view.mask.resize(view.image.pixels());
  for (int y = 0; y < height; ++y) {
    const size_t row = static_cast<size_t>(y) * static_cast<size_t>(width);
    const uint8_t* from = image.at(box.left, box.top + y);
    for (int c = 0; c < 3; ++c)
      for (int x = 0; x < width; ++x)
        view.image.plane(c)[row + static_cast<size_t>(x)] = from[3 * x + c] * (1.0f / 255);
    const uint8_t* covered = mask.at(box.left, box.top + y);
    for (int x = 0; x < width; ++x)
      view.mask[row + static_cast<size_t>(x)] = covered[x] * (1.0f / 255);
  }
  view.moment = std::make_shared<StageMoment>(moment(key.frame));
  if (view.moment->fully_lit && capture_.cameras.at(static_cast<size_t>(key.camera)).background) {
    const Image8 behind = capture_.load_background(key.camera);
    const std::array<float, 256> linear = linear_table(capture_.display);
    view.background = Planes(width, height, 3);
    for (int c = 0; c < 3; ++c)
      for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
          view.background.plane(c)[y * width + x] = linear[behind.at(box.left + x, box.top + y)[c]];
  }
  return view;
}

void LeftOutViews::add(const Error& error, size_t of) {
  if (error.blame() != Blame::kInput) throw error;
  if (count_++ == 0) {
    first_ = error.what();
    log_warning("views with missing or damaged files are left out, the first of them: " + first_);
  }
  if (10 * count_ > of)
    throw Error(format("{} of {} views cannot be read, more than a tenth, the first: {}", count_,
                       of, first_));
}

struct StageViews::State {
  // One number of the schedule: the view, what could not be read on the way to it, or what went
  // wrong otherwise.
  struct Ticket {
    bool ready = false;
    std::optional<StageView> view;
    std::vector<std::pair<StageViewKey, Error>> damaged;
    std::exception_ptr problem;
  };

  State(StageSource s, StageSchedule order, const StageViewsOptions& o, uint64_t first)
      : source(std::move(s)), schedule(std::move(order)), options(o), started(first), taken(first) {
    options.ahead = std::max(options.ahead, 1);
    ring.resize(static_cast<size_t>(options.ahead));
    const StageCapture& capture = source.capture();
    seen.resize(capture.frames.size() * capture.cameras.size());
    for (int i = 0; i < options.threads; ++i)
      workers.emplace_back([this] {
        const OneThread beside_training;
        work();
      });
  }
  ~State() {
    {
      const std::lock_guard lock(mutex);
      stop = true;
    }
    changed.notify_all();
    for (std::thread& worker : workers) worker.join();
  }

  bool ended(uint64_t number) const { return !options.endless && number >= schedule.size(); }

  Ticket load(uint64_t number) const {
    Ticket ticket;
    StageViewKey key = schedule.view(number);
    const uint64_t epoch = number - number % schedule.size();
    for (int attempt = 0; attempt < kAttempts; ++attempt) {
      try {
        ticket.view = source.view(key, options.crop, number);
        return ticket;
      } catch (const Error& error) {
        ticket.damaged.emplace_back(key, error);
        if (!options.endless) return ticket;
        key = schedule.view(epoch + Random(number, static_cast<uint64_t>(attempt)).bits() %
                                        schedule.size());
      } catch (...) {
        ticket.problem = std::current_exception();
        return ticket;
      }
    }
    return ticket;
  }

  void work() {
    std::unique_lock lock(mutex);
    while (true) {
      changed.wait(lock, [&] { return stop || started < taken + ring.size() * options.stride; });
      if (stop || ended(started)) return;
      const uint64_t number = std::exchange(started, started + options.stride);
      lock.unlock();
      Ticket ticket = load(number);
      ticket.ready = true;
      lock.lock();
      slot(number) = std::move(ticket);
      changed.notify_all();
    }
  }

  Ticket& slot(uint64_t number) { return ring[number / options.stride % ring.size()]; }

  // The ticket of number `taken`; then comes the next one.
  Ticket take() {
    const uint64_t number = taken;
    if (options.threads <= 0) {
      taken += options.stride;
      return load(number);
    }
    std::unique_lock lock(mutex);
    changed.wait(lock, [&] { return slot(number).ready; });
    Ticket ticket = std::exchange(slot(number), Ticket());
    taken += options.stride;
    lock.unlock();
    changed.notify_all();
    return ticket;
  }

  // Whether this pair was not looked at before.
  bool mark(const StageViewKey& key) {
    uint8_t& was = seen[static_cast<size_t>(key.frame) * source.capture().cameras.size() +
                        static_cast<size_t>(key.camera)];
    tried += was == 0;
    return std::exchange(was, uint8_t{1}) == 0;
  }

  void count(const Ticket& ticket) {
    for (const auto& [key, error] : ticket.damaged)
      if (mark(key)) left_out.add(error, std::max<size_t>(tried, at_first()));
    if (ticket.view) mark({ticket.view->frame, ticket.view->camera});
  }
  size_t at_first() const { return std::min<size_t>(kTriedAtFirst, schedule.size()); }

  const StageSource source;
  const StageSchedule schedule;
  StageViewsOptions options;

  std::mutex mutex;
  std::condition_variable changed;
  std::vector<Ticket> ring;  // by number
  uint64_t started, taken;   // numbers given to workers, and to the caller
  bool stop = false;
  std::vector<std::thread> workers;

  std::vector<uint8_t> seen;  // per frame and camera of the capture
  size_t tried = 0;           // different ones
  LeftOutViews left_out;
};

StageViews::StageViews(StageSource source, StageSchedule schedule, const StageViewsOptions& options,
                       uint64_t first)
    : state_(std::make_unique<State>(std::move(source), std::move(schedule), options, first)) {}
StageViews::~StageViews() = default;
StageViews::StageViews(StageViews&&) noexcept = default;
StageViews& StageViews::operator=(StageViews&&) noexcept = default;

std::optional<StageView> StageViews::next() {
  State& s = *state_;
  while (!s.ended(s.taken)) {
    State::Ticket ticket = s.take();
    if (ticket.problem) std::rethrow_exception(ticket.problem);
    s.count(ticket);
    if (ticket.view) return std::move(ticket.view);
    if (s.options.endless)
      throw Error("No view of the capture can be read, the first: " + s.left_out.first());
  }
  return std::nullopt;
}

uint64_t StageViews::number() const {
  return state_->taken;
}
size_t StageViews::missing() const {
  return state_->left_out.count();
}

}  // namespace effigy
