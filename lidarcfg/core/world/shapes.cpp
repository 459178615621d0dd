#include "world/shapes.h"

#include <algorithm>
#include <limits>
#include <tuple>

namespace lidarcfg::world {
namespace {

constexpr double inf = std::numeric_limits<double>::infinity();

}  // namespace

std::pair<double, double> chord(double b, double off, double radius, double near) {
  const double square = (radius - off) * (radius + off);
  if (square < 0) {
    return {inf, -inf};
  }
  const double half = std::sqrt(square);
  const double product = (near - radius) * (near + radius);  // of both distances
  if (b > 0) {
    const double leave = b + half;
    return {product / leave, leave};
  }
  const double enter = b - half;
  return {enter, enter < 0 ? product / enter : enter};
}

double sphere(const Vec3& start, double radius, const Vec3& direction) {
  const auto [x, y, z] = start;
  const auto [dx, dy, dz] = direction;
  const double b = -(x * dx + y * dy + z * dz);
  const double lx = y * dz - z * dy;
  const double ly = z * dx - x * dz;
  const double lz = x * dy - y * dx;
  const double off = std::sqrt(lx * lx + ly * ly + lz * lz);
  const double near = std::sqrt(x * x + y * y + z * z);
  const auto [enter, leave] = chord(b, off, radius, near);
  if (enter > 0) {
    return enter;
  }
  return leave > 0 ? leave : inf;
}

CylinderHit cylinder(const Vec3& start, double radius, double height, const Vec3& direction) {
  const auto [x, y, z] = start;
  const auto [dx, dy, dz] = direction;
  const double flat = std::sqrt(dx * dx + dy * dy);
  const double near = std::sqrt(x * x + y * y);
  double enter = -inf;
  double leave = inf;
  if (flat > 0) {
    const double u = dx / flat;
    const double v = dy / flat;
    std::tie(enter, leave) = chord(-(x * u + y * v), std::abs(x * v - y * u), radius, near);
    enter /= flat;
    leave /= flat;
  } else if (!(near <= radius)) {
    return {inf, false};
  }
  double low = -inf;
  double high = inf;
  if (dz != 0) {
    const double one = -z / dz;
    const double other = (height - z) / dz;
    low = std::min(one, other);
    high = std::max(one, other);
  } else if (!(0 <= z && z <= height)) {
    return {inf, false};
  }
  const double first = std::max(enter, low);
  const double last = std::min(leave, high);
  if (first <= last && first > 0) {
    return {first, enter >= low};
  }
  if (first <= last && last > 0) {
    return {last, leave <= high};
  }
  return {inf, false};
}

double round_range(const Shape& shape, Kind kind, const Vec3& origin, const Vec3& direction) {
  const Vec3 start{origin[0] - shape[0], origin[1] - shape[1], origin[2] - shape[2]};
  if (kind == Kind::cylinder) {
    return cylinder(start, shape[3], shape[4], direction).range;
  }
  return sphere(start, shape[3], direction);
}

Vec3 normal_at(const Shape& shape, Kind kind, const Vec3& origin, const Vec3& direction, double range) {
  Vec3 out;
  if (kind == Kind::triangle) {
    out = normal({shape[0], shape[1], shape[2]}, {shape[3], shape[4], shape[5]}, {shape[6], shape[7], shape[8]});
  } else {
    const Vec3 start{origin[0] - shape[0], origin[1] - shape[1], origin[2] - shape[2]};
    for (int axis = 0; axis < 3; ++axis) {
      out[axis] = start[axis] + direction[axis] * range;
    }
    if (kind == Kind::cylinder) {
      const bool side = cylinder(start, shape[3], shape[4], direction).side;
      out = side ? Vec3{out[0], out[1], 0.0} : Vec3{0.0, 0.0, 1.0};
    }
  }
  double length = std::sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]);
  length = length > 0 ? length : 1.0;
  return {out[0] / length, out[1] / length, out[2] / length};
}

}  // namespace lidarcfg::world
