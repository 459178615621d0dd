/// What other bindings take of the world's.
#pragma once

#include "bind/arguments.h"
#include "world/world.h"

namespace lidarcfg::bind {

template <>
struct Fields<world::Found> {
  static constexpr auto members =
      fields(field("range_m", &world::Found::range_m), field("slot", &world::Found::slot),
             field("normal", &world::Found::normal), field("cosine", &world::Found::cosine));
};

/// Raises ValueError unless found has a row for each ray, or none where a column is not asked for.
inline void require_rows(const world::Found& found, Index rays) {
  require(std::ssize(found.range_m) == rays, "found.range_m: one for each ray");
  require(std::ssize(found.slot) == rays, "found.slot: one for each ray");
  require(found.normal.empty() || std::ssize(found.normal) == rays, "found.normal: one for each ray, or none");
  require(found.cosine.empty() || std::ssize(found.cosine) == rays, "found.cosine: one for each ray, or none");
}

}  // namespace lidarcfg::bind
