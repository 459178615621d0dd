/// Velodyne's data packets: VLP-16 User Manual 63-9243 Rev D, section 9.3; and the corrections of an HDL-64E.
#pragma once

#include "packets/azimuth.h"
#include "packets/blocks.h"

namespace lidarcfg::packets {

/// What is its own of `BlockDecoder` and `write_returns`.
struct Velodyne {
  using Turning = VelodyneTurning;
  static constexpr Index first_block = 0;
  static constexpr Index slots_per_block = 32;
  static constexpr int distance_mask = 0xFFFF;
  static constexpr bool big_endian = false;
  static constexpr Index packet_bytes = 1206;

  /// Radians of a fraction of a step in hundredths.
  static double turned(double step, double fraction) { return step * fraction * radians_per_hundredth; }
};

/// Where distance offsets are given: HDL-64E manual, two-point calibration. Nearer than far_m x and y have offsets of
/// their own, as velodyne_decoder 3.1 has it.
constexpr double far_m = 25.04;
constexpr double near_x_m = 2.4;
constexpr double near_y_m = 1.93;

/// How a laser's intensity is corrected by how far the distance is from the one where it is focused, as
/// velodyne_decoder 3.1 and ros-drivers have it.
struct Focus {
  double distance_m;
  double slope;
  double least;  // intensity
  double most;

  explicit Focus(View<const double> row) : distance_m(row[0]), slope(row[1]), least(row[2]), most(row[3]) {}

  /// What is added to the intensity of a return at a distance in the packet's units.
  double offset(int distance) const;

  /// An intensity corrected so.
  std::uint8_t correct(std::uint8_t intensity, int distance) const;
};

/// The angles and offsets of lasers whose near distances have offsets of their own.
struct NearLasers {
  View<const double> elevation;        // (L,) radians
  View<const double> azimuth_offset;   // (L,) radians
  View<const double> left;             // (L,) metres
  View<const double> distance_offset;  // (L,) metres, far off
  Rows<const double> near_offset;      // (L, 2) metres, to the side and ahead
};

/// Write those returns again whose distances are corrected for x and y apart: see `write_returns`.
///
/// @param azimuth  (P, N) where the head pointed, in radians; or (P, N / 2) with dual returns
/// @param laser    (S,) of each slot
void write_near_returns(Rows<const double> range_m, Rows<const std::uint8_t> reflectivity, Rows<const double> azimuth,
                        View<const std::int64_t> number, View<const std::int64_t> laser, const NearLasers& lasers,
                        Limits limits, Rows<std::uint8_t> packets);

/// Write intensities again: those of which `Focus` makes what they are, or comes nearest.
///
/// @param laser  (S,) of each slot
/// @param focal  (L, 4) as `Focus` has it
void uncorrect_intensities(View<const std::int64_t> laser, Rows<const double> focal, Rows<std::uint8_t> packets);

}  // namespace lidarcfg::packets
