/// How a head turns between the azimuths that packets say: each maker's packets have one for a group of firings.
///
/// Azimuths are in hundredths of a degree, clockwise. Where the field of view has a gap, they jump.
#pragma once

#include <cmath>
#include <numbers>
#include <vector>

#include "views.h"

namespace lidarcfg::packets {

constexpr int revolution = 36000;  // in hundredths of a degree
constexpr double radians_per_hundredth = std::numbers::pi / 18000;

/// What is known of the groups of a packet's firings: (G,) the step to the next group's azimuth in hundredths, and how
/// much later than nominal they were fired.
///
/// `advance` goes through successive packets. Its arguments are the packet's azimuths (G,), the next packet's first
/// azimuth, and the time from this packet's stamp to the next one's; 0 if there is none.
class Turning {
 public:
  Turning(Index groups, std::int64_t period_ns, std::int64_t group_ns);

  View<const double> step() const { return step_; }
  View<const std::int64_t> late_ns() const { return late_ns_; }

 protected:
  bool follows(std::int64_t gap_ns) const;

  Index groups_;
  std::int64_t period_ns_;  // from one packet's stamp to the next one's
  std::int64_t group_ns_;
  std::vector<double> step_;
  std::vector<std::int64_t> late_ns_;
};

/// A Velodyne's head: it may turn either way. The last group of a packet looks into the next packet if that follows at
/// once, else it turns as the one before. The group before a jump turns as those before it; those after it are late by
/// what the next packet's stamp shows, in proportion to the angles that were passed.
class VelodyneTurning : public Turning {
 public:
  VelodyneTurning(Index groups, std::int64_t period_ns, std::int64_t group_ns);
  void advance(View<const std::uint16_t> azimuth, std::uint16_t next_azimuth, std::int64_t gap_ns);

 private:
  bool find_jumps(std::int64_t gap_ns);
  void delay(std::int64_t gap_ns);

  std::vector<double> ahead_;  // to the next azimuth, the shorter way round
  std::vector<bool> jump_;     // whether that leads over a gap
  double before_ = 0;          // the first step of the packet before
};

/// A RoboSense's head: it turns clockwise, and evenly while nothing is fired.
class RobosenseTurning : public Turning {
 public:
  using Turning::Turning;
  void advance(View<const std::uint16_t> azimuth, std::uint16_t next_azimuth, std::int64_t gap_ns);
};

/// Cosine and sine of an angle in radians; up to 0.05 three terms of each are exact to 2e-12.
struct Rotation {
  double cos;
  double sin;

  explicit Rotation(double angle_rad) {
    const double square = angle_rad * angle_rad;
    if (std::abs(angle_rad) < 0.05) {
      sin = angle_rad * (1 - square * (1 - square / 20) / 6);
      cos = 1 - square * (1 - square * (1 - square / 30) / 12) / 2;
    } else {
      sin = std::sin(angle_rad);
      cos = std::cos(angle_rad);
    }
  }
};

}  // namespace lidarcfg::packets
