/// Hesai's packets of protocols 6.1 and 3.2: PandarXT, XT32M2X and QT128C2X user manuals, section 3.1.
///
/// After a header of twelve bytes come B blocks: an azimuth, and for each of L lasers two bytes of distance, one of
/// reflectivity and one of confidence; all is little endian. With dual returns a block and the next one are a pair.
#pragma once

#include <vector>

#include "packets/blocks.h"
#include "packets/returns.h"

namespace lidarcfg::packets::hesai {

/// Where a packet's bytes stand.
struct Layout {
  Index lasers;
  Index blocks;

  Index block_bytes() const { return 2 + 4 * lasers; }
  Index end() const { return header_bytes + blocks * block_bytes(); }

  template <class Byte>
  Byte* azimuth(View<Byte> packet, Index block) const {
    return packet.data() + header_bytes + block * block_bytes();
  }
  template <class Byte>
  Byte* returns(View<Byte> packet, Index block) const {
    return azimuth(packet, block) + 2;
  }

  static constexpr Index header_bytes = 12;
  static constexpr Index return_bytes = 4;
};

/// What is known of the lasers and of when they fire.
struct Lasers {
  View<const double> cos_elevation;    // (L,)
  View<const double> sin_elevation;    // (L,)
  View<const double> cos_offset;       // (L,) of the azimuth offset
  View<const double> sin_offset;       // (L,)
  View<const std::uint8_t> ring;       // (L,)
  Rows<const std::int64_t> offset_ns;  // (loops, L) of each laser in a block; blocks go through the loops
  Rows<const std::int64_t> lag_ns;     // (loops, L) how long the head turns from a block's azimuth to the laser's
  View<const std::int64_t> group_ns;   // (B,) when each block starts with single returns, after the packet's stamp
  View<const std::int64_t> pair_ns;    // (B / 2,) when each pair of blocks starts with dual returns
};

/// What P packets say beside their blocks.
struct PacketFields {
  View<const std::uint8_t> unit_mm;   // (P,) of distances
  View<const std::int64_t> stamp_ns;  // (P,)
  View<const bool> dual;              // (P,)
  View<const std::uint8_t> loop;      // (P,) with dual returns: which lasers fire
  View<const std::uint8_t> near;      // (P,) the kind of single returns, or of a pair's nearer one
  View<const std::uint8_t> far;       // (P,) the kind of a pair's farther return
  View<const double> turn;            // (P,) the head's radians a nanosecond; 0: all lasers of a block point alike
};

/// Stands for a pair's kinds in `near` and `far`, where the block tells which is the strongest.
constexpr std::uint8_t by_block = 254;

/// Decodes the packets of one sensor; owns its tables.
class Decoder {
 public:
  explicit Decoder(const Lasers& lasers);

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
  std::vector<double> cos_w_, sin_w_;  // (L,) of the elevation
  std::vector<double> cos_o_, sin_o_;  // (L,) of the azimuth offset
  std::vector<std::uint8_t> ring_;
  std::vector<std::int64_t> offset_ns_;  // (loops, L)
  std::vector<std::int64_t> lag_ns_;     // (loops, L)
  std::vector<std::int64_t> group_ns_, pair_ns_;
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
