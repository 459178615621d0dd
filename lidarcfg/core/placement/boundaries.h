/// Where straight lines may cross the bounds of what a LiDAR sees, and where they do.
#pragma once

#include "placement/lines.h"

namespace lidarcfg::placement {

constexpr Index direction_bins = 1024;  // of directions from a LiDAR's foot

using Edge = std::array<double, 7>;      // ends, and |n·e| of the plane through the LiDAR
using Quadric = std::array<double, 10>;  // xᵀ M x + 2 b·x + c = 0: M by its rows from the diagonal on, b, c
using Round = std::array<double, 5>;     // centre of a sphere or base of a cylinder, radius, height (NaN: a sphere)

/// What may bound what a LiDAR sees, as lines along one axis meet it; all relative to the LiDAR.
///
/// Beyond an edge lies part of the plane through the LiDAR and the edge.
struct Bounds {
  Vec3 foot;  // the LiDAR
  View<const Edge> edges;
  View<const Quadric> quadrics;
  View<const std::int64_t> first;  // (direction_bins + 1,) the first item in each bin of directions across the lines
  View<const std::int64_t> item;   // (I,) edges, and the number of edges + quadrics
};

/// Some of the lines.
struct LineRange {
  Index begin, end;
};

/// Where lines may leave or enter what a LiDAR sees: at its bounds and at surfaces.
///
/// Of several within `sliver` of an edge of each other, or of the walls, one counts.
///
/// @param surfaces  of all lines
FoundCrossings find_candidates(const Lattice& lattice, LineRange lines, const Bounds& bounds,
                               const LineCrossings& surfaces);

/// Midpoints (C + lines,) of what lies between crossings of some lines, and the walls.
std::vector<Vec3> find_middles(const Lattice& lattice, LineRange lines, const LineCrossings& crossed);

/// Where states change along lines.
///
/// @param states  (C + L,) at what `find_middles` returns
/// @param start   (L,) the state that each line starts with; is written
FoundCrossings find_flips(const LineCrossings& crossed, View<const bool> states, View<bool> start);

/// Where lines enter the first of all closed parts, or leave the last; outside is true.
///
/// @param surfaces  from wherever the lines come
/// @param part      (C,) whose surface is crossed, below `parts`
/// @param start     (L,) the state that each line starts with; is written
FoundCrossings find_solid_flips(const Lattice& lattice, const LineCrossings& surfaces, View<const std::int64_t> part,
                                Index parts, View<bool> start);

/// Where lines pass through shapes: line, place along it, |n·e|, shape.
using ShapeCrossings = std::vector<std::array<double, 4>>;

/// A closed surface is crossed an even number of times by every line.
///
/// @param triangles  (T, 3) corners
ShapeCrossings cross_triangles(const Lattice& lattice, Rows<const Vec3> triangles);

/// Of spheres, and cylinders that are upright.
ShapeCrossings cross_rounds(const Lattice& lattice, View<const Round> rounds);

}  // namespace lidarcfg::placement
