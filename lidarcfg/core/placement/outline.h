/// The outline of bodies, from above.
#pragma once

#include "views.h"

namespace lidarcfg::placement {

/// Raise `out` (directions,) to where rays from the origin cross the edges of triangles (T, 3) of points (V, 2).
///
/// Direction k is 2π k / directions, counter-clockwise from x. Edges of points that are not finite count for nothing.
void trace_outline(Rows<const double> points, Rows<const std::int64_t> triangles, View<double> out);

}  // namespace lidarcfg::placement
