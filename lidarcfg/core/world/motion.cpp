#include "world/motion.h"

#include <cmath>
#include <utility>

#include "maths.h"

namespace lidarcfg::world {

Matrix3 product(const Matrix3& m, const Matrix3& n) {
  const Vec3 a = times(m, {n[0], n[3], n[6]});
  const Vec3 b = times(m, {n[1], n[4], n[7]});
  const Vec3 c = times(m, {n[2], n[5], n[8]});
  return {a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2]};
}

Path Path::velocity(const Vec3& velocity_m_s) {
  Path out;
  out.velocity_m_s_ = velocity_m_s;
  return out;
}

Path Path::arc(double speed_m_s, double yaw_rate_rad_s, double heading_rad) {
  Path out;
  out.kind_ = Kind::arc;
  out.arc_ = {speed_m_s, yaw_rate_rad_s};
  const auto [cosine, sine] = cos_sin_of_any(heading_rad);
  out.heading_ = {cosine, sine};
  return out;
}

Path Path::timed(std::vector<Timed> poses) {
  Path out;
  out.kind_ = Kind::poses;
  out.poses_ = std::move(poses);
  return out;
}

Pose Path::at(double seconds) const {
  switch (kind_) {
    case Kind::arc:
      return along_arc(seconds);
    case Kind::poses:
      return between(seconds);
    default:
      return {{1, 0, 0, 0, 1, 0, 0, 0, 1},
              {velocity_m_s_[0] * seconds, velocity_m_s_[1] * seconds, velocity_m_s_[2] * seconds}};
  }
}

/// Along a circle at a constant speed.
Pose Path::along_arc(double seconds) const {
  const auto [speed_m_s, rate_rad_s] = arc_;
  const double half = seconds * rate_rad_s / 2;
  const auto [c, s] = cos_sin_of_any(half);
  const double chord_m = speed_m_s * seconds * (half != 0 ? s / half : 1.0);
  const auto [cos_0, sin_0] = heading_;
  const double yawed = 1 - 2 * s * s;
  return {{yawed, -2 * s * c, 0, 2 * s * c, yawed, 0, 0, 0, 1},
          {chord_m * (c * cos_0 - s * sin_0), chord_m * (s * cos_0 + c * sin_0), 0}};
}

/// Between a pose and the next: along a straight line and about one axis, both at a constant rate.
Pose Path::between(double seconds) const {
  Index low = 0;
  Index high = std::ssize(poses_) - 2;
  while (low < high) {  // the last pose but one that is not later
    const Index middle = (low + high + 1) / 2;
    if (poses_[middle].time_s <= seconds) {
      low = middle;
    } else {
      high = middle - 1;
    }
  }
  const Timed& one = poses_[low];
  const Timed& next = poses_[low + 1];
  const double part = (seconds - one.time_s) / (next.time_s - one.time_s);
  const double x = part * one.rotation_vector_rad[0];
  const double y = part * one.rotation_vector_rad[1];
  const double z = part * one.rotation_vector_rad[2];
  const double angle = std::sqrt(x * x + y * y + z * z);
  const double a = angle > 0 ? lidarcfg::sin(angle) / angle : 1.0;
  const double chord = angle > 0 ? lidarcfg::sin(angle / 2) / angle : 0.5;
  const double b = 2 * (chord * chord);
  const Matrix3 turn{1 - b * (y * y + z * z), b * x * y - a * z,       b * x * z + a * y,
                     b * x * y + a * z,       1 - b * (x * x + z * z), b * y * z - a * x,
                     b * x * z - a * y,       b * y * z + a * x,       1 - b * (x * x + y * y)};
  Pose out{product(one.pose.R, turn), one.pose.t};
  for (int axis = 0; axis < 3; ++axis) {
    out.t[axis] += part * (next.pose.t[axis] - one.pose.t[axis]);
  }
  return out;
}

}  // namespace lidarcfg::world
