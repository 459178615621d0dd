#include "viewer/raster.h"

#include <algorithm>
#include <cmath>

namespace lidarcfg::viewer {
namespace {

/// A triangle's corners in front of a plane: up to four.
struct Clipped {
  std::array<Vec3, 4> corner;
  int count = 0;

  Clipped(View<const Vec3> triangle, double near_m) {
    for (int i = 0; i < 3; ++i) {
      const Vec3& a = triangle[i];
      const Vec3& b = triangle[(i + 1) % 3];
      if (a[2] >= near_m) {
        corner[count++] = a;
      }
      if ((a[2] >= near_m) != (b[2] >= near_m)) {
        for (int k = 0; k < 3; ++k) {
          corner[count][k] = a[k] + (near_m - a[2]) / (b[2] - a[2]) * (b[k] - a[k]);
        }
        ++count;
      }
    }
  }
};

/// The pixels along one axis whose centres may lie between three coordinates.
struct Pixels {
  Index first, last;

  Pixels(double a, double b, double c, Index size)
      : first(std::max<Index>(static_cast<Index>(std::ceil(std::max(std::min({a, b, c}), -1.0) - 0.5)), 0)),
        last(std::min<Index>(static_cast<Index>(std::floor(std::min(std::max({a, b, c}), size + 1.0) - 0.5)),
                             size - 1)) {}
};

}  // namespace

Index blend_triangles(Tables<float> image, Rows<const float> depth_m, Rows<const Vec3> triangles,
                      View<const Vec3> colours, View<const double> alpha, double focal_px, double near_m) {
  const Index height = depth_m.rows();
  const Index width = depth_m.columns();
  Index blended = 0;
  for (Index t = 0; t < triangles.rows(); ++t) {
    Clipped clipped(triangles[t], near_m);
    for (int i = 0; i < clipped.count; ++i) {  // column, row and 1 / depth, which is linear in them
      Vec3& corner = clipped.corner[i];
      corner = {width / 2.0 + focal_px * corner[0] / corner[2], height / 2.0 - focal_px * corner[1] / corner[2],
                1 / corner[2]};
    }
    for (int k = 1; k < clipped.count - 1; ++k) {
      const Vec3& p = clipped.corner[0];
      const Vec3& q = clipped.corner[k];
      const Vec3& r = clipped.corner[k + 1];
      const double area = (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1]);
      if (area == 0 || !std::isfinite(area)) {
        continue;
      }
      const Pixels columns(p[0], q[0], r[0], width);
      const Pixels rows(p[1], q[1], r[1], height);
      for (Index row = rows.first; row <= rows.last; ++row) {
        for (Index column = columns.first; column <= columns.last; ++column) {
          const double x = column + 0.5;
          const double y = row + 0.5;
          const double u = ((x - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (y - p[1])) / area;
          const double v = ((q[0] - p[0]) * (y - p[1]) - (x - p[0]) * (q[1] - p[1])) / area;
          if (u < 0 || v < 0 || u + v > 1) {
            continue;
          }
          if ((p[2] + u * (q[2] - p[2]) + v * (r[2] - p[2])) * depth_m(row, column) > 1) {
            for (int c = 0; c < 3; ++c) {
              float& value = image(row, column, c);
              value = static_cast<float>(value + alpha[t] * (colours[t][c] - value));
            }
            ++blended;
          }
        }
      }
    }
  }
  return blended;
}

}  // namespace lidarcfg::viewer
