/// Ouster's packets: pixels to points, to fields and back, and the packet's CRC.
///
/// Packets are rows of bytes, little endian, of which a column's pixels are 32-bit words (ouster-sdk's parsing.cpp).
#pragma once

#include <cstdint>

#include "views.h"

namespace lidarcfg::packets::ouster {

using Byte = std::uint8_t;

/// Where columns and their pixels are in a packet; sizes in bytes.
struct Layout {
  Index head;         // before the first column
  Index columns;      // of a packet
  Index column;       // from one column to the next
  Index column_head;  // before a column's first pixel
  Index pixels;       // of a column
  Index pixel;        // from one pixel to the next: 4, 8, 12, 16 or 20

  Index packet_pixels() const { return columns * pixels; }
};

/// A field's bits in a pixel's words.
struct PixelField {
  Index word;
  int shift;
  std::uint32_t mask;  // after the shift

  std::uint32_t get(std::uint32_t from) const { return (from >> shift) & mask; }
};

/// A pixel's return: its range begins with the lowest bit of its word.
struct ReturnField {
  Index range_word;
  Index reflectivity_word;
  int reflectivity_shift;
};

/// What decoding needs to know of a profile.
struct Profile {
  Layout layout;
  Index status;               // the byte of a column's word that says whether it is valid
  std::uint32_t status_mask;  // of its bits that are set if so
  View<const ReturnField> returns;
  std::uint32_t range_mask;
  double unit_m;  // of a range
};

/// The L pixels of a column, in a frame whose z is the axis.
struct Beams {
  View<const double> ahead;                   // (L,) parts of the directions where the encoder's angle is 0
  View<const double> right;                   // (L,)
  View<const double> up;                      // (L,)
  View<const std::array<double, 2>> heading;  // (columns of a revolution,) cosine and sine of the encoder's angle
  double ahead_m;                             // from the axis to where all beams start
  double origin_m;                            // from the lidar's origin to there, which ranges include
  Vec3 shift_m;                               // that is added to all
  View<const Byte> ring;                      // (L,)
  View<const Byte> return_type;               // (R,)
};

/// Columns of points, with room for all pixels' returns.
struct Points {
  View<Vec3> xyz_m;
  View<std::int64_t> time_ns;
  View<Byte> ring;
  View<Byte> intensity;
  View<Byte> return_type;
};

/// Write the returns of packets, column by column, a pixel's first before its second; returns how many there are.
Index decode_points(Rows<const Byte> packets, const Profile& profile, const Beams& beams, const Points& out);

/// What an Ouster can say of returns.
struct Limits {
  double least_m;     // of a length
  double most_m;      // of a length
  double start_m;     // from the axis to where beams start, which ranges include
  double unit_m;      // of a range
  double most_units;  // of a range
};

/// Fields of N firings from what they measured.
///
/// Of two returns that are alike the second is none. Photons fall with the square of the length.
///
/// @param range_m          (N, R) the lengths
/// @param photons          (256,) of each reflectivity from a metre away
/// @param strongest_first  the stronger of two comes first; or else the first
/// @param fields           (3 R, N) range, reflectivity and signal of each
void quantize_returns(Rows<const double> range_m, Rows<const Byte> reflectivity, const Limits& limits,
                      View<const double> photons, bool strongest_first, Rows<std::uint32_t> fields);

/// Write fields into the pixels of packets, whose bits there are 0.
///
/// @param values  (F, N) pixel by pixel, packet by packet
/// @param fields  (F,) of a mask of 0: none
void pack_fields(Rows<const std::uint32_t> values, View<const PixelField> fields, const Layout& layout,
                 Rows<Byte> packets);

/// Read fields from the pixels of packets.
///
/// @param values  (F, N) pixel by pixel, packet by packet
void unpack_fields(Rows<const Byte> packets, View<const PixelField> fields, const Layout& layout,
                   Rows<std::uint32_t> values);

/// CRC-64/XZ (ECMA-182, reflected) of the first `size` bytes of each packet, a multiple of four.
void crc64(Rows<const Byte> packets, Index size, View<std::uint64_t> out);

}  // namespace lidarcfg::packets::ouster
