/// All connected subspaces of a grid, by flooding one after the other.
#pragma once

#include <vector>

#include "vsr/grid.h"

namespace lidarcfg::vsr {

/// Subspaces in the raster order of their first cuboids.
struct Components {
  std::vector<std::int64_t> cuboids;   // (n,) in each
  std::vector<std::int64_t> internal;  // (n, 3) the faces inside each, across x, y and z
  std::vector<std::int64_t> first;     // (n,) the first cuboid of each, as an index into the flat label
};

/// Label the connected subspaces of a grid.
///
/// @param links  (rows,) of all LiDARs
/// @param label  (nx, ny, nz) the number of each cuboid's subspace, −1 where it does not count; is written
Components label_components(const Grid& grid, View<const Links> links, Tables<std::int32_t> label);

}  // namespace lidarcfg::vsr
