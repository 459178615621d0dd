/// Sight and Obstacles from the NamedTuples of lidarcfg/vsr/visibility.py and world/tracer.py.
#pragma once

#include "bind/arguments.h"
#include "vsr/visibility.h"

namespace lidarcfg::bind {

template <>
struct Fields<world::Obstacles> {
  using O = world::Obstacles;
  static constexpr auto members = fields(field("tree", &O::tree), field("boxes", &O::boxes),
                                         field("origin_m", &O::origin_m), field("ground_m", &O::ground_m));
};

template <>
struct Fields<vsr::Sight> {
  using S = vsr::Sight;
  static constexpr auto members = fields(field("limits", &S::limits), field("obstacles", &S::obstacles));
};

inline void check_obstacles(const world::Obstacles& obstacles, const char* message) {
  const Index boxes = obstacles.boxes.columns();
  require(obstacles.boxes.rows() == 6 && (boxes == 0 || boxes == world::shadow_boxes), message);
}

/// What of a sight can be wrong, for `lidars` LiDARs.
inline void check_sight(const vsr::Sight& sight, Index lidars) {
  require(sight.limits.columns() == vsr::limit_columns, "sight.limits: nine columns");
  require(!sight.limited() || sight.limits.rows() >= lidars, "sight.limits: a row for each LiDAR, or none");
  check_obstacles(sight.obstacles, "sight.obstacles.boxes: neither (6, 16) nor (6, 0)");
}

}  // namespace lidarcfg::bind
