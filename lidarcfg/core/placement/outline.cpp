#include "placement/outline.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace lidarcfg::placement {
namespace {

constexpr double slack = 1e-9;  // of a step, by which a direction may miss an edge's end, for rounding

struct Point {
  double x;
  double y;
};

/// How far along a ray with this cosine and sine it crosses the segment from p to q.
double crossing(Point p, Point q, double cosine, double sine) {
  const double across = cosine * (q.y - p.y) - sine * (q.x - p.x);
  if (across != 0.0) {
    return (p.x * q.y - p.y * q.x) / across;
  }
  return std::max(cosine * p.x + sine * p.y, cosine * q.x + sine * q.y);  // the segment lies along the ray
}

}  // namespace

void trace_outline(Rows<const double> points, Rows<const std::int64_t> triangles, View<double> out) {
  const Index count = std::ssize(out);
  const double step = 2 * std::numbers::pi / static_cast<double>(count);
  const auto point = [&](std::int64_t vertex) { return Point{points(vertex, 0), points(vertex, 1)}; };
  for (Index t = 0; t < triangles.rows(); ++t) {
    for (Index corner = 0; corner < 3; ++corner) {
      const Point p = point(triangles(t, corner));
      const Point q = point(triangles(t, (corner + 1) % 3));
      const double first = std::atan2(p.y, p.x);
      // From one end to the other, less than half around.
      const double turn = std::atan2(p.x * q.y - p.y * q.x, p.x * q.x + p.y * q.y);
      const double low = std::min(first, first + turn);
      const double high = std::max(first, first + turn);
      if (!std::isfinite(low) || !std::isfinite(high)) {
        continue;
      }
      const auto last = static_cast<Index>(std::floor(high / step + slack));
      for (auto k = static_cast<Index>(std::ceil(low / step - slack)); k <= last; ++k) {
        const double angle = static_cast<double>(k) * step;
        double& farthest = out[(k % count + count) % count];
        farthest = std::max(farthest, crossing(p, q, std::cos(angle), std::sin(angle)));
      }
    }
  }
}

}  // namespace lidarcfg::placement
