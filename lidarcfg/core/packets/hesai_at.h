/// The packets of Hesai's AT series, protocols 4.3 and 4.7: HesaiLidar_SDK_2.0, udp_protocol_v4_3.h,
/// udp_protocol_v4_7.h.
///
/// Like other packets of Hesai's, but that a block says a mirror's angle, by which each laser points where a table
/// says.
#pragma once

#include <vector>

#include "packets/hesai.h"
#include "packets/returns.h"

namespace lidarcfg::packets::hesai_at {

/// Where lasers point, by rows for the mirror's angle, and when they fire.
struct Mirror {
  Rows<const double> azimuth_rad;      // (K, L) further than the mirror has swept, clockwise
  Rows<const double> elevation_rad;    // (K, L)
  Rows<const std::int64_t> offset_ns;  // (K, L) after a block's start
};

/// What P packets say beside their returns.
struct PacketFields {
  View<const std::uint8_t> unit_mm;   // (P,) of distances
  Rows<const std::int64_t> start_ns;  // (P, B) when each block starts
  Rows<const double> swept_rad;       // (P, B) clockwise from the y axis
  Rows<const double> row;             // (P, B) in the mirror's tables, between two rows a fraction; NaN: points nowhere
  View<const bool> dual;              // (P,)
  View<const std::uint8_t> near;      // (P,) the kind of single returns, or of a pair's nearer one
  View<const std::uint8_t> far;       // (P,) the kind of a pair's farther return
  Rows<const double> turn;            // (P, B) what lasers turn in a nanosecond, in radians
};

/// Decodes the packets of one sensor; owns its tables.
class Decoder {
 public:
  Decoder(const Mirror& mirror, Index blocks);

  const hesai::Layout& layout() const { return layout_; }
  /// How many rows the tables have.
  Index rows() const { return std::ssize(azimuth_rad_) / layout_.lasers; }

  /// How many returns the packets (P, size) that are wanted (P,) hold at most.
  Index count(Rows<const std::uint8_t> packets, View<const bool> wanted) const;

  /// Fill in the returns of the packets that are wanted, in their order; returns how many. Throws
  /// std::invalid_argument if there are not enough rows.
  Index decode(Rows<const std::uint8_t> packets, View<const bool> wanted, const PacketFields& fields,
               const Returns& out) const;

 private:
  hesai::Layout layout_;
  std::vector<double> azimuth_rad_, elevation_rad_;  // (K, L)
  std::vector<std::int64_t> offset_ns_;
};

}  // namespace lidarcfg::packets::hesai_at
