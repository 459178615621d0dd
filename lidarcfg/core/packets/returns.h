/// The returns in packets, as columns.
#pragma once

#include "views.h"

namespace lidarcfg::packets {

/// Two of the kinds of returns: `Returns.return_type` has all.
constexpr std::uint8_t strongest = 0;
constexpr std::uint8_t second_strongest = 2;

/// Columns of N returns, to be filled in.
struct Returns {
  View<Vec3> xyz_m;          // in the sensor frame
  View<double> range_m;      // along the beam, or empty
  View<double> azimuth_rad;  // of the beam, clockwise, or empty
  View<std::int64_t> time_ns;
  View<std::uint8_t> laser;
  View<std::uint8_t> ring;
  View<std::uint8_t> intensity;
  View<std::uint8_t> return_type;

  Index size() const { return std::ssize(xyz_m); }
  bool polar() const { return !range_m.empty(); }
};

}  // namespace lidarcfg::packets
