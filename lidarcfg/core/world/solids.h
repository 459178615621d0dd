/// Which points are inside closed meshes, whose triangles are vertices (V, 3) and indices (T, 3) of their corners.
///
/// A line along x enters and leaves a closed part an even number of times: whether it passes through a triangle is
/// found edge by edge, by the same numbers for both neighbours, so that it cannot pass between them.
#pragma once

#include "views.h"

namespace lidarcfg::world {

/// Toggle odd (N,) for each triangle that is crossed on the way along x to points (N,).
void toggle_points(View<const Vec3> vertices, Rows<const std::int64_t> triangles, View<const Vec3> points,
                   View<bool> odd);

/// Toggle odd (ny, nz, nx + 1) at the first point beyond each triangle, on every line along x that crosses it; x, y and
/// z ascend.
///
/// @param lines  (T, 4) those that may cross a triangle: from and to an index of y, and of z
void toggle_lines(View<const Vec3> vertices, Rows<const std::int64_t> triangles, Rows<const std::int64_t> lines,
                  View<const double> x, View<const double> y, View<const double> z, Tables<bool> odd);

}  // namespace lidarcfg::world
