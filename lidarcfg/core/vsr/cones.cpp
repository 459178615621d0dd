#include "vsr/cones.h"

namespace lidarcfg::vsr {

Index beam_gap(const Vec3& point, const Cones& lidar) {
  const SignedSquares squares = signed_squares(point[0] - lidar.position[0], point[1] - lidar.position[1],
                                               point[2] - lidar.position[2], lidar.axis);
  Index low = 0;
  Index high = std::ssize(lidar.beams);
  while (low < high) {
    const Index beam = (low + high) / 2;
    if (squares.is_at_or_above(lidar.beams[beam])) {
      low = beam + 1;
    } else {
      high = beam;
    }
  }
  return low;
}

void beam_gaps(View<const Vec3> points, Rows<const double> lidars, Rows<std::int64_t> out) {
  for (Index n = 0; n < std::ssize(points); ++n) {
    for (Index lidar = 0; lidar < lidars.rows(); ++lidar) {
      out(n, lidar) = beam_gap(points[n], Cones(lidars[lidar]));
    }
  }
}

}  // namespace lidarcfg::vsr
