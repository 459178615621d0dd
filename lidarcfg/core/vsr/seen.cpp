#include "vsr/seen.h"

namespace lidarcfg::vsr {

void find_seen(const Grid& grid, Index lidar, Rows<const double> cones, const Sight& sight, VisibilityCache& cache,
               View<Word> seen) {
  cache.start(lidar, cones, sight.obstacles);
  for (Index row = grid.first_row(); row < grid.end_row(); ++row) {
    if (grid.included[row]) {
      cache.update(lidar, row, centres_of(grid, row), grid.included[row], cones, sight);
    }
  }
  cache.flush(lidar, sight);
  const View<const Word> clear = cache.clear(lidar);
  for (Index row = grid.first_row(); row < grid.end_row(); ++row) {
    if (grid.included[row]) {
      const Word in_sector = in_field(centres_of(grid, row), cones[lidar], sight.limits[lidar]);
      seen[row] = clear[row] & grid.included[row] & in_sector;
    }
  }
}

}  // namespace lidarcfg::vsr
