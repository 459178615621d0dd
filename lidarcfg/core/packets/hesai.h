/// Hesai's packets of protocols 6.1, 3.2 and 1.4: PandarXT, XT32M2X, QT128C2X and Pandar128E3X user manuals.
///
/// After a header of twelve bytes come B blocks: an azimuth, and for each of L lasers two bytes of distance, one of
/// reflectivity and up to three more; all is little endian. With dual returns a block and the next one are a pair.
#pragma once

#include <vector>

#include "packets/blocks.h"
#include "packets/returns.h"

namespace lidarcfg::packets::hesai {

/// Where a packet's bytes stand.
struct Layout {
  Index lasers;
  Index blocks;
  Index return_bytes;       // 3 to 6
  Index azimuth_bytes = 2;  // 3 in the AT series

  Index block_bytes() const { return azimuth_bytes + return_bytes * lasers; }
  /// What a packet has at least: returns are read four bytes at a time.
  Index end() const { return header_bytes + blocks * block_bytes() + (return_bytes < 4); }

  template <class Byte>
  Byte* azimuth(View<Byte> packet, Index block) const {
    return packet.data() + header_bytes + block * block_bytes();
  }
  template <class Byte>
  Byte* returns(View<Byte> packet, Index block) const {
    return azimuth(packet, block) + azimuth_bytes;
  }

  static constexpr Index header_bytes = 12;
};

/// What is known of the lasers and of when they fire.
struct Lasers {
  View<const double> cos_elevation;    // (L,)
  View<const double> sin_elevation;    // (L,)
  View<const double> cos_offset;       // (L,) of the azimuth offset
  View<const double> sin_offset;       // (L,)
  View<const std::uint8_t> ring;       // (L,)
  Rows<const std::int64_t> offset_ns;  // (loops, L) when each laser fires, after its block's start
  Rows<const std::int64_t> near_ns;    // (loops, L) the same for returns from nearer than `near_m`
  Rows<const std::int64_t> lag_ns;     // (loops, L) how long the head turns from a block's azimuth to the laser's
};

/// What distances mean.
struct Distances {
  double near_m;  // returns from nearer are of a firing of their own
  int least;      // units; less is a mark of the sensor and no return
};

/// What P packets say beside their blocks.
struct PacketFields {
  View<const std::uint8_t> unit_mm;   // (P,) of distances
  Rows<const std::int64_t> start_ns;  // (P, B) when each block starts
  Rows<const std::uint8_t> loop;      // (P, B) which loop's lasers fire
  View<const bool> dual;              // (P,)
  View<const std::uint8_t> near;      // (P,) the kind of single returns, or of a pair's nearer one
  View<const std::uint8_t> far;       // (P,) the kind of a pair's farther return
  View<const double> turn;            // (P,) the head's radians a nanosecond; 0: all lasers of a block point alike
};

/// Stands for a pair's kinds in `near` and `far`, where the block tells which is the strongest.
constexpr std::uint8_t by_block = 254;

/// Decodes the packets of one sensor; owns its tables.
class Decoder {
 public:
  Decoder(const Lasers& lasers, Index blocks, Index return_bytes, Distances distances);

  const Layout& layout() const { return layout_; }
  Index loops() const { return loops_; }

  /// How many returns the packets (P, size) that are wanted (P,) hold at most.
  Index count(Rows<const std::uint8_t> packets, View<const bool> wanted) const;

  /// Fill in the returns of the packets that are wanted, in their order; returns how many. Throws
  /// std::invalid_argument if there are not enough rows.
  ///
  /// A laser points where its block's azimuth says, its own offset and the turn in its lag further.
  Index decode(Rows<const std::uint8_t> packets, View<const bool> wanted, const PacketFields& fields,
               const Returns& out) const;

 private:
  Layout layout_;
  Index loops_;
  Distances distances_;
  std::vector<double> cos_w_, sin_w_;  // (L,) of the elevation
  std::vector<double> cos_o_, sin_o_;  // (L,) of the azimuth offset
  std::vector<std::uint8_t> ring_;
  std::vector<std::int64_t> offset_ns_, near_ns_, lag_ns_;  // (loops, L)
};

/// Write the returns of packets into their blocks: block b holds column `column[b]` of those of group b / (B / G).
///
/// @param range_m       (P, G F, R)
/// @param reflectivity  (P, G F, R)
/// @param laser         (P, G F) of each of a group's F firings
/// @param column        (B,) 0 to R - 1
/// @param inside        (P, G) whether the group is in the field of view; what is not is not written
/// @param packets       (P, size)
void write_returns(Tables<const double> range_m, Tables<const std::uint8_t> reflectivity,
                   Rows<const std::uint8_t> laser, View<const std::int64_t> column, Rows<const bool> inside,
                   Limits limits, const Layout& layout, Rows<std::uint8_t> packets);

}  // namespace lidarcfg::packets::hesai
