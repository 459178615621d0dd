#include "placement/boundaries.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "world/shapes.h"

namespace lidarcfg::placement {
namespace {

constexpr double nan = std::numeric_limits<double>::quiet_NaN();

/// The bin of a direction in −π … π.
Index direction_bin(double angle) {
  return static_cast<Index>(std::floor((angle + std::numbers::pi) * (direction_bins / (2.0 * std::numbers::pi)))) %
         direction_bins;
}

/// Where the line at (du, dv) from a LiDAR's foot passes behind an edge, along the line; NaN: nowhere.
double pass_behind(const Edge& edge, double du, double dv) {
  const double p = du * edge[2] - dv * edge[1];
  const double q = du * edge[5] - dv * edge[4];
  if ((p >= 0.0) == (q >= 0.0)) {
    return nan;
  }
  const double part = p / (p - q);
  const double u = edge[1] + part * (edge[4] - edge[1]);
  const double v = edge[2] + part * (edge[5] - edge[2]);
  const double nearer = (du * u + dv * v) / (du * du + dv * dv);  // 1: the edge is on the line
  if (!(0.0 < nearer && nearer <= 1.0)) {
    return nan;
  }
  return (edge[0] + part * (edge[3] - edge[0])) / nearer;
}

/// Where the line at (u, v) crosses a quadric; NaN: nowhere.
std::array<double, 2> roots(const Quadric& q, double u, double v) {
  const double a = q[0];
  const double half = q[1] * u + q[2] * v + q[6];
  double rest = q[3] * u * u + 2.0 * q[4] * u * v + q[5] * v * v;
  rest += 2.0 * (q[7] * u + q[8] * v) + q[9];
  const double square = half * half - a * rest;
  if (square < 0.0) {
    return {nan, nan};
  }
  const double sum = -(half + (half >= 0.0 ? std::sqrt(square) : -std::sqrt(square)));
  return {sum / a, rest / sum};
}

/// |n·e| of a quadric at a point, e the first axis.
double steepness(const Quadric& q, double x, double u, double v) {
  const double along = q[0] * x + q[1] * u + q[2] * v + q[6];
  const double up = q[1] * x + q[3] * u + q[4] * v + q[7];
  const double away = q[2] * x + q[4] * u + q[5] * v + q[8];
  const double length = std::sqrt(along * along + up * up + away * away);
  return length > 0.0 ? std::abs(along) / length : 0.0;
}

/// Add where a line may cross a LiDAR's bounds between low and high.
void cross_bounds(const Bounds& bounds, const Lattice::Across& place, double low, double high, Crossings& out) {
  const Vec3& foot = bounds.foot;
  const double du = place.u - foot[1];
  const double dv = place.v - foot[2];
  const Index bin = direction_bin(std::atan2(dv, du));
  const Index edges = std::ssize(bounds.edges);
  for (const Index item : bounds.item.subspan(bounds.first[bin], bounds.first[bin + 1] - bounds.first[bin])) {
    if (item < edges) {
      const double at = foot[0] + pass_behind(bounds.edges[item], du, dv);
      if (low < at && at < high) {
        out.insert({at, bounds.edges[item][6]});
      }
      continue;
    }
    const Quadric& quadric = bounds.quadrics[item - edges];
    for (const double root : roots(quadric, du, dv)) {
      if (low < foot[0] + root && foot[0] + root < high) {
        out.insert({foot[0] + root, steepness(quadric, root, du, dv)});
      }
    }
  }
}

/// The lines whose first coordinate across is from low to high, and a few more.
LineRange lines_between(const Lattice& lattice, double low, double high) {
  const double count = static_cast<double>(lattice.count());
  const double scale = count / (static_cast<double>(lattice.shape[1]) * lattice.edge[1]);
  const auto number = [count](double line) { return line > 0.0 ? static_cast<Index>(std::min(line, count)) : 0; };
  return {number((low - lattice.low[1]) * scale - 2.0), number((high - lattice.low[1]) * scale + 2.0)};
}

/// Whether the half-line from (u, v) towards falling u crosses an edge; alike for both its directions.
bool is_left(double au, double av, double bu, double bv, double u, double v) {
  if (av > bv || (av == bv && au > bu)) {
    std::swap(au, bu);
    std::swap(av, bv);
  }
  return av <= v && v < bv && u > au + (bu - au) * ((v - av) / (bv - av));
}

double minimum(double a, double b, double c) { return std::min(std::min(a, b), c); }
double maximum(double a, double b, double c) { return std::max(std::max(a, b), c); }

}  // namespace

FoundCrossings find_candidates(const Lattice& lattice, LineRange lines, const Bounds& bounds,
                               const LineCrossings& surfaces) {
  const double low = lattice.low[0];
  const double high = lattice.high();
  const double least = sliver * lattice.edge[0];
  FoundCrossings out;
  Crossings some;
  for (Index line = lines.begin; line < lines.end; ++line) {
    some.clear();
    cross_bounds(bounds, lattice.place(line), low, high, some);
    for (Index f = surfaces.first[line]; f < surfaces.first[line + 1]; ++f) {
      some.insert(surfaces[f]);
    }
    double last = low;
    for (Index c = 0; c < some.size(); ++c) {
      if (some[c].at - last > least && high - some[c].at > least) {
        out.add(some[c]);
        last = some[c].at;
      }
    }
    out.end_line();
  }
  return out;
}

std::vector<Vec3> find_middles(const Lattice& lattice, LineRange lines, const LineCrossings& crossed) {
  std::vector<Vec3> out;
  out.reserve(crossed.at.size() + lines.end - lines.begin);
  for (Index line = lines.begin; line < lines.end; ++line) {
    const Lattice::Across place = lattice.place(line);
    const Index end = crossed.first[line - lines.begin + 1];
    double here = lattice.low[0];
    for (Index c = crossed.first[line - lines.begin]; c <= end; ++c) {
      const double there = c < end ? crossed.at[c] : lattice.high();
      out.push_back(lattice.point(0.5 * (here + there), place));
      here = there;
    }
  }
  return out;
}

FoundCrossings find_flips(const LineCrossings& crossed, View<const bool> states, View<bool> start) {
  FoundCrossings out;
  for (Index line = 0; line < std::ssize(start); ++line) {
    const View<const bool> state = states.subspan(line);  // before and after each crossing
    start[line] = state[crossed.first[line]];
    for (Index c = crossed.first[line]; c < crossed.first[line + 1]; ++c) {
      if (state[c + 1] != state[c]) {
        out.add(crossed[c]);
      }
    }
    out.end_line();
  }
  return out;
}

FoundCrossings find_solid_flips(const Lattice& lattice, const LineCrossings& surfaces, View<const std::int64_t> part,
                                Index parts, View<bool> start) {
  FoundCrossings out;
  std::vector<char> inside(parts);
  for (Index line = 0; line < std::ssize(start); ++line) {
    start[line] = true;
    Index count = 0;  // of parts that the line is inside of
    for (Index c = surfaces.first[line]; c < surfaces.first[line + 1]; ++c) {
      const bool outside = count == 0;
      inside[part[c]] ^= 1;
      count += inside[part[c]] ? 1 : -1;
      if ((count == 0) == outside) {
        continue;
      }
      if (surfaces.at[c] <= lattice.low[0]) {
        start[line] = count == 0;
      } else {
        out.add(surfaces[c]);
      }
    }
    std::fill(inside.begin(), inside.end(), 0);
    out.end_line();
  }
  return out;
}

ShapeCrossings cross_triangles(const Lattice& lattice, Rows<const Vec3> triangles) {
  ShapeCrossings out;
  for (Index t = 0; t < triangles.rows(); ++t) {
    const Vec3& a = triangles(t, 0);
    const Vec3& b = triangles(t, 1);
    const Vec3& c = triangles(t, 2);
    const Vec3 normal = world::normal(a, b, c);
    const double length = std::sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
    const double low = minimum(a[0], b[0], c[0]);
    const double high = maximum(a[0], b[0], c[0]);
    const double low_v = minimum(a[2], b[2], c[2]);
    const double high_v = maximum(a[2], b[2], c[2]);
    const LineRange lines = lines_between(lattice, minimum(a[1], b[1], c[1]), maximum(a[1], b[1], c[1]));
    for (Index line = lines.begin; line < lines.end; ++line) {
      const auto [u, v] = lattice.place(line);
      if (!(low_v <= v && v < high_v)) {
        continue;
      }
      if (is_left(a[1], a[2], b[1], b[2], u, v) ^ is_left(b[1], b[2], c[1], c[2], u, v) ^
          is_left(c[1], c[2], a[1], a[2], u, v)) {
        const double at = normal[0] != 0.0 ? a[0] - (normal[1] * (u - a[1]) + normal[2] * (v - a[2])) / normal[0] : low;
        out.push_back({static_cast<double>(line), std::min(std::max(at, low), high),
                       length > 0.0 ? std::abs(normal[0]) / length : 0.0, static_cast<double>(t)});
      }
    }
  }
  return out;
}

ShapeCrossings cross_rounds(const Lattice& lattice, View<const Round> rounds) {
  ShapeCrossings out;
  const Index up = (2 - lattice.axis) % 3;
  for (Index r = 0; r < std::ssize(rounds); ++r) {
    const auto [x, y, z, radius, height] = rounds[r];
    const bool cylinder = height >= 0.0;
    const double far = cylinder ? std::max(radius, height) : radius;
    const LineRange lines = lines_between(lattice, y - far, y + far);
    for (Index line = lines.begin; line < lines.end; ++line) {
      const auto [u, v] = lattice.place(line);
      const double du = u - y;
      const double dv = v - z;
      const double off = cylinder && up == 2 ? std::abs(du) : cylinder && up == 1 ? std::abs(dv) : std::hypot(du, dv);
      const double level = up == 2 ? dv : du;
      if (off >= radius || (cylinder && up > 0 && !(0.0 <= level && level <= height))) {
        continue;
      }
      const double half = std::sqrt((radius - off) * (radius + off));
      const bool along = cylinder && up == 0;
      const double low = along ? x : x - half;
      const double high = along ? x + height : x + half;
      const double weight = along ? 1.0 : half / radius;
      for (const double at : {low, high}) {
        out.push_back({static_cast<double>(line), at, weight, static_cast<double>(r)});
      }
    }
  }
  return out;
}

}  // namespace lidarcfg::placement
