#include "simulate/aim.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "angles.h"

namespace lidarcfg::simulate {

using world::Pose;
using world::times;

void Poses::set(int n, const Pose& pose) {
  for (int k = 0; k < 9; ++k) {
    R[k][n] = pose.R[k];
  }
  for (int axis = 0; axis < 3; ++axis) {
    t[axis][n] = pose.t[axis];
  }
}

template <int Width>
Aim<Width>::Aim(const Lasers& lasers, const Mounting& mounting) : lasers_(lasers), mounting_(mounting) {
  turns_ = mounting_.path->kind() != world::Path::Kind::velocity;
  velocity_m_s_ = times(mounting_.T_world_start.R, mounting_.path->velocity_m_s());
  for (beams_ = 0; beams_ < most_beams; ++beams_) {
    vehicle_.set(beams_, mounting_.path->at(0.0));
    in_vehicle_.set(beams_, mounting_.T_vehicle_sensor);
  }
  mount();
  start_m_ = {in_world_.t[0][0], in_world_.t[1][0], in_world_.t[2][0]};
}

template <int Width>
void Aim<Width>::set(const Firings& firings, View<const Index> which, Index laser) {
  beams_ = static_cast<int>(which.size());
  for (int n = 0; n < beams_; ++n) {
    encoder_rad_[n] = firings.encoder_rad[which[n]];
  }
  move(firings, which);
  raise(firings, which, laser);
  point(laser);
  start(firings, which);
  spread();
}

/// Find where the sensor is in the world, from where the vehicle is on its path.
template <int Width>
void Aim<Width>::mount() {
  const world::Pose& start = mounting_.T_world_start;
  const world::Pose& sensor = mounting_.T_vehicle_sensor;
  for (int axis = 0; axis < 3; ++axis) {
    const auto [a, b, c] = std::array{start.R[3 * axis], start.R[3 * axis + 1], start.R[3 * axis + 2]};
    Lanes R_world_vehicle[3];  // a row of it
    for (int k = 0; k < 3; ++k) {
      for (int n = 0; n < beams_; ++n) {
        R_world_vehicle[k][n] = a * vehicle_.R[k][n] + b * vehicle_.R[3 + k][n] + c * vehicle_.R[6 + k][n];
      }
    }
    const auto& [x, y, z] = R_world_vehicle;
    for (int k = 0; k < 3; ++k) {
      for (int n = 0; n < beams_; ++n) {
        in_world_.R[3 * axis + k][n] = x[n] * sensor.R[k] + y[n] * sensor.R[3 + k] + z[n] * sensor.R[6 + k];
      }
    }
    for (int n = 0; n < beams_; ++n) {
      const double mounted = x[n] * sensor.t[0] + y[n] * sensor.t[1] + z[n] * sensor.t[2];
      const double driven = a * vehicle_.t[0][n] + b * vehicle_.t[1][n] + c * vehicle_.t[2][n];
      in_world_.t[axis][n] = mounted + (driven + start.t[axis]);
    }
  }
}

/// Find where the sensor is at each firing.
template <int Width>
void Aim<Width>::move(const Firings& firings, View<const Index> which) {
  const int beams = beams_;
  Lanes path_s;
  for (int n = 0; n < beams; ++n) {
    path_s[n] = seconds_between(mounting_.zero_ns, firings.time_ns[which[n]]);
  }
  if (turns_) {
    for (int n = 0; n < beams; ++n) {
      vehicle_.set(n, mounting_.path->at(path_s[n]));
    }
    mount();
    return;
  }
  for (int axis = 0; axis < 3; ++axis) {
    for (int n = 0; n < beams; ++n) {
      in_world_.t[axis][n] = start_m_[axis] + velocity_m_s_[axis] * path_s[n];
    }
  }
}

/// Find how high beams point.
template <int Width>
void Aim<Width>::raise(const Firings& firings, View<const Index> which, Index laser) {
  if (firings.elevation_rad.empty()) {
    std::fill_n(cos_elevation_, beams_, lasers_.cos_elevation[laser]);
    std::fill_n(sin_elevation_, beams_, lasers_.sin_elevation[laser]);
    return;
  }
  for (int n = 0; n < beams_; ++n) {
    const auto [cos, sin] = cos_sin(firings.elevation_rad[which[n]]);
    cos_elevation_[n] = cos;
    sin_elevation_[n] = sin;
  }
}

/// Find where beams start, and their axes: the directions of a beam's first ray, for now.
template <int Width>
void Aim<Width>::point(Index laser) {
  const double cos_offset = lasers_.cos_offset[laser];
  const double sin_offset = lasers_.sin_offset[laser];
  const double forward_m = lasers_.forward_m[laser];
  const double left_m = lasers_.left_m[laser];
  const double up_m = lasers_.up_m[laser];
  Vectors<most_beams>& axes = directions_[0];
  for (int n = 0; n < beams_; ++n) {
    const auto [cos_head, sin_head] = cos_sin(encoder_rad_[n]);
    const double c = cos_head * cos_offset - sin_head * sin_offset;
    const double s = sin_head * cos_offset + cos_head * sin_offset;
    axes[0][n] = cos_elevation_[n] * c;
    axes[1][n] = -cos_elevation_[n] * s;
    axes[2][n] = sin_elevation_[n];
    starts_[0][n] = left_m * s + forward_m * cos_head;
    starts_[1][n] = left_m * c - forward_m * sin_head;
    starts_[2][n] = up_m;
  }
}

/// Find where beams start, if firings say it themselves.
template <int Width>
void Aim<Width>::start(const Firings& firings, View<const Index> which) {
  if (!firings.start_m.rows()) {
    return;
  }
  for (int axis = 0; axis < 3; ++axis) {
    for (int n = 0; n < beams_; ++n) {
      starts_[axis][n] = firings.start_m(which[n], axis);
    }
  }
}

/// Find the directions of all rays.
template <int Width>
void Aim<Width>::spread() {
  if (Width == thin && lasers_.across[0] == 0 && lasers_.above[0] == 0) {
    return;
  }
  const Vectors<most_beams> axes = directions_[0];
  Lanes right[2];  // unit vectors to the right of the axes, in the plane
  for (int n = 0; n < beams_; ++n) {
    const double flat = std::sqrt(axes[0][n] * axes[0][n] + axes[1][n] * axes[1][n]);
    right[0][n] = axes[1][n] / flat;
    right[1][n] = -axes[0][n] / flat;
  }
  for (int ray = 0; ray < Width; ++ray) {
    const double across = lasers_.across[ray];
    const double above = lasers_.above[ray];
    Vectors<most_beams>& out = directions_[ray];
    if (across == 0 && above == 0) {
      out = axes;
      continue;
    }
    for (int n = 0; n < beams_; ++n) {
      const double u = right[0][n];
      const double v = right[1][n];
      const double x = axes[0][n] + across * u + above * (v * axes[2][n]);  // above is right times the axis
      const double y = axes[1][n] + across * v - above * (u * axes[2][n]);
      const double z = axes[2][n] + above * (u * axes[1][n] - v * axes[0][n]);
      const double length = std::sqrt(x * x + y * y + z * z);
      out[0][n] = x / length;
      out[1][n] = y / length;
      out[2][n] = z / length;
    }
  }
}

/// Bring rays from the sensor's frame into another.
template <int Width>
void Aim<Width>::place(const Poses& poses, Rays<Width>& rays) const {
  const auto& R = poses.R;
  for (int axis = 0; axis < 3; ++axis) {
    const double* const a = R[3 * axis];
    const double* const b = R[3 * axis + 1];
    const double* const c = R[3 * axis + 2];
    Lanes value;
    for (int n = 0; n < beams_; ++n) {
      value[n] = a[n] * starts_[0][n] + b[n] * starts_[1][n] + c[n] * starts_[2][n] + poses.t[axis][n];
    }
    for (int n = 0; n < beams_; ++n) {
      std::fill_n(rays.origins[axis] + n * Width, Width, value[n]);
    }
    for (int ray = 0; ray < Width; ++ray) {
      const Vectors<most_beams>& from = directions_[ray];
      for (int n = 0; n < beams_; ++n) {
        value[n] = a[n] * from[0][n] + b[n] * from[1][n] + c[n] * from[2][n];
      }
      for (int n = 0; n < beams_; ++n) {
        rays.directions[axis][n * Width + ray] = value[n];
      }
    }
  }
}

template class Aim<thin>;
template class Aim<wide>;

void aim_firings(const Lasers& lasers, const Mounting& mounting, const Firings& firings, Rows<double> origins_m,
                 Rows<double> directions) {
  const Batches batches = divide(firings, most_beams, 0);
  Aim<thin> aim(lasers, mounting);
  Rays<thin> rays;
  for (Index b = 0; b < batches.count(); ++b) {
    const View<const Index> which = batches[b];
    aim.set(firings, which, firings.laser[which[0]]);
    aim.in_world(rays);
    for (int axis = 0; axis < 3; ++axis) {
      for (Index n = 0; n < std::ssize(which); ++n) {
        origins_m(which[n], axis) = rays.origins[axis][n];
        directions(which[n], axis) = rays.directions[axis][n];
      }
    }
  }
}

}  // namespace lidarcfg::simulate
