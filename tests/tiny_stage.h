// A stage capture small enough for tests.
#pragma once

#include "effigy/capture/stage_capture.h"
#include "tiny_capture.h"

namespace effigy::test {

// Two cameras, three lights, three frames: fully lit, partially lit, under an environment.
inline StageCapture tiny_stage() {
  StageCapture c;
  c.source = "a test";
  c.frames_per_second = 12;
  c.rig = ball_rig();
  c.cameras = {{"left", small_camera(16), false}, {"right", small_camera(16), true}};
  c.lights = {{Vec3f(0, 2, 0), Vec3f(1, 2, 3)},
              {Vec3f(2, 0, 0), Vec3f::Ones()},
              {Vec3f(0, 0, 2), Vec3f::Ones()}};
  c.frames.resize(3);
  for (size_t f = 0; f < 3; ++f) {
    c.frames[f].number = static_cast<int64_t>(10 * f);
    c.frames[f].seconds = 0.1 * static_cast<double>(f);
    c.poses.push_back(RigPose::rest(c.rig));
    c.poses.back().translation[0] = static_cast<float>(f);
    c.body_from_rest.push_back({1, 0, 0, static_cast<float>(f), 0, 1, 0, 0, 0, 0, 1, 0});
    c.face_from_rest.push_back({1, 0, 0, 0, 0, 1, 0, static_cast<float>(f), 0, 0, 1, 0});
    for (size_t i = 0; i < 6; ++i) c.body_keypoints.push_back(static_cast<float>(6 * f + i));
    for (size_t i = 0; i < 3; ++i) c.face_keypoints.push_back(static_cast<float>(f));
  }
  c.frames[0].fully_lit = true;
  c.frames[1].lights = {{0, 0.5f}, {2, 1.5f}};
  c.frames[1].split = StageSplit::kLights;
  c.frames[1].cameras = {1};
  c.frames[2].environment = "lights/studio.exr";
  c.frames[2].split = StageSplit::kEnvironment;
  c.body_keypoint_names = {"hips", "head"};
  c.face_keypoint_names = {"nose"};
  c.true_poses = c.poses;
  c.parts = {"skin", "cloth"};
  c.layers = {"part"};
  return c;
}

inline void write_tiny_stage(const Path& folder) {
  const StageCapture c = tiny_stage();
  for (const StageCamera& camera : c.cameras)
    for (const StageFrame& frame : c.frames) {
      write_png8(folder / stage_image_path(camera.name, frame.number), Image8(16, 16, 3));
      write_png8(folder / stage_mask_path(camera.name, frame.number), Image8(16, 16, 1));
      Image8 part(16, 16, 1);
      part.data[3] = 2;
      write_png8(folder / stage_layer_path("part", camera.name, frame.number), part);
    }
  for (const StageFrame& frame : c.frames)
    write_frame_arrays({c.rig.mesh.vertices, c.rig.mesh.vertices, {}}, folder, frame.number);
  write_stage_capture(c, folder);
}

}  // namespace effigy::test
