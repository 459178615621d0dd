/// Which cuboids of a whole grid LiDARs see.
#pragma once

#include "vsr/grid.h"
#include "vsr/visibility.h"

namespace lidarcfg::vsr {

/// The centres of a row that has cuboids that count.
inline Centres centres_of(const Grid& grid, Index row) {
  const RowPlace place = grid.place(row);
  return {&grid.x[place.first], place.y, place.z, grid.edge[0]};
}

/// Write which cuboids of a grid a LiDAR sees; what the cache knows is taken from there.
///
/// @param lidar  its row in `cones`, `sight` and the cache
/// @param seen   (rows,)
void find_seen(const Grid& grid, Index lidar, Rows<const double> cones, const Sight& sight, VisibilityCache& cache,
               View<Word> seen);

}  // namespace lidarcfg::vsr
