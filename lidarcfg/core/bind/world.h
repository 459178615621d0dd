/// What other bindings take of the world's.
#pragma once

#include "bind/arguments.h"
#include "world/obstacles.h"
#include "world/shadow.h"
#include "world/world.h"

namespace lidarcfg::bind {

template <>
struct Fields<world::Found> {
  static constexpr auto members =
      fields(field("range_m", &world::Found::range_m), field("slot", &world::Found::slot),
             field("normal", &world::Found::normal), field("cosine", &world::Found::cosine));
};

template <>
struct Fields<world::Obstacles> {
  using O = world::Obstacles;
  static constexpr auto members =
      fields(field("tree", &O::tree), field<Shaped<Rows<const double>, 6, -1>>("boxes", &O::boxes),
             field<Shaped<Vec3, 3>>("origin_m", &O::origin_m), field("ground_m", &O::ground_m));
};

/// Raises ValueError unless obstacles have the boxes of a hierarchy.
inline void check_obstacles(const world::Obstacles& obstacles) {
  const Index boxes = obstacles.boxes.columns();
  require(boxes == 0 || boxes == world::shadow_boxes, "obstacles.boxes: neither (6, 16) nor (6, 0)");
}

/// Raises ValueError unless found has a row for each ray, or none where a column is not asked for.
inline void require_rows(const world::Found& found, Index rays) {
  using F = world::Found;
  require_columns(found, "found", "one for each ray", std::tuple(&F::range_m, &F::slot), rays);
  require(found.normal.empty() || std::ssize(found.normal) == rays, "found.normal: one for each ray, or none");
  require(found.cosine.empty() || std::ssize(found.cosine) == rays, "found.cosine: one for each ray, or none");
}

}  // namespace lidarcfg::bind
