/// What the beams of firings hit: in the world, and of the vehicle that carries the sensor.
#pragma once

#include "simulate/aim.h"
#include "simulate/echoes.h"
#include "simulate/firings.h"
#include "world/world.h"

namespace lidarcfg::simulate {

/// Which objects are hit, and how they reflect.
struct Surfaces {
  View<const std::int32_t> object;        // by slot: of nothing, the ground, the world's shapes, the vehicle's bodies
  View<const std::uint8_t> reflectivity;  // by object: of `no_object`, then of the others
};

/// A sensor in a world, and among the bodies of its vehicle, which are in the vehicle's frame.
struct Stage {
  const world::World& world;
  const world::Bvh& bodies;
  Surfaces surfaces;
  Lasers lasers;
  Mounting mounting;
  std::int64_t zero_ns;  // time 0 of the moving objects
  double limit_m;        // no ray goes farther
};

/// What the K rays of N firings hit, to be written.
struct Hits {
  Rows<double> range_m;             // (N, K) inf: nothing
  Rows<std::uint8_t> reflectivity;  // (N, K)
  Rows<std::int32_t> object;        // (N, K)
  Rows<double> cosine;              // (N, K) of the angle between ray and normal; or without rows
};

/// Find what the rays of firings hit.
void trace_firings(const Stage& stage, const Firings& firings, const Hits& hits);

}  // namespace lidarcfg::simulate
