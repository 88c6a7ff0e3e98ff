#include "effigy/head/trainer.h"

#include <algorithm>
#include <numeric>

#include "effigy/head/trainer_state.h"
#include "effigy/head/unseen.h"

namespace effigy {
namespace {

constexpr float kWholeWeight = 0.98f;  // of the joint that has a vertex for itself

// Streams of the run's random numbers.
enum RandomStream : uint64_t { kFrameOrder = 1 };

}  // namespace

HeadTrainer::State::State(const Capture& capture_in, const TrainSettings& settings_in)
    : capture(capture_in),
      settings(settings_in),
      model(initial_model(capture_in, settings_in)),
      store(capture_in),
      laplacian(capture_in.rig.mesh.triangles, capture_in.rig.mesh.vertex_count()),
      mask(uv_mask(capture_in.rig.mesh, settings_in.texture_size)) {
  const BoundSurfels& s = model.surfels;
  optimiser.barycentric = AdamState(s.barycentric.size());
  optimiser.displacement = AdamState(s.displacement.size());
  optimiser.rotation = AdamState(s.rotation.size());
  optimiser.log_scale = AdamState(s.log_scale.size());
  optimiser.opacity = AdamState(s.opacity_logit.size());
  optimiser.environment = AdamState(model.environment.size());
  optimiser.rest = AdamState(model.shape.rest.size());
  optimiser.weights = AdamState(model.shape.weights.size());
  optimiser.expression_basis = AdamState(model.shape.expression_basis.size());
  optimiser.pose_basis = AdamState(model.shape.pose_basis.size());
  if (model.encoder) {
    optimiser.encoder = AdamState(model.encoder->weights.size());
    encoded = encoded_entries(capture.rig, settings.encoder_head_pose);
    codes.resize(capture.frames.size());
    for (const int frame : capture.train_frames())
      codes[frame] = model.encoder->code(model.encoder->inputs(capture, frame));
  }
  optimiser.poses.resize(capture.frames.size());
  shade.divide_by_alpha = settings.divide_by_alpha;
  shade.display = capture.display;
  bind.interpolated_normals = settings.interpolated_normals;
  bind.splat_normal_frame = settings.splat_normal_frame;
  bind.jacobian_to_vertices = settings.jacobian_to_vertices;
  const size_t joints = capture.rig.joint_count();
  for (auto row = model.original.weights.begin(); row != model.original.weights.end();
       row += static_cast<std::ptrdiff_t>(joints))
    shared.push_back(*std::max_element(row, row + static_cast<std::ptrdiff_t>(joints)) <
                     kWholeWeight);
  activate_texture(model.material, activation, texture);
  d_texels.assign(texture.texels.size(), 0.0f);
}

// Frames come in a new random order each epoch; the order depends on seed and epoch only.
int HeadTrainer::State::next_frame() {
  if (next == frames.size()) {
    if (!frames.empty()) {
      ++epoch;
      if (settings.hold_mean_pose) hold_mean_pose();
    }
    shuffle_frames();
    next = 0;
  }
  return frames[next++];
}

// Takes the mean of all refinements of the training frames' parameters back: what all frames share
// belongs into the rig and the surfels, or it is missing when the avatar is driven by tracking.
void HeadTrainer::State::hold_mean_pose() {
  const size_t size = pose_size(capture.rig);
  std::vector<double> mean(size, 0.0);
  std::vector<float> refined(size), tracked(size);
  const std::vector<int> train = capture.train_frames();
  for (const int frame : train) {
    pack_pose(model.poses[frame], refined);
    pack_pose(capture.poses[frame], tracked);
    for (size_t k = 0; k < size; ++k)
      mean[k] += (refined[k] - tracked[k]) / static_cast<double>(train.size());
  }
  for (const int frame : train) {
    pack_pose(model.poses[frame], refined);
    for (size_t k = 0; k < size; ++k) refined[k] -= static_cast<float>(mean[k]);
    unpack_pose(refined, model.poses[frame]);
  }
}

RigPose HeadTrainer::State::pose_of(int frame) const {
  const RigPose& pose = model.poses[frame];
  if (!model.encoder) return pose;
  if (!codes[frame].empty()) return model.encoder->corrected(pose, codes[frame]);
  return model.encoder->corrected(pose, model.encoder->code(model.encoder->inputs(capture, frame)));
}

void HeadTrainer::State::shuffle_frames() {
  frames = capture.train_frames();
  Random random(settings.seed + 0x51ed2701 * static_cast<uint64_t>(epoch), kFrameOrder);
  for (size_t i = frames.size(); i > 1; --i) std::swap(frames[i - 1], frames[random.below(i)]);
}

HeadTrainer::HeadTrainer(const Capture& capture, const TrainSettings& settings)
    : state_(std::make_unique<State>(capture, settings)) {}
HeadTrainer::~HeadTrainer() = default;

int64_t HeadTrainer::iteration() const {
  return state_->iteration;
}
const TrainSettings& HeadTrainer::settings() const {
  return state_->settings;
}
LossValues HeadTrainer::step() {
  return state_->step();
}

HeadAvatar HeadTrainer::avatar() const {
  const State& s = *state_;
  HeadAvatar avatar;
  avatar.rig = s.capture.rig;
  avatar.rig.mesh.vertices = s.model.shape.rest;
  avatar.rig.identity_count = 0;
  avatar.rig.identity_basis.clear();
  avatar.rig.identity_sigma.clear();
  avatar.rig.expression_basis = s.model.shape.expression_basis;
  avatar.rig.pose_basis = s.model.shape.pose_basis;
  avatar.rig.weights = s.model.shape.weights;
  avatar.shape = s.model.shape;
  avatar.surfels = s.model.surfels;
  avatar.bind = s.bind;
  avatar.material = s.texture;
  avatar.environment = environment_radiance(s.model.environment);
  avatar.camera = s.capture.camera;
  avatar.display = s.capture.display;
  Track track;
  track.frames_per_second = s.capture.frames_per_second;
  for (const CaptureFrame& frame : s.capture.frames) track.numbers.push_back(frame.number);
  track.poses = s.model.poses;
  if (s.model.encoder) {
    avatar.encoder = s.model.encoder;
    for (size_t f = 0; f < track.poses.size(); ++f) track.poses[f] = s.pose_of(static_cast<int>(f));
  }
  avatar.tracks["train"] = track;
  avatar.info = {{"settings", to_json(s.settings)},
                 {"provenance",
                  {{"source", s.capture.source},
                   {"licence", s.capture.licence},
                   {"consent", s.capture.consent},
                   {"rig", s.capture.rig.kind},
                   {"rig_licence", s.capture.rig.licence},
                   {"made_by", "Effigy " EFFIGY_VERSION},
                   {"synthetic", true}}}};
  return avatar;
}

HeadAvatar HeadTrainer::finished_avatar() const {
  HeadAvatar result = avatar();
  if (state_->settings.restore_unseen)
    restore_unseen(state_->capture, spread_frames(state_->capture.train_frames(), 40),
                   state_->model.start, result);
  return result;
}

}  // namespace effigy
