#include "world/solids.h"

#include <algorithm>
#include <limits>
#include <utility>
#include <vector>

#include "simd.h"

namespace lidarcfg::world {
namespace {

struct Corners {
  Vec3 a;
  Vec3 b;
  Vec3 c;

  Corners(View<const Vec3> vertices, View<const std::int64_t> triangle)
      : a(vertices[triangle[0]]), b(vertices[triangle[1]]), c(vertices[triangle[2]]) {}

  double least(int axis) const { return std::min({a[axis], b[axis], c[axis]}); }
  double most(int axis) const { return std::max({a[axis], b[axis], c[axis]}); }
};

/// Whether a line at (y, z) in the direction of falling y crosses an edge; the same for both of its directions.
bool beside(double ay, double az, double by, double bz, double y, double z) {
  if (az > bz || (az == bz && ay > by)) {
    std::swap(ay, by);
    std::swap(az, bz);
  }
  return az <= z && z < bz && y > ay + (by - ay) * ((z - az) / (bz - az));
}

/// Whether a line along x at (y, z) passes through a triangle.
bool crossed(const Corners& t, double y, double z) {
  const bool one = beside(t.a[1], t.a[2], t.b[1], t.b[2], y, z);
  const bool other = beside(t.b[1], t.b[2], t.c[1], t.c[2], y, z);
  const bool last = beside(t.c[1], t.c[2], t.a[1], t.a[2], y, z);
  return (one != other) != last;
}

/// Where it does, no farther than the corners.
double along(const Corners& t, double y, double z) {
  const double ux = t.b[0] - t.a[0];
  const double uy = t.b[1] - t.a[1];
  const double uz = t.b[2] - t.a[2];
  const double vx = t.c[0] - t.a[0];
  const double vy = t.c[1] - t.a[1];
  const double vz = t.c[2] - t.a[2];
  const double nx = uy * vz - uz * vy;
  const double low = t.least(0);
  const double at =
      nx != 0 ? t.a[0] - ((uz * vx - ux * vz) * (y - t.a[1]) + (ux * vy - uy * vx) * (z - t.a[2])) / nx : low;
  return std::min(std::max(at, low), t.most(0));
}

}  // namespace

void toggle_points(View<const Vec3> vertices, Rows<const std::int64_t> triangles, View<const Vec3> points,
                   View<bool> odd) {
  constexpr int width = simd::lanes<double>;
  const Index count = std::ssize(points);
  const Index whole = (count + width - 1) / width * width;
  std::vector<double> y(whole, std::numeric_limits<double>::quiet_NaN());  // what is beyond the last is nowhere
  std::vector<double> z(y);
  for (Index n = 0; n < count; ++n) {
    y[n] = points[n][1];
    z[n] = points[n][2];
  }
  for (Index t = 0; t < triangles.rows(); ++t) {
    const Corners corners(vertices, triangles[t]);
    const double low_y = corners.least(1);
    const double high_y = corners.most(1);
    const double low_z = corners.least(2);
    const double high_z = corners.most(2);
    for (Index first = 0; first < whole; first += width) {
      const auto ys = simd::load<simd::Doubles>(&y[first]);
      const auto zs = simd::load<simd::Doubles>(&z[first]);
      if (!simd::any((ys >= low_y) & (ys <= high_y) & (zs >= low_z) & (zs <= high_z))) {
        continue;
      }
      for (Index n = first; n < std::min(first + width, count); ++n) {
        const bool near = low_y <= y[n] && y[n] <= high_y && low_z <= z[n] && z[n] <= high_z;
        if (near && crossed(corners, y[n], z[n])) {
          odd[n] ^= along(corners, y[n], z[n]) <= points[n][0];
        }
      }
    }
  }
}

void toggle_lines(View<const Vec3> vertices, Rows<const std::int64_t> triangles, Rows<const std::int64_t> lines,
                  View<const double> x, View<const double> y, View<const double> z, Tables<bool> odd) {
  for (Index t = 0; t < triangles.rows(); ++t) {
    const Corners corners(vertices, triangles[t]);
    for (Index j = lines(t, 0); j < lines(t, 1); ++j) {
      for (Index k = lines(t, 2); k < lines(t, 3); ++k) {
        if (crossed(corners, y[j], z[k])) {
          const auto first = std::lower_bound(x.begin(), x.end(), along(corners, y[j], z[k]));
          odd(j, k, first - x.begin()) ^= true;
        }
      }
    }
  }
}

}  // namespace lidarcfg::world
