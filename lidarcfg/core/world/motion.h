/// Where whatever moves is at any time: a rotation, row by row, and a position.
#pragma once

#include <vector>

#include "views.h"

namespace lidarcfg::world {

using Matrix3 = std::array<double, 9>;  // row by row

/// A matrix times a vector.
inline Vec3 times(const Matrix3& m, const Vec3& v) {
  return {m[0] * v[0] + m[1] * v[1] + m[2] * v[2], m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
          m[6] * v[0] + m[7] * v[1] + m[8] * v[2]};
}

/// A matrix's transpose times a vector.
inline Vec3 transpose_times(const Matrix3& m, const Vec3& v) {
  return {m[0] * v[0] + m[3] * v[1] + m[6] * v[2], m[1] * v[0] + m[4] * v[1] + m[7] * v[2],
          m[2] * v[0] + m[5] * v[1] + m[8] * v[2]};
}

Matrix3 product(const Matrix3& m, const Matrix3& n);

struct Pose {
  Matrix3 R;
  Vec3 t;
};

/// A motion, in the frame at its time 0.
class Path {
 public:
  enum class Kind { velocity, arc, poses };

  /// One of several timed poses. To the next leads a rotation about one axis, given in the rotating frame.
  struct Timed {
    double time_s;
    Pose pose;
    Vec3 rotation_vector_rad;
  };

  static Path velocity(const Vec3& velocity_m_s);
  static Path arc(double speed_m_s, double yaw_rate_rad_s, double heading_rad);  // heading at time 0; 0 is along x
  static Path timed(std::vector<Timed> poses);                                   // two or more, whose times ascend

  Kind kind() const { return kind_; }
  const Vec3& velocity_m_s() const { return velocity_m_s_; }

  /// Before the first and after the last timed pose, the first and last segments are extrapolated.
  Pose at(double seconds) const;

 private:
  Pose along_arc(double seconds) const;
  Pose between(double seconds) const;

  Kind kind_ = Kind::velocity;
  Vec3 velocity_m_s_{};
  std::array<double, 2> arc_{};      // speed, m/s, and yaw rate, rad/s
  std::array<double, 2> heading_{};  // cosine and sine at time 0
  std::vector<Timed> poses_;
};

}  // namespace lidarcfg::world
