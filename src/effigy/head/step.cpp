// One training iteration: draw, losses, backward through every kernel, Adam.

#include <algorithm>
#include <cmath>

#include "effigy/head/trainer_state.h"
#include "effigy/learn/albedo_prior.h"
#include "effigy/learn/image_losses.h"
#include "effigy/learn/mesh_losses.h"
#include "effigy/learn/normal_consistency.h"

namespace effigy {
namespace {

constexpr double kPoseScale[3] = {1, 0.1, 0.01};  // of expression, radians, metres
constexpr float kLeastShape = 1e-4f;  // metres by which a shape moves the vertices it may move

UvDistortion uv_distortion_mode(const std::string& name) {
  if (name == "norm") return UvDistortion::kNorm;
  if (name == "squared") return UvDistortion::kSquared;
  return UvDistortion::kOff;
}

void clear_planes(Planes& planes, const Camera& camera, int count) {
  if (planes.width != camera.width || planes.height != camera.height || planes.count != count) {
    planes = Planes(camera.width, camera.height, count);
  } else {
    std::fill(planes.data.begin(), planes.data.end(), 0.0f);
  }
}

void clear_posed(PosedSurfels& posed, size_t count) {
  posed.resize(count);
  for (auto* array : {&posed.center, &posed.s, &posed.t, &posed.opacity, &posed.uv,
                      &posed.uv_per_st, &posed.frame})
    std::fill(array->begin(), array->end(), 0.0f);
}

// A joint that does not move a vertex would learn to in the poses of the training frames, and tear
// the surface in others.
void hold_unweighted(const std::vector<float>& weights, std::vector<float>& gradient) {
  for (size_t k = 0; k < gradient.size(); ++k)
    if (weights[k] == 0) gradient[k] = 0;
}

// So would a shape that does not move a vertex of the neck, where joints share the skin: clears the
// gradient of its row. Elsewhere shapes may learn what goes with them, such as how hair sits.
void hold_unshaped(const std::vector<float>& basis, const std::vector<uint8_t>& shared,
                   std::vector<float>& gradient) {
  const size_t vertices = shared.size();
  for (size_t row = 0; 3 * row < gradient.size(); ++row) {
    if (!shared[row % vertices]) continue;
    const Eigen::Map<const Vec3f> before(&basis[3 * row]);
    if (before.squaredNorm() <= kLeastShape * kLeastShape)
      Eigen::Map<Vec3f>(&gradient[3 * row]).setZero();
  }
}

// Rows of skinning weights are kept non-negative and summing to 1.
void normalise_weights(std::vector<float>& weights, size_t joints) {
  for (size_t row = 0; row + joints <= weights.size(); row += joints) {
    float sum = 1e-6f;
    for (size_t j = 0; j < joints; ++j) {
      weights[row + j] = std::max(weights[row + j], 0.0f);
      sum += weights[row + j];
    }
    for (size_t j = 0; j < joints; ++j) weights[row + j] /= sum;
  }
}

}  // namespace

// Constant, then falling geometrically to final_rate_factor over the last part of the run, so that
// the textures settle.
double HeadTrainer::State::rate_factor() const {
  const double start = settings.iterations * (1 - settings.final_part);
  const double rest = settings.iterations - start;
  if (rest <= 0 || iteration < start) return 1.0;
  return std::pow(settings.final_rate_factor, (static_cast<double>(iteration) - start) / rest);
}

SurfelRasterOptions HeadTrainer::State::raster_options() const {
  SurfelRasterOptions options;
  if (settings.weights.uv_distortion > 0 && iteration >= settings.uv_distortion_start)
    options.uv_distortion = uv_distortion_mode(settings.uv_distortion);
  options.uv_distortion_threshold = static_cast<float>(settings.uv_distortion_threshold);
  return options;
}

void HeadTrainer::State::draw(const RigPose& pose, const PrefilteredEnvironment& light) {
  pose_vertices(model.shape, pose, vertices);
  pose_surfels(capture.rig.mesh, vertices, model.surfels, bind, posed);
  render_surfels(capture.camera, posed, texture, raster_options(), gbuffer, raster);
  shade_deferred(gbuffer, capture.camera, light, shade, colour);
}

void HeadTrainer::State::image_losses(LossValues& losses) {
  const LossWeights& w = settings.weights;
  const size_t pixels = gbuffer.pixels();
  const std::span<const float> alpha(gbuffer.plane(kAlpha), pixels);
  const PixelBox box = nonzero_box(colour, target.image, alpha, target.mask.data);
  const PhotometricLoss photo = photometric_loss(
      colour, target.image, alpha, target.mask.data,
      {static_cast<float>(w.l1), static_cast<float>(w.dssim), static_cast<float>(w.mask)},
      &d_colour, {d_gbuffer.plane(kAlpha), pixels}, box);
  losses["l1"] = photo.l1;
  losses["dssim"] = photo.dssim;
  losses["mask"] = photo.mask;
  if (w.normal_consistency > 0)
    losses["normal_consistency"] = normal_consistency_loss(
        gbuffer, capture.camera, {}, static_cast<float>(w.normal_consistency), &d_gbuffer, scratch);
  if (w.albedo_prior > 0 && target.albedo.count == 3)
    losses["albedo_prior"] = albedo_prior_loss(gbuffer, target.albedo, target.mask.data, {},
                                               static_cast<float>(w.albedo_prior), &d_gbuffer);
  if (raster_options().uv_distortion != UvDistortion::kOff) {
    const float* plane = gbuffer.plane(kUvDistortion);
    double sum = 0;
    for (size_t i = 0; i < pixels; ++i) sum += plane[i];
    losses["uv_distortion"] = sum / static_cast<double>(pixels);
    std::fill_n(d_gbuffer.plane(kUvDistortion), pixels,
                static_cast<float>(w.uv_distortion / static_cast<double>(pixels)));
  }
}

void HeadTrainer::State::surfel_losses(LossValues& losses) {
  if (settings.weights.barycentric > 0)
    losses["barycentric"] =
        barycentric_loss(model.surfels.barycentric,
                         static_cast<float>(settings.weights.barycentric), d_bound.barycentric);
}

void HeadTrainer::State::update_surfels() {
  const double f = rate_factor();
  const LearningRates& r = settings.rates;
  BoundSurfels& s = model.surfels;
  const auto step = [f](std::vector<float>& values, const std::vector<float>& gradient,
                        AdamState& state, double rate) {
    adam_step(values, gradient, state, static_cast<float>(f * rate));
  };
  step(s.barycentric, d_bound.barycentric, optimiser.barycentric, r.barycentric);
  step(s.displacement, d_bound.displacement, optimiser.displacement, r.displacement);
  step(s.rotation, d_bound.rotation, optimiser.rotation, r.rotation);
  step(s.log_scale, d_bound.log_scale, optimiser.log_scale, r.log_scale);
  step(s.opacity_logit, d_bound.opacity_logit, optimiser.opacity, r.opacity);
  // Surfels at the mesh's border have nothing to stop them from growing into long streaks.
  const auto largest = static_cast<float>(std::log(settings.largest_scale));
  for (float& log_scale : s.log_scale) log_scale = std::min(log_scale, largest);
}

void HeadTrainer::State::update_environment(const PrefilteredEnvironment& d_light) {
  Cubemap d_radiance(kEnvironmentSize);
  prefilter.backward(d_light, d_radiance);
  const Cubemap radiance = environment_radiance(model.environment);
  for (size_t i = 0; i < d_radiance.texels.size(); ++i)
    d_radiance.texels[i] *= radiance.texels[i];  // d exp(x) = exp(x)
  adam_step(model.environment, d_radiance.texels, optimiser.environment,
            static_cast<float>(rate_factor() * settings.rates.environment));
}

// Of an entry of a packed pose: 0 expression, 1 rotation, 2 translation.
int HeadTrainer::State::group_of(size_t entry) const {
  if (entry < static_cast<size_t>(capture.rig.expression_count)) return 0;
  return entry < pose_size(capture.rig) - 3 ? 1 : 2;
}

void HeadTrainer::State::update_pose(int frame, const RigPose& drawn, const RigGradient& gradient,
                                     LossValues& losses) {
  const size_t size = pose_size(capture.rig);
  const size_t expressions = capture.rig.expression_count;
  std::vector<float> flat(size), gradients(size), unit(size, 0.0f);
  RigPose& pose = model.poses[frame];
  pack_pose(pose, flat);
  RigPose packed{gradient.expression, gradient.joint_rotation, gradient.translation};
  if (settings.weights.expression > 0)
    losses["expression"] =
        distance_loss(drawn.expression, capture.poses[frame].expression, Distance::kMeanSquared, 1,
                      static_cast<float>(settings.weights.expression), packed.expression);
  pack_pose(packed, gradients);
  if (model.encoder) update_encoder(frame, gradients);
  AdamState& state = optimiser.poses[frame];
  if (state.size() != size) state = AdamState(size);
  adam_step(unit, gradients, state, 1.0f);
  const double f = rate_factor();
  const double rates[3] = {settings.refine_expression ? f * settings.rates.frame_expression : 0.0,
                           settings.refine_pose ? f * settings.rates.frame_rotation : 0.0,
                           settings.refine_pose ? f * settings.rates.frame_translation : 0.0};
  for (size_t k = 0; k < size; ++k) flat[k] += static_cast<float>(rates[group_of(k)] * unit[k]);
  unpack_pose(flat, pose);
  for (size_t e = 0; e < expressions; ++e)
    pose.expression[e] = std::clamp(pose.expression[e], capture.rig.expression_low[e] - 0.3f,
                                    capture.rig.expression_high[e] + 0.3f);
}

// A unit of rotation or translation moves a picture by far more than one of expression does.
void HeadTrainer::State::update_encoder(int frame, const std::vector<float>& d_pose) {
  FrameEncoder& encoder = *model.encoder;
  std::vector<float> gradient(encoder.weights.size(), 0.0f), unit(gradient.size(), 0.0f);
  std::vector<float> wanted = d_pose;
  for (size_t k = 0; k < wanted.size(); ++k)
    if (!encoded[k]) wanted[k] = 0;
  encoder.backward(codes[frame], wanted, gradient);
  adam_step(unit, gradient, optimiser.encoder, 1.0f);
  const double rate = rate_factor() * settings.rates.encoder;
  const size_t width = encoder.code_size();
  for (size_t i = 0; i < unit.size(); ++i)
    encoder.weights[i] += static_cast<float>(rate * kPoseScale[group_of(i / width)] * unit[i]);
}

void HeadTrainer::State::update_rig(int frame, const RigPose& pose, LossValues& losses) {
  const LossWeights& w = settings.weights;
  const RigPose& tracked = capture.poses[frame];
  const bool refine_pose = settings.refine_expression || settings.refine_pose || settings.encoder;
  if (!settings.refine_rig && !refine_pose) return;
  if (settings.refine_rig && w.laplacian > 0) {
    pose_vertices(model.original, tracked, original_vertices);
    losses["laplacian"] =
        laplacian_loss(laplacian, vertices, original_vertices, static_cast<float>(w.laplacian),
                       d_bound.vertices, scratch);
  }
  RigGradient g;
  RigShape& shape = model.shape;
  if (settings.refine_rig) {
    g.rest.assign(shape.rest.size(), 0.0f);
    g.weights.assign(shape.weights.size(), 0.0f);
    g.expression_basis.assign(shape.expression_basis.size(), 0.0f);
    g.pose_basis.assign(shape.pose_basis.size(), 0.0f);
  }
  g.expression.assign(tracked.expression.size(), 0.0f);
  g.joint_rotation.assign(tracked.joint_rotation.size(), 0.0f);
  pose_vertices_backward(shape, pose, d_bound.vertices, g);
  if (settings.refine_rig) {
    if (settings.local_rig) {
      hold_unweighted(model.original.weights, g.weights);
      hold_unshaped(model.original.expression_basis, shared, g.expression_basis);
      hold_unshaped(model.original.pose_basis, shared, g.pose_basis);
    }
    const double f = rate_factor();
    const auto tune = [&](std::vector<float>& values, const std::vector<float>& original,
                          std::vector<float>& gradient, AdamState& state, double rate,
                          size_t width) {
      if (values.empty() || rate <= 0) return;
      if (w.rig > 0)
        losses["rig"] += distance_loss(values, original, Distance::kMeanRowNorm, width,
                                       static_cast<float>(w.rig), gradient);
      adam_step(values, gradient, state, static_cast<float>(f * rate));
    };
    const LearningRates& r = settings.rates;
    tune(shape.rest, model.original.rest, g.rest, optimiser.rest, r.template_vertices, 3);
    tune(shape.weights, model.original.weights, g.weights, optimiser.weights, r.weights,
         capture.rig.joint_count());
    tune(shape.expression_basis, model.original.expression_basis, g.expression_basis,
         optimiser.expression_basis, r.basis, 3);
    tune(shape.pose_basis, model.original.pose_basis, g.pose_basis, optimiser.pose_basis, r.basis,
         3);
    normalise_weights(shape.weights, capture.rig.joint_count());
  }
  if (refine_pose) update_pose(frame, pose, g, losses);
}

void HeadTrainer::State::update_material(LossValues& losses) {
  const LossWeights& w = settings.weights;
  TextureLossSettings texture_losses;
  texture_losses.roughness_tv = texture_losses.specular_tv = static_cast<float>(w.smooth);
  texture_losses.normal = static_cast<float>(w.normal_map);
  texture_losses.boundary = static_cast<float>(w.boundary);
  texture_losses.roughness_prior = texture_losses.specular_prior =
      static_cast<float>(w.material_prior);
  const auto f = static_cast<float>(rate_factor());
  const auto material = f * static_cast<float>(settings.rates.material);
  const TextureRates rates{material, material, material,
                           f * static_cast<float>(settings.rates.normal)};
  const TextureStep step =
      texture_step(model.material, activation, mask, texture_losses, rates, {}, texture, d_texels);
  losses["smooth"] = step.losses.roughness_tv + step.losses.specular_tv;
  losses["normal_map"] = step.losses.normal;
  losses["material_prior"] = step.losses.roughness_prior + step.losses.specular_prior;
  losses["boundary"] = step.losses.boundary;
}

LossValues HeadTrainer::State::step() {
  const int frame = next_frame();
  store.load(frame, target);
  const RigPose pose = pose_of(frame);
  const PrefilteredEnvironment light = prefilter.forward(environment_radiance(model.environment));
  draw(pose, light);

  LossValues losses;
  clear_planes(d_colour, capture.camera, 3);
  clear_planes(d_gbuffer, capture.camera, kGBufferPlanes);
  image_losses(losses);

  PrefilteredEnvironment d_light = prefilter.zero_like();
  shade_deferred_backward(gbuffer, capture.camera, light, shade, d_colour, d_gbuffer, &d_light);
  clear_posed(d_posed, posed.count());
  render_surfels_backward(capture.camera, posed, texture, raster_options(), gbuffer, raster,
                          d_gbuffer, d_posed, d_texels);
  d_bound.clear(model.surfels, vertices.size());
  pose_surfels_backward(capture.rig.mesh, vertices, model.surfels, bind, d_posed, d_bound);
  surfel_losses(losses);

  update_rig(frame, pose, losses);
  update_surfels();
  update_environment(d_light);
  update_material(losses);
  ++iteration;
  for (const auto& [name, value] : losses)
    if (!std::isfinite(value))
      throw Error("Training diverged at iteration " + std::to_string(iteration) + ": the loss '" +
                      name +
                      "' is not finite; resume from the checkpoint with a lower rate (--set).",
                  Blame::kInternal);
  return losses;
}

}  // namespace effigy
