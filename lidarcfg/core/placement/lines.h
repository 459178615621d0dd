/// Straight lines along one axis through a region, and what cuts them.
///
/// All is given with that axis first, then the other two in cyclic order.
#pragma once

#include <array>
#include <cmath>
#include <utility>
#include <vector>

#include "views.h"

namespace lidarcfg::placement {

constexpr Index lines_per_edge = 2;  // of a cuboid
constexpr double sliver = 1e-9;      // of an edge: a shorter piece is rounding's, between cones that coincide

/// Where a line crosses a surface.
struct Crossing {
  double at;      // along the line
  double weight;  // |n·e|, n the normal of the surface, e the line's direction
};

/// Crossings of a line, ascending.
class Crossings {
 public:
  void clear() { all_.clear(); }
  Index size() const { return std::ssize(all_); }
  const Crossing& operator[](Index n) const { return all_[n]; }

  /// Add one; of equal ones, it is the last.
  void insert(const Crossing& one) {
    all_.push_back(one);
    for (auto place = all_.end() - 1; place != all_.begin() && place[-1].at > one.at; --place) {
      std::swap(place[-1], place[0]);
    }
  }

 private:
  std::vector<Crossing> all_;
};

/// Crossings of lines, one line after the other.
struct LineCrossings {
  View<const std::int64_t> first;  // (L + 1,) the first of each line
  View<const double> at;           // (C,) ascending on each line
  View<const double> weight;       // (C,)

  Crossing operator[](Index n) const { return {at[n], weight[n]}; }
};

/// The same, as it is found.
struct FoundCrossings {
  std::vector<std::int64_t> first{0};
  std::vector<double> at;
  std::vector<double> weight;

  void add(const Crossing& one) {
    at.push_back(one.at);
    weight.push_back(one.weight);
  }
  void end_line() { first.push_back(std::ssize(at)); }
};

/// The lines: a lattice that is in step with no cone.
struct Lattice {
  Index axis;
  Vec3 low;                    // the region's corner
  Vec3 edge;                   // of a cuboid
  std::array<Index, 3> shape;  // cuboids

  /// Where a line runs, in edges from the region's corner.
  struct Across {
    double u, v;
  };

  Index count() const { return lines_per_edge * lines_per_edge * shape[1] * shape[2]; }
  double high() const { return low[0] + static_cast<double>(shape[0]) * edge[0]; }

  Across in_edges(Index line) const {
    constexpr double golden = 0.6180339887498949;  // (√5 − 1) / 2
    const double turns = static_cast<double>(line) * golden + 0.5;
    return {static_cast<double>(shape[1]) * (static_cast<double>(line) + 0.5) / static_cast<double>(count()),
            static_cast<double>(shape[2]) * (turns - std::floor(turns))};
  }

  /// The same in metres.
  Across place(Index line) const {
    const Across edges = in_edges(line);
    return {low[1] + edges.u * edge[1], low[2] + edges.v * edge[2]};
  }

  /// A point of a line, with its axes in the order x, y, z.
  Vec3 point(double along, const Across& across) const {
    Vec3 out;
    out[axis] = along;
    out[(axis + 1) % 3] = across.u;
    out[(axis + 2) % 3] = across.v;
    return out;
  }
};

}  // namespace lidarcfg::placement
