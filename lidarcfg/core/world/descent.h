#pragma once

/// How rays go down a hierarchy, alone (ray) or several together (packet).

#include <cstdint>

#include "world/bvh.h"

namespace lidarcfg::world {

constexpr float wider = 4e-7f;      // by which intervals are, for float32
constexpr double pad_m = 1e-9;      // the same of origins
constexpr float flattest = 1e-28f;  // of a direction's component: its inverse is finite
constexpr float farthest = 1e38f;
constexpr int stack_size = (node_size - 1) * most_levels + 1;

/// A node, or a leaf, that waits to be entered, and from where on a ray may be in it.
struct Waiting {
  float near;
  std::int32_t code;
};

}  // namespace lidarcfg::world
