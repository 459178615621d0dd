/// Where the beams of firings start and point, from encoder angles and the motion of the vehicle.
#pragma once

#include "simulate/firings.h"
#include "views.h"
#include "world/motion.h"

namespace lidarcfg::simulate {

constexpr int most_beams = 32;  // that are aimed at a time
constexpr int thin = 1;         // rays of a beam
constexpr int wide = 9;

/// The L lasers of a sensor, and the K rays of a beam of each: `thin` or `wide`.
struct Lasers {
  View<const double> cos_elevation;  // (L,)
  View<const double> sin_elevation;  // (L,)
  View<const double> cos_offset;     // (L,) of the azimuth
  View<const double> sin_offset;     // (L,)
  View<const double> forward_m;      // (L,)
  View<const double> left_m;         // (L,)
  View<const double> up_m;           // (L,)
  View<const double> across;         // (K,) tangents of the angles by which the rays of a beam leave its axis
  View<const double> above;          // (K,)
};

/// Where a sensor is: mounted in a vehicle that moves along a path in the world. All relative to a local origin.
struct Mounting {
  world::Pose T_world_start;
  const world::Path* path;
  std::int64_t zero_ns;  // its time 0
  world::Pose T_vehicle_sensor;
};

/// Vectors by components.
template <int N>
struct Vectors {
  alignas(32) double of[3][N];

  double* operator[](int axis) { return of[axis]; }
  const double* operator[](int axis) const { return of[axis]; }
  operator Rows<const double>() const { return {of[0], 3, N}; }
};

/// Poses, one for each firing.
struct Poses {
  alignas(32) double R[9][most_beams];
  Vectors<most_beams> t;

  void set(int n, const world::Pose& pose);
};

/// The rays of beams of so many, beam by beam.
template <int Width>
struct Rays {
  Vectors<Width * most_beams> origins;
  Vectors<Width * most_beams> directions;
};

/// Aims the beams of up to `most_beams` firings of one laser at a time.
template <int Width>
class Aim {
 public:
  Aim(const Lasers& lasers, const Mounting& mounting);

  /// Aim the beams of some firings of a laser.
  void set(const Firings& firings, View<const Index> which, Index laser);

  int rays() const { return beams_ * Width; }

  void in_world(Rays<Width>& rays) const { place(in_world_, rays); }
  void in_vehicle(Rays<Width>& rays) const { place(in_vehicle_, rays); }

 private:
  void move(const Firings& firings, View<const Index> which);
  void mount();
  void raise(const Firings& firings, View<const Index> which, Index laser);
  void point(Index laser);
  void start(const Firings& firings, View<const Index> which);
  void spread();
  void place(const Poses& poses, Rays<Width>& rays) const;

  using Lanes = double[most_beams];

  Lasers lasers_;
  Mounting mounting_;
  bool turns_;         // the vehicle, as time goes by
  Vec3 start_m_;       // where the sensor is at the path's time 0
  Vec3 velocity_m_s_;  // of the sensor, unless the vehicle turns
  int beams_ = 0;
  alignas(32) Lanes encoder_rad_;
  alignas(32) Lanes cos_elevation_;
  alignas(32) Lanes sin_elevation_;
  Poses vehicle_;  // on its path, if it turns
  Poses in_world_;
  Poses in_vehicle_;
  Vectors<most_beams> starts_;             // of the beams, in the sensor's frame
  Vectors<most_beams> directions_[Width];  // of their rays, in the sensor's frame
};

extern template class Aim<thin>;
extern template class Aim<wide>;

/// Write where the beams of N firings start in the world (N, 3), and their unit vectors (N, 3). Lasers are `thin`.
void aim_firings(const Lasers& lasers, const Mounting& mounting, const Firings& firings, Rows<double> origins_m,
                 Rows<double> directions);

}  // namespace lidarcfg::simulate
