/// What blocks beams.
#pragma once

#include "views.h"
#include "world/bvh.h"

namespace lidarcfg::world {

/// What blocks beams, relative to a point.
struct Obstacles {
  const Bvh* tree;
  Rows<const double> boxes;  // (6, B) that hold its shapes, see boxes_of
  Vec3 origin_m;             // the point, in the vehicle frame
  double ground_m;           // height of the ground in the vehicle frame; inf: none
};

}  // namespace lidarcfg::world
