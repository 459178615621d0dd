/// A LiDAR as VSR sees it: cones about an axis, and between which of them a point lies.
///
/// A point p is at or above beam k when sin(elevation_k) <= a·(p − t) / |p − t|, with the position t and the axis a.
/// What is compared are the signed squares, h |h| >= u_k |p − t|² with h = a·(p − t) and u_k = sin |sin|: no root is
/// needed. At the apex both sides are 0, so it is at or above every beam, as is every point within 1e-162 m, whose
/// squares vanish. A point on a cone counts as above it.
#pragma once

#include <cmath>

#include "views.h"

namespace lidarcfg::vsr {

/// A LiDAR, laid over a row of at least `first_beam` numbers: position, axis, and u_k of every beam.
struct Cones {
  static constexpr Index first_beam = 6;

  explicit Cones(View<const double> row)
      : position{row[0], row[1], row[2]}, axis{row[3], row[4], row[5]}, beams(row.subspan(first_beam)) {}

  Vec3 position;
  Vec3 axis;                 // unit, the sensor's z
  View<const double> beams;  // u_k, ascending; inf where a LiDAR has fewer beams than others
};

/// Of a point at d from the apex: on or above beam k if height >= u_k distance.
struct SignedSquares {
  double height;    // h |h|, h = a·d
  double distance;  // |d|²

  bool is_at_or_above(double beam) const { return height >= beam * distance; }
};

/// The order of operations is laid down: all that asks for a beam gap compares these, so that rounding decides alike.
inline SignedSquares signed_squares(double dx, double dy, double dz, const Vec3& axis) {
  const double height = (dx * axis[0] + dy * axis[1]) + dz * axis[2];
  return {height * std::abs(height), (dx * dx + dy * dy) + dz * dz};
}

/// The beam gap index of a point: how many cones of a LiDAR lie at or below it.
Index beam_gap(const Vec3& point, const Cones& lidar);

/// Write the beam gap index of points to out (points, lidars).
///
/// @param lidars  rows of `Cones`
void beam_gaps(View<const Vec3> points, Rows<const double> lidars, Rows<std::int64_t> out);

}  // namespace lidarcfg::vsr
