/// Casts rays, given as columns, at one hierarchy.
#pragma once

#include "world/bvh.h"

namespace lidarcfg::world {

/// Write how far rays (3, N) along unit vectors go up to a limit, inf where they hit nothing, and the slot that they
/// hit, or `no_slot`. It is fastest for neighbours in succession.
void first_hits(const Bvh& bvh, Rows<const double> origins, Rows<const double> directions, double limit_m,
                View<double> range_m, View<std::int32_t> slot);

/// Write which of the open segments (3, N) from origins along directions, to their ends, a hierarchy blocks.
///
/// A shape that only touches an end does not block. Rows of targets seen from one origin go fastest.
void any_hits(const Bvh& bvh, Rows<const double> origins, Rows<const double> directions, View<bool> hit);

}  // namespace lidarcfg::world
