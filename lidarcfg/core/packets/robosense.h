/// RoboSense's MSOP packets: manuals of Helios 16 and Helios 32, V1.1, table 11; Airy's, V1.3, tables 9 to 11; Fairy's
/// (48TX), V1.0, tables 9 to 11.
#pragma once

#include "packets/azimuth.h"
#include "packets/blocks.h"

namespace lidarcfg::packets {

/// What is its own of `BlockDecoder` and `write_returns`.
struct Robosense {
  using Turning = RobosenseTurning;
  static constexpr Index first_block = 42;
  static constexpr Index slots_per_block = 32;
  static constexpr int distance_mask = 0xFFFF;
  static constexpr bool big_endian = true;
  static constexpr Index packet_bytes = 1248;

  /// Radians of a fraction of a step in hundredths.
  static double turned(double step, double fraction) { return step * radians_per_hundredth * fraction; }
};

/// An Airy's packets: eight blocks of 48 returns, whose distances have 14 bits, as rs_driver 1.5.19 reads them.
struct Airy : Robosense {
  static constexpr Index slots_per_block = 48;
  static constexpr int distance_mask = 0x3FFF;
};

/// A Fairy's packets: an Airy's, with distances of 15 bits.
struct Fairy : Airy {
  static constexpr int distance_mask = 0x7FFF;
};

}  // namespace lidarcfg::packets
