#include "effigy/body/trainer.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "effigy/base/random.h"
#include "effigy/body/start_maps.h"
#include "effigy/body/trainer_state.h"

namespace effigy {
namespace {

constexpr size_t kScaleFrames = 512;  // that keypoints are measured in
constexpr int kBorder = 8;            // pixels around the body, where Gaussians must not be
constexpr uint64_t kOrderSeeds = 0x9e3779b97f4a7c15;
constexpr size_t kRecent = 32;           // losses that an explosion is measured against
constexpr uint64_t kLampDirection = 21;  // stream of random numbers
constexpr AdamSettings kAdam{0.9f, 0.999f, 1e-8f};

// Even over the sphere, another one for each view.
Vec3f random_direction(uint64_t seed, uint64_t number) {
  Random random(seed + kOrderSeeds * number, kLampDirection);
  const double y = 2 * random.uniform() - 1, angle = 2 * std::numbers::pi * random.uniform();
  const double r = std::sqrt(std::max(0.0, 1 - y * y));
  return Vec3d(r * std::cos(angle), y, r * std::sin(angle)).cast<float>();
}

// Statistics of keypoints in root frames over the training frames.
void scale_keypoints(const StageSource& source, BodyNetworks& networks) {
  std::vector<float> body, face;
  const std::vector<int> frames = source.capture().frames_of(StageSplit::kTrain);
  const size_t count = std::min(frames.size(), kScaleFrames);
  for (size_t k = 0; k < count; ++k) {
    const StageMoment moment = source.moment(frames[k * frames.size() / count]);
    body.insert(body.end(), moment.body_keypoints.begin(), moment.body_keypoints.end());
    face.insert(face.end(), moment.face_keypoints.begin(), moment.face_keypoints.end());
  }
  const BodyNetworkSettings& s = networks.settings();
  networks.set_keypoint_scale(keypoint_scale(body, s.body_keypoints),
                              keypoint_scale(face, s.face_keypoints));
}

BodyNetworkSettings network_settings(const StageCapture& capture,
                                     const BodyTrainSettings& settings) {
  BodyNetworkSettings networks = BodyNetworkSettings::from_size(
      settings.size, static_cast<int>(capture.body_keypoint_names.size()),
      static_cast<int>(capture.face_keypoint_names.size()));
  networks.transfer =
      static_cast<int>(transfer_coefficients(body_appearance_named(settings.appearance)));
  return networks;
}

}  // namespace

BodyTrainer::State::State(const StageCapture& capture_in, const BodyTrainSettings& settings_in,
                          PictureDistance perceptual_in, Ranks& ranks_in)
    : capture(capture_in),
      source(capture_in),
      settings(settings_in),
      ranks(ranks_in),
      model(capture_in.rig.mesh, network_settings(capture_in, settings_in), settings_in.seed),
      moments(source, model.shadow_texels(), settings_in),
      options(draw_options(settings_in)),
      perceptual(std::move(perceptual_in)),
      frames(capture_in.frames_of(StageSplit::kTrain)),
      cameras(capture_in.train_cameras()),
      colours(capture_in.cameras.size()) {
  if (frames.empty() || cameras.empty())
    throw Error(capture.folder.string() +
                ": the capture has no training frames or no training cameras; mark some in "
                "capture.json.");
  if ((settings.perceptual != "none") != static_cast<bool>(perceptual))
    throw Error("The perceptual term '" + settings.perceptual +
                "' needs its network; name it by --perceptual, which finds the file.");
  if (settings.batch % ranks.size() != 0)
    throw Error("A batch of " + std::to_string(settings.batch) + " views does not divide among " +
                std::to_string(ranks.size()) + " processes; start another number of them.");
  prepare_model();
  scale_keypoints(source, model.networks());
  if (settings.shadow) model.networks().set_mean_irradiance(moments.mean_irradiance(frames));
  if (settings.start_from_frames) start_albedo(moments, model);
  for (const BodyParameter& parameter : model.networks().parameters())
    networks.emplace_back(parameter.value.size());
  albedo = AdamState(model.maps().albedo.size());
  roughness = AdamState(model.maps().log_roughness.size());
  colour_states.assign(colours.size(), AdamState(6));
  go_to(0);
}

void BodyTrainer::State::prepare_model() {
  model.set_mesh_normals(settings.normals == "mesh");
  if (settings.appearance == "sh_turned") model.set_turned_harmonics();
  model.networks().set_training(true);
}

// Another order after every explosion; each depends on the seed and how many there were.
void BodyTrainer::State::go_to(uint64_t number) {
  const uint64_t seed = settings.seed + kOrderSeeds * static_cast<uint64_t>(order);
  StageViewsOptions ahead;
  ahead.crop = {settings.crop, kBorder, seed};
  ahead.stride = static_cast<uint64_t>(ranks.size());
  views.emplace(source, StageSchedule::random(capture, frames, cameras, seed), ahead,
                number + static_cast<uint64_t>(ranks.rank()));
}

double BodyTrainer::State::rate_factor() const {
  const double start = settings.iterations * (1 - settings.final_part);
  const double rest = settings.iterations - start, at = static_cast<double>(iteration);
  if (rest <= 0 || at < start) return 1.0;
  return std::pow(settings.final_rate_factor, (at - start) / rest);
}

double BodyTrainer::State::normal_weight() const {
  const double end = settings.normal_anneal * settings.iterations;
  return end > 0 ? settings.weights.normal * std::max(0.0, 1 - static_cast<double>(iteration) / end)
                 : 0.0;
}

double BodyTrainer::State::total(const BodyLossValues& values) const {
  const BodyWeights& w = settings.weights;
  const std::map<std::string, double> weights = {{"l1", w.l1},
                                                 {"dssim", w.dssim},
                                                 {"pyramid", w.pyramid},
                                                 {"lpips", w.lpips},
                                                 {"features", w.features},
                                                 {"mask", w.mask},
                                                 {"alpha_sparsity", w.alpha_sparsity},
                                                 {"scale", w.scale},
                                                 {"offset", w.offset},
                                                 {"normal", normal_weight()},
                                                 {"bound", w.bound},
                                                 {"albedo", w.albedo},
                                                 {"neg_color", w.neg_color},
                                                 {"transfer", w.transfer},
                                                 {"dark_lobes", w.dark_lobes},
                                                 {"normal_orient", w.normal_orient}};
  double sum = 0;
  for (const auto& [name, value] : values) sum += weights.at(name) * value;
  return sum;
}

void BodyTrainer::State::clear_gradients() {
  model.networks().clear_gradients();
  d_maps.albedo.assign(model.maps().albedo.size(), 0.0f);
  d_maps.log_roughness.assign(model.maps().log_roughness.size(), 0.0f);
  d_colours.assign(colours.size(), {});
}

// Draws one view and adds its gradients; losses are added as part of the batch's mean.
void BodyTrainer::State::draw_view(BodyLossValues& mean) {
  view = *views->next();
  if (!settings.backgrounds) put_on_black(view);
  target.background = std::move(view.background);
  target.image = std::move(view.image);
  target.mask = std::move(view.mask);
  target.display = capture.display;
  const int camera = view.camera;
  const auto light = moments.light(*view.moment);
  model.pose(moments.moment(*view.moment));
  model.light(moments.irradiance(*view.moment, *view.moment));
  model.look(view.view.center().cast<float>());
  const BodySurface& surface = model.surface();
  picture.draw(view.view, surface, *light, options);

  const CameraColour& colour = colours[static_cast<size_t>(camera)];
  BodyLossValues values = body_image_losses(settings, target, colour, picture, d_image, perceptual);
  const size_t n = surface.count();
  d_surface.clear(n, transfer_coefficients(options.appearance), light->parts().size());
  d_decoded.assign(model.decoded().size(), 0.0f);
  d_diffuse.assign(3 * n, 0.0f);
  values.merge(body_texel_losses(settings, normal_weight(), model.decoded(), surface,
                                 picture.diffuse(), d_decoded, d_surface, d_diffuse));
  if (settings.deferred) values["normal_orient"] = picture.normal_orient();
  if (settings.weights.dark_lobes > 0 && options.appearance == BodyAppearance::kZonal)
    values["dark_lobes"] =
        dark_lobe_loss(surface, random_direction(settings.seed, view.number),
                       static_cast<float>(settings.weights.dark_lobes), d_surface);
  picture.backward(view.view, surface, *light, options,
                   {&d_image.radiance, d_image.alpha, d_diffuse,
                    static_cast<float>(settings.weights.normal_orient)},
                   d_surface);
  model.backward(d_surface, d_decoded, d_maps);
  for (size_t c = 0; c < 3; ++c) {
    d_colours[static_cast<size_t>(camera)][c] += d_image.gain[c];
    d_colours[static_cast<size_t>(camera)][3 + c] += d_image.offset[c];
  }
  for (const auto& [name, value] : values) mean[name] += value / settings.batch;
}

std::vector<std::span<float>> BodyTrainer::State::gradients() {
  std::vector<std::span<float>> list;
  for (const BodyParameter& parameter : model.networks().parameters())
    if (!parameter.gradient.empty()) list.push_back(parameter.gradient);
  list.emplace_back(d_maps.albedo);
  list.emplace_back(d_maps.log_roughness);
  return list;
}

// Floating-point sums depend on their order. Here it is the order of the views, as in one process:
// round by round every process draws one view, and each sums a part of the arrays over all of them.
void BodyTrainer::State::draw_batch_together(BodyLossValues& mean) {
  std::vector<std::array<double, 6>> colour_sums(colours.size());
  sums.clear();
  for (int round = 0; round < settings.batch / ranks.size(); ++round) {
    BodyLossValues losses;
    clear_gradients();
    together(ranks, [&] { draw_view(losses); });
    std::vector<double> mine = {static_cast<double>(view.camera)};
    const std::array<double, 6>& colour = d_colours[static_cast<size_t>(view.camera)];
    mine.insert(mine.end(), colour.begin(), colour.end());
    for (const auto& [name, value] : losses) mine.push_back(value);
    const std::vector<double> all = ranks.gather(mine);
    for (auto at = all.begin(); at != all.end();) {
      std::array<double, 6>& sum = colour_sums[static_cast<size_t>(*at++)];
      for (double& d : sum) d += *at++;
      for (const auto& [name, value] : losses) mean[name] += *at++;
    }
    const std::vector<std::span<float>> arrays = gradients();
    sums.resize(arrays.size());
    for (size_t k = 0; k < arrays.size(); ++k) ranks.add_part(arrays[k], sums[k]);
  }
  const std::vector<std::span<float>> arrays = gradients();
  for (size_t k = 0; k < arrays.size(); ++k) ranks.gather_parts(sums[k], arrays[k]);
  d_colours = std::move(colour_sums);
}

void BodyTrainer::State::update_networks() {
  const std::vector<BodyParameter> parameters = model.networks().parameters();
  double square = 0;
  for (const BodyParameter& parameter : parameters) {
    const double norm = check_gradient(parameter.gradient).norm;
    square += norm * norm;
  }
  const double norm = std::sqrt(square) / settings.batch;
  double factor = 1.0 / settings.batch;
  if (settings.clip_gradient > 0 && norm > settings.clip_gradient)
    factor *= settings.clip_gradient / norm;
  const auto rate = static_cast<float>(rate_factor() * settings.rates.networks);
  for (size_t p = 0; p < parameters.size(); ++p) {
    std::span<const float> gradient = parameters[p].gradient;
    if (gradient.empty()) continue;
    if (factor != 1.0) {
      scaled.resize(gradient.size());
      for (size_t i = 0; i < gradient.size(); ++i)
        scaled[i] = static_cast<float>(factor) * gradient[i];
      gradient = scaled;
    }
    adam_step(parameters[p].value, gradient, networks[p], rate, kAdam);
  }
}

void BodyTrainer::State::update_maps() {
  const auto rate = static_cast<float>(rate_factor() * settings.rates.maps);
  BodyMaps& maps = model.maps();
  adam_step(maps.albedo, d_maps.albedo, albedo, rate, kAdam);
  adam_step(maps.log_roughness, d_maps.log_roughness, roughness, rate, kAdam);
  // What is saved as pictures has to be of their range.
  for (float& value : maps.albedo) value = std::clamp(value, 0.0f, 1.0f);
  for (float& value : maps.log_roughness)
    value = std::clamp(value, std::log(kLeastRoughness), std::log(kMostRoughness));
}

// The first training camera is what the others are measured by.
void BodyTrainer::State::update_colours() {
  if (!settings.camera_gains) return;
  const auto rate = static_cast<float>(rate_factor() * settings.rates.cameras);
  for (size_t k = 1; k < cameras.size(); ++k) {
    const auto camera = static_cast<size_t>(cameras[k]);
    std::array<float, 6> value, gradient;
    bool touched = false;
    for (size_t i = 0; i < 6; ++i) {
      value[i] = i < 3 ? colours[camera].gain[i] : colours[camera].offset[i - 3];
      gradient[i] = static_cast<float>(d_colours[camera][i] / settings.batch);
      touched = touched || gradient[i] != 0;
    }
    if (!touched) continue;
    adam_step(value, gradient, colour_states[camera], rate, kAdam);
    std::copy_n(value.begin(), 3, colours[camera].gain.begin());
    std::copy_n(value.begin() + 3, 3, colours[camera].offset.begin());
  }
}

BodyLossValues BodyTrainer::State::step() {
  BodyLossValues mean;
  clear_gradients();
  if (ranks.size() > 1)
    draw_batch_together(mean);
  else
    for (int b = 0; b < settings.batch; ++b) draw_view(mean);
  const double loss = total(mean);
  const double before = std::accumulate(recent.begin(), recent.end(), 0.0) /
                        static_cast<double>(std::max<size_t>(recent.size(), 1));
  const bool burst =
      settings.explosion > 0 && recent.size() == kRecent && loss > settings.explosion * before;
  if (!std::isfinite(loss) || burst) {
    together(ranks, [&] {
      throw Diverged("Training diverged at iteration " + std::to_string(iteration) +
                         ": the loss jumped from " + std::to_string(before) + " to " +
                         std::to_string(loss) + "; lower rate.networks (--set).",
                     Blame::kInternal);
    });
  }
  recent.push_back(static_cast<float>(loss));
  if (recent.size() > kRecent) recent.pop_front();
  update_networks();
  if (settings.batch > 1) {
    const float share = 1.0f / static_cast<float>(settings.batch);
    for (float& d : d_maps.albedo) d *= share;
    for (float& d : d_maps.log_roughness) d *= share;
  }
  update_maps();
  update_colours();
  ++iteration;
  return mean;
}

BodyTrainer::BodyTrainer(const StageCapture& capture, const BodyTrainSettings& settings,
                         PictureDistance perceptual, Ranks& ranks)
    : state_(std::make_unique<State>(capture, settings, std::move(perceptual), ranks)) {}
BodyTrainer::~BodyTrainer() = default;

int64_t BodyTrainer::iteration() const {
  return state_->iteration;
}
BodyLossValues BodyTrainer::step() {
  return state_->step();
}
void BodyTrainer::change_order() {
  ++state_->order;
  state_->go_to(state_->next_number());
}
const BodyTrainSettings& BodyTrainer::settings() const {
  return state_->settings;
}
BodyModel& BodyTrainer::model() {
  return state_->model;
}
StageMoments& BodyTrainer::moments() {
  return state_->moments;
}
const StageSource& BodyTrainer::source() const {
  return state_->source;
}
const std::vector<CameraColour>& BodyTrainer::camera_colours() const {
  return state_->colours;
}

}  // namespace effigy
