/// The analytic measure: volume and surface of subspaces, by lines that are cut where cones cross them.
///
/// Where a line crosses a cone is known in closed form, and so is the cone's normal n there. What lies between two
/// crossings has the same beam gaps all along; it hands its length to its subspace's volume, and at either end |n·e|,
/// e the line's direction, to its surface.
#pragma once

#include "placement/lines.h"

namespace lidarcfg::placement {

/// A grid as lines along one axis see it: that axis first, then the other two in cyclic order.
struct Sheaf {
  Index axis;
  Tables<const std::int32_t> label;  // the subspace of each cuboid, −1 where it is excluded
  Tables<const bool> within;         // of the region, or cut by a body that is not
  Vec3 low;                          // the region's corner
  Vec3 edge;                         // of a cuboid
  Rows<const double> cones;          // (lidars, 6 + beams) position, axis and sines; NaN where there are fewer beams

  Lattice lattice() const { return {axis, low, edge, {label.tables(), label.rows(), label.columns()}}; }
};

/// Where states change along lines: what each LiDAR sees of them; last, what of them no body fills.
struct Flips {
  Rows<const bool> start;          // (lidars + 1, L) the state at the region's lower wall
  View<const std::int64_t> first;  // (states L + 1,) the first flip of each state and line
  View<const double> at;           // (F,) ascending for each
  View<const double> weight;       // (F,) |n·e|, n the normal of the surface crossed there
};

/// What lines along one axis add up, by subspace.
struct Sums {
  View<double> volume;        // (n,)
  View<double> shadow;        // (n,)
  View<double> surface;       // (n,)
  View<std::int64_t> parent;  // (n,) the union-find of subspaces that are one
};

/// Add where the line at (u, v) crosses a LiDAR's cones between low and high.
///
/// @param cone  (6 + beams,) position and axis in the line's frame (along, u, v), and sines of elevations
void cross_cones(const Lattice::Across& across, View<const double> cone, double low, double high, Crossings& out);

/// Add what the lines see of subspaces.
///
/// @param gap   (n, lidars) the beam gaps of each subspace, −1 where the LiDAR does not see it
/// @param rows  (lidars, 6 + beams) rows of `Cones`
void sweep_lines(const Sheaf& sheaf, Rows<const std::int64_t> gap, Rows<const double> rows, const Flips& flips,
                 const Sums& sums);

}  // namespace lidarcfg::placement
