#include "effigy/capture/import_source.h"

#include <charconv>
#include <cmath>

#include "effigy/base/error.h"

namespace effigy {

Mesh imported_mesh(const StageImportOptions& options, const Path& fallback,
                   const std::string& lacking) {
  const Path path = options.mesh.empty() ? fallback : options.mesh;
  if (path.empty()) throw Error(lacking);
  Mesh mesh = read_obj(path);
  if (mesh.uv_triangles.empty())
    throw Error(path.string() +
                ": the mesh has no texture coordinates, and an avatar's texels need them; give one "
                "that has with --mesh FILE.obj.");
  return mesh;
}

void hold_out(StageCapture& capture) {
  for (size_t c = 0; c < capture.cameras.size(); ++c) capture.cameras[c].test = c % 5 == 2;
  int partial = 0;
  for (StageFrame& frame : capture.frames)
    if (frame.split == StageSplit::kTrain && !frame.lights.empty() && ++partial % 10 == 5)
      frame.split = StageSplit::kLights;
}

Mat3d checked_rotation(const Mat3d& m, const std::string& name) {
  if (!m.allFinite() || !((m * m.transpose() - Mat3d::Identity()).norm() < 1e-2) ||
      m.determinant() < 0)
    throw Error(name + ": its rotation is no rotation matrix; correct the calibration.");
  const Eigen::JacobiSVD<Mat3d> svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * svd.matrixV().transpose();
}

std::vector<double> parse_table(const std::string& text, const std::string& name) {
  std::vector<double> numbers;
  const char* at = text.data();
  const char* end = at + text.size();
  const auto separates = [](char c) {
    return c == ' ' || c == ',' || c == '\t' || c == '\r' || c == '\n';
  };
  while (true) {
    while (at < end && separates(*at)) ++at;
    if (at == end) return numbers;
    if (*at == '+') ++at;
    double value = 0;
    const auto [stop, code] = std::from_chars(at, end, value);
    if (code != std::errc() || (stop < end && !separates(*stop)) || !std::isfinite(value))
      throw Error(name + ": number " + std::to_string(numbers.size() + 1) +
                  " in it is none, or not finite; write the file again.");
    numbers.push_back(value);
    at = stop;
  }
}

void put_on_black(const Image8& mask, Image8& image) {
  for (size_t i = 0; i < mask.data.size(); ++i)
    for (size_t c = 0; c < 3; ++c) {
      uint8_t& value = image.data[3 * i + c];
      value = static_cast<uint8_t>((value * mask.data[i] + 127) / 255);
    }
}

}  // namespace effigy
