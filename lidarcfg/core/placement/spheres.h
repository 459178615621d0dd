/// The largest spheres inside subspaces' cuboids: a search over the lattice of half cuboids.
///
/// A node 2x + p of the lattice is the lower face of cuboid x where p is 0, and its middle where p is 1. A sphere
/// around a node is as large as the nearest cuboid that is not of the node's subspace lets it be; from a node, the
/// nearest point of a face lies on the lattice too, so radii are exact.
#pragma once

#include <array>

#include "views.h"

namespace lidarcfg::placement {

using Word = std::uint64_t;
using Node = std::array<Index, 3>;

/// A sphere around a node.
struct Sphere {
  double square = 0.0;  // of the radius, in square metres
  Node centre{};
};

/// Set a bit for each cuboid, in columns along z, whose next one is in another subspace.
///
/// @param label  (nx, ny, nz) the subspace of each cuboid, −1 where it is excluded
/// @param ends   (nx, ny, words of 64 cuboids)
void find_ends(Tables<const std::int32_t> label, Tables<Word> ends);

/// The largest sphere in a subspace that lies within the cuboids from low to high, or, of number −1, in any.
///
/// Of equal spheres the first, by x, y, z.
///
/// @param label  (nx, ny, nz) the subspace of each cuboid, −1 where it is excluded
/// @param ends   see find_ends
/// @param half   half a cuboid, in metres
/// @param low    the first cuboid along each axis
/// @param high   the end of them, at most `label`'s
Sphere largest_sphere(Tables<const std::int32_t> label, Tables<const Word> ends, const Vec3& half, Index number,
                      const Node& low, const Node& high);

/// The squared distance of a node from the nearest face; 0 on one.
double clearance(Tables<const std::int32_t> label, const Vec3& half, const Node& node);

}  // namespace lidarcfg::placement
