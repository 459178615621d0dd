/// One ray that goes through a hierarchy alone: where neighbours are so far apart that few triangles are hit by two.
#pragma once

#include "world/bvh.h"

namespace lidarcfg::world {

struct RayHit {
  double range;
  std::int32_t slot;  // or `no_slot`
};

/// What a ray along a unit vector hits first of a hierarchy up to a limit: what it does in a `Packet`, to the last bit.
RayHit first_hit(const Bvh& bvh, const Vec3& origin, const Vec3& direction, double limit);

}  // namespace lidarcfg::world
