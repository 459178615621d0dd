/// Packets of blocks, as Velodyne and RoboSense send them: a block is a flag, an azimuth, and for each return two bytes
/// of distance and one of intensity. Twelve blocks of 32 returns are the rule.
///
/// A maker is a type that says what is its own: where the blocks begin and what they hold, the order of bytes, how its
/// head turns. Returns are decoded in columns of 32, whatever the size of a block.
#pragma once

#include <cmath>

#include "views.h"

namespace lidarcfg::packets {

constexpr Index slots_per_packet = 384;
constexpr Index slots_per_column = 32;
constexpr Index block_head_bytes = 4;
constexpr Index return_bytes = 3;

template <class Maker>
constexpr Index block_bytes = block_head_bytes + Maker::slots_per_block * return_bytes;

/// The bytes of a packet's returns, which are numbered block by block.
template <class Maker, class Byte>
Byte* return_at(View<Byte> packet, Index slot) {
  return packet.data() + Maker::first_block + slot / Maker::slots_per_block * block_bytes<Maker> +
         block_head_bytes + slot % Maker::slots_per_block * return_bytes;
}

/// The number in two bytes.
template <class Maker>
std::uint16_t word(const std::uint8_t* bytes) {
  return Maker::big_endian ? bytes[0] << 8 | bytes[1] : bytes[1] << 8 | bytes[0];
}

template <class Maker>
void set_word(std::uint8_t* bytes, std::uint16_t value) {
  bytes[Maker::big_endian] = value & 255;
  bytes[!Maker::big_endian] = value >> 8;
}

template <class Maker>
std::uint16_t azimuth_of(View<const std::uint8_t> packet, Index block) {
  return word<Maker>(packet.data() + Maker::first_block + block * block_bytes<Maker> + 2);
}

/// What is written into packets, and how: ranges in whole units.
struct Limits {
  double least_m;  // of what is reported
  double most_m;
  double unit_m;
  double units_max;

  /// A range in whole units; 0, which is no return, unless it is within the limits.
  double units(double range_m, double offset_m) const {
    const double units = std::nearbyint((range_m - offset_m) / unit_m);
    const bool sent = (least_m <= range_m) & (range_m <= most_m) & (0 <= units) & (units <= units_max);
    return sent ? units : 0;
  }
};

/// Write the returns of packets into their blocks.
///
/// @param range_m       (P, N)
/// @param reflectivity  (P, N)
/// @param number        (S,) which of the N returns each slot holds; slots block by block
/// @param offset_m      (S,) what the slot's laser adds to the distance that the packet says
/// @param packets       (P, size)
template <class Maker>
void write_returns(Rows<const double> range_m, Rows<const std::uint8_t> reflectivity, View<const std::int64_t> number,
                   View<const double> offset_m, Limits limits, Rows<std::uint8_t> packets);

}  // namespace lidarcfg::packets
