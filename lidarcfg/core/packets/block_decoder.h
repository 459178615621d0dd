/// Decodes packets of blocks, as Velodyne and RoboSense send them.
#pragma once

#include <vector>

#include "packets/block_points.h"

namespace lidarcfg::packets {

/// Decodes the packets of one sensor. A maker says how its bytes are read and how its head turns.
template <class Maker>
class BlockDecoder {
 public:
  /// @param period_ns  from one packet's stamp to the next one's
  /// @param group_ns   from one group of blocks to the next
  /// @param unit_m     of distances
  BlockDecoder(const Slots& slots, const Lasers& lasers, std::int64_t period_ns, std::int64_t group_ns, double unit_m);

  /// How many returns the packets (P, size) that are wanted (P,) hold at most.
  Index count(Rows<const std::uint8_t> packets, View<const bool> wanted) const;

  /// Fill in one entry a return of the wanted ones of successive packets, in their order; returns how many. The others
  /// only say how the head turns.
  ///
  /// @param stamp_ns  (P,)
  /// @param gap_ns    (P,) from each stamp to the next one; 0 for the last
  /// @param kind      (P,) of single returns
  Index decode(Rows<const std::uint8_t> packets, View<const bool> wanted, View<const std::int64_t> stamp_ns,
               View<const std::int64_t> gap_ns, View<const std::uint8_t> kind, const Returns& out) const;

 private:
  Index groups_;
  Index slots_;  // of a group
  std::int64_t period_ns_;
  std::int64_t group_ns_;
  BlockPoints points_;
  std::vector<double> fraction_;         // (G, whole columns)
  std::vector<std::int64_t> offset_ns_;  // (G, whole columns)
};

}  // namespace lidarcfg::packets
