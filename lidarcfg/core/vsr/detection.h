/// Boxes against the subspaces that they touch.
#pragma once

#include <array>
#include <vector>

#include "views.h"

namespace lidarcfg::vsr {

/// Places of a box of whole cuboids, by its lowest cuboid along x and y, summed over its layers.
struct PlaceCounts {
  Index columns = 0, rows = 0;         // places along x and y
  std::vector<std::int64_t> detected;  // (columns, rows) where it touches enough subspaces
  std::vector<std::int64_t> places;    // (columns, rows) where it can be
};

/// At how many places a box of cuboids touches more than `threshold` subspaces, and how many places there are.
///
/// A place counts when the whole box lies inside the grid and contains no excluded cuboid.
///
/// @param labels  (nx, ny, nz) the subspace of each cuboid, −1 where it is excluded
/// @param size    of the box in cuboids, 1 to the grid's
/// @param layers  the box's lowest layer is one of the first so many
/// @param misses  ends after so many places without detection
/// @param held    (n,) is set for subspaces that a box at some place lies in; or none
PlaceCounts detected_positions(Tables<const std::int32_t> labels, const std::array<Index, 3>& size, Index threshold,
                               Index layers, Index misses, View<bool> held);

/// Of some boxes, in the order of their fields.
struct BoxCounts {
  Index detected;  // touch more than so many subspaces
  Index free;      // touch no excluded cuboid
};

/// How many of some boxes touch more than `threshold` subspaces, and how many touch no excluded cuboid.
///
/// A box touches a cuboid if their interiors intersect (separating axes).
///
/// @param labels  (nx, ny, nz) the subspace of each cuboid, −1 where it is excluded
/// @param low     the lower corner of the first cuboid
/// @param edge    of a cuboid
/// @param boxes   centre x and y, bottom z, heading
/// @param size    of each box, in metres
BoxCounts detected_boxes(Tables<const std::int32_t> labels, const Vec3& low, const Vec3& edge,
                         View<const std::array<double, 4>> boxes, const Vec3& size, Index threshold);

}  // namespace lidarcfg::vsr
