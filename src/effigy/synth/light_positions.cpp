#include "effigy/synth/light_positions.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numbers>
#include <sstream>

#include "effigy/base/error.h"
#include "effigy/base/log.h"
#include "effigy/base/npy.h"

namespace effigy {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr size_t kMostLights = 100000;

std::vector<double> read_numbers(const Path& path) {
  if (path.extension() == ".npy") {
    const NpyArray array = read_npy(path);
    if (array.shape.size() != 2 || array.shape[1] != 3)
      throw Error(path.string() + ": light positions must be an array of N x 3; correct it.");
    return array.doubles();
  }
  std::vector<double> values;
  std::istringstream text(read_text(path, uint64_t{16} << 20));
  std::string line;
  for (int number = 1; std::getline(text, line); ++number) {
    std::istringstream row(line.substr(0, line.find('#')));
    std::vector<double> three;
    for (double x = 0; row >> x;) three.push_back(x);
    if (!row.eof() || (three.size() != 3 && !three.empty()))
      throw Error(path.string() + ": line " + std::to_string(number) +
                  " is not three numbers, the position of a light; correct it.");
    values.insert(values.end(), three.begin(), three.end());
  }
  return values;
}

// The centre of the sphere that all points lie on; the origin when they do not.
Vec3d sphere_centre(const std::vector<Vec3d>& points) {
  constexpr size_t kFewest = 10;
  constexpr double kRoughness = 1e-3, kFlattest = 1e-3;
  if (points.size() < kFewest) return Vec3d::Zero();
  // |p|^2 = 2 c.p + (r^2 - |c|^2), least squares.
  const auto n = static_cast<Eigen::Index>(points.size());
  Eigen::MatrixXd a(n, 4);
  Eigen::VectorXd b(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const Vec3d& p = points[static_cast<size_t>(i)];
    a.row(i) << 2 * p.transpose(), 1;
    b[i] = p.squaredNorm();
  }
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> solver(a);
  const auto pivots = solver.matrixQR().diagonal().head<4>().cwiseAbs();
  if (!(pivots.minCoeff() > kFlattest * pivots.maxCoeff())) return Vec3d::Zero();
  const Eigen::Vector4d found = solver.solve(b);
  Vec3d centre = found.head<3>();
  const double radius = std::sqrt(found[3] + centre.squaredNorm());
  for (const Vec3d& p : points)
    if (!(std::abs((p - centre).norm() - radius) <= kRoughness * radius)) return Vec3d::Zero();
  return centre;
}

// Whether lights stand all around but for an opening at +y.
bool open_at_plus_y(const std::vector<Vec3d>& directions) {
  constexpr double kClosed = 50 * kPi / 180;  // no larger opening than this anywhere else
  constexpr double kLarger = 1.5;
  const double above = opening_towards(directions, Vec3d::UnitY());
  for (const Vec3d& side : {Vec3d(1, 0, 0), Vec3d(-1, 0, 0), Vec3d(0, 0, 1), Vec3d(0, 0, -1)})
    if (opening_towards(directions, side) > kClosed) return false;
  const double below = opening_towards(directions, -Vec3d::UnitY());
  return below < kClosed && above > kLarger * below;
}

// world_from_file: a turn that brings the file's up axis to +y.
Mat3d turn_up(UpAxis up) {
  Mat3d r = Mat3d::Identity();
  switch (up) {
    case UpAxis::kAuto:
    case UpAxis::kPlusY:
      break;
    case UpAxis::kMinusY:
      r << 1, 0, 0, 0, -1, 0, 0, 0, -1;
      break;
    case UpAxis::kPlusZ:
      r << 1, 0, 0, 0, 0, 1, 0, -1, 0;
      break;
    case UpAxis::kMinusZ:
      r << 1, 0, 0, 0, 0, -1, 0, 1, 0;
      break;
    case UpAxis::kPlusX:
      r << 0, -1, 0, 1, 0, 0, 0, 0, 1;
      break;
    case UpAxis::kMinusX:
      r << 0, 1, 0, -1, 0, 0, 0, 0, 1;
      break;
  }
  return r;
}

}  // namespace

UpAxis up_axis_from_name(const std::string& name) {
  static const std::vector<std::pair<const char*, UpAxis>> names = {
      {"auto", UpAxis::kAuto}, {"+x", UpAxis::kPlusX},  {"-x", UpAxis::kMinusX},
      {"+y", UpAxis::kPlusY},  {"-y", UpAxis::kMinusY}, {"+z", UpAxis::kPlusZ},
      {"-z", UpAxis::kMinusZ}, {"x", UpAxis::kPlusX},   {"y", UpAxis::kPlusY},
      {"z", UpAxis::kPlusZ}};
  for (const auto& [known, axis] : names)
    if (name == known) return axis;
  throw Error("There is no up axis '" + name + "'; choose auto, +x, -x, +y, -y, +z or -z.");
}

double opening_towards(const std::vector<Vec3d>& directions, const Vec3d& towards) {
  constexpr int kLooked = 4000;  // directions over the sphere, 2 degrees apart
  const double golden = kPi * (3 - std::sqrt(5.0)), least = std::cos(kPi / 6);
  double widest = 1;  // cosine to the nearest light
  for (int i = 0; i < kLooked; ++i) {
    const double z = 1 - (2 * i + 1.0) / kLooked, r = std::sqrt(1 - z * z);
    const Vec3d d(r * std::cos(golden * i), r * std::sin(golden * i), z);
    if (d.dot(towards) < least) continue;
    double nearest = -1;
    for (const Vec3d& light : directions) nearest = std::max(nearest, d.dot(light));
    widest = std::min(widest, nearest);
  }
  return std::acos(std::clamp(widest, -1.0, 1.0));
}

std::vector<Vec3d> read_light_positions(const Path& path, double radius, const Vec3d& centre,
                                        UpAxis up) {
  const std::vector<double> values = read_numbers(path);
  const size_t count = values.size() / 3;
  if (count == 0)
    throw Error(path.string() + ": it has no light positions; a stage needs at least one light.");
  if (count > kMostLights)
    throw Error(path.string() + ": it has more than " + std::to_string(kMostLights) +
                " light positions.");
  std::vector<Vec3d> out;
  for (size_t i = 0; i < count; ++i) {
    out.emplace_back(values[3 * i], values[3 * i + 1], values[3 * i + 2]);
    if (!out.back().allFinite() || out.back().norm() < 1e-6 || out.back().norm() > 1e6)
      throw Error(path.string() + ": light position " + std::to_string(i) +
                  " is not finite, too far, or lies at the origin, the dome's centre; correct it.");
  }
  const Vec3d own = sphere_centre(out);
  double mean = 0;
  std::vector<Vec3d> directions;
  for (Vec3d& p : out) {
    p -= own;
    mean += p.norm() / static_cast<double>(count);
    directions.push_back(p.normalized());
  }
  if (up == UpAxis::kAuto && open_at_plus_y(directions)) {
    up = UpAxis::kMinusY;
    log_info("The lights of " + path.string() +
             " are open at +y, so y points down there (--light-up +y if it does not).");
  }
  const Mat3d world_from_file = turn_up(up);
  for (Vec3d& p : out) p = centre + radius / mean * (world_from_file * p);
  return out;
}

}  // namespace effigy
