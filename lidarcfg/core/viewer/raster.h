/// Draws translucent triangles behind and in front of points.
#pragma once

#include "views.h"

namespace lidarcfg::viewer {

/// Blend triangles, far to near, into an image where they are nearer than a depth; returns how many pixels are blended.
///
/// Corners are right, up and ahead of the camera in metres; what is nearer than `near_m` is clipped.
///
/// @param image      (H, W, 3)
/// @param depth_m    (H, W)
/// @param triangles  (T, 3) corners
/// @param colours    (T,) as the image's
/// @param alpha      (T,) 0 to 1
Index blend_triangles(Tables<float> image, Rows<const float> depth_m, Rows<const Vec3> triangles,
                      View<const Vec3> colours, View<const double> alpha, double focal_px, double near_m);

}  // namespace lidarcfg::viewer
