#include "packets/block_decoder.h"

#include <algorithm>
#include <cmath>

#include "maths.h"
#include "packets/robosense.h"
#include "packets/velodyne.h"
#include "simd.h"
#include "times.h"

namespace lidarcfg::packets {
namespace {

/// The rotations of the latest steps: a head that turns evenly has two or three.
template <class Maker>
class Rotations {
 public:
  Rotations(Index groups, Index columns) : groups_(groups), columns_(columns), kept_(steps * groups * columns) {}

  /// (columns,) for a group and its step, with its fractions (W,).
  View<const Turned> of(Index group, double step, const double* fraction) {
    const Index row = static_cast<Index>(step) & (steps - 1);
    Turned* const turned = &kept_[(row * groups_ + group) * columns_];
    if (turned->step != step) {
      for (Index column = 0; column < columns_; ++column) {
        turn(turned[column], step, fraction + column * slots_per_column);
      }
    }
    return {turned, static_cast<std::size_t>(columns_)};
  }

 private:
  static constexpr Index steps = 16;

  static void turn(Turned& turned, double step, const double* fraction) {
    turned.step = step;
    for (Index k = 0; k < slots_per_column; ++k) {
      turned.angle_rad[k] = Maker::turned(step, fraction[k]);
      const Rotation rotation(turned.angle_rad[k]);
      turned.cos[k] = rotation.cos;
      turned.sin[k] = rotation.sin;
    }
  }

  Index groups_;
  Index columns_;
  std::vector<Turned> kept_;  // (steps, groups, columns)
};

/// Four returns, which are twelve bytes; the four bytes after them are read, too.
template <class Maker>
void read_four(const std::uint8_t* at, int* distance, int* intensity) {
  typedef std::uint8_t Bytes __attribute__((vector_size(16)));
  constexpr int low = Maker::big_endian ? 1 : 0;
  constexpr int high = 1 - low;
  constexpr int zero = 16;  // the first byte of the second vector
  const Bytes bytes = simd::load<Bytes>(at);
  const Bytes none{};
  simd::store(distance, __builtin_shufflevector(bytes, none, low, high, zero, zero, 3 + low, 3 + high, zero, zero,
                                                6 + low, 6 + high, zero, zero, 9 + low, 9 + high, zero, zero));
  simd::store(intensity, __builtin_shufflevector(bytes, none, 2, zero, zero, zero, 5, zero, zero, zero, 8, zero, zero,
                                                 zero, 11, zero, zero, zero));
}

/// The returns of a group of blocks (W,).
template <class Maker>
void read(View<const std::uint8_t> packet, Index first_slot, View<int> distance, View<int> intensity) {
  static_assert(Maker::slots_per_block % 4 == 0 && slots_per_packet % Maker::slots_per_block == 0, "for read_four");
  static_assert(Maker::first_block + slots_per_packet / Maker::slots_per_block * block_bytes<Maker> + 4 <=
                    Maker::packet_bytes,
                "for read_four");
  for (Index k = 0; k < std::ssize(distance); k += 4) {
    read_four<Maker>(return_at<Maker>(packet, first_slot + k), &distance[k], &intensity[k]);
  }
  for (int& units : distance) {
    units &= Maker::distance_mask;
  }
}

/// The rows of a table, each with zeros up to whole columns.
template <class T>
std::vector<T> in_columns(Rows<const T> table, Index columns) {
  const Index width = columns * slots_per_column;
  std::vector<T> out(table.rows() * width);
  for (Index row = 0; row < table.rows(); ++row) {
    std::copy_n(table[row].begin(), table.columns(), out.begin() + row * width);
  }
  return out;
}

}  // namespace

template <class Maker>
BlockDecoder<Maker>::BlockDecoder(const Slots& slots, const Lasers& lasers, std::int64_t period_ns,
                                  std::int64_t group_ns, double unit_m)
    : groups_(slots.fraction.rows()),
      slots_(std::ssize(slots.laser)),
      period_ns_(period_ns),
      group_ns_(group_ns),
      points_(slots, lasers, unit_m),
      fraction_(in_columns(slots.fraction, points_.columns())),
      offset_ns_(in_columns(slots.offset_ns, points_.columns())) {}

template <class Maker>
Index BlockDecoder<Maker>::count(Rows<const std::uint8_t> packets, View<const bool> wanted) const {
  Index found = 0;
  for (Index p = 0; p < packets.rows(); ++p) {
    if (!wanted[p]) {
      continue;
    }
    for (Index slot = 0; slot < groups_ * slots_; slot += Maker::slots_per_block) {
      const std::uint8_t* at = return_at<Maker>(packets[p], slot);
      int here = 0;
      for (Index k = 0; k < Maker::slots_per_block; ++k) {
        here += (word<Maker>(at + k * return_bytes) & Maker::distance_mask) != 0;
      }
      found += here;
    }
  }
  return found;
}

template <class Maker>
Index BlockDecoder<Maker>::decode(Rows<const std::uint8_t> packets, View<const bool> wanted,
                                  View<const std::int64_t> stamp_ns, View<const std::int64_t> gap_ns,
                                  View<const std::uint8_t> kind, const Returns& out) const {
  const Index width = points_.columns() * slots_per_column;
  const Index blocks = slots_ / Maker::slots_per_block;  // in a group
  typename Maker::Turning turning(groups_, period_ns_, group_ns_);
  Rotations<Maker> rotations(groups_, points_.columns());
  std::vector<std::uint16_t> azimuth(groups_);
  std::vector<int> distance(width);
  std::vector<int> intensity(width);
  Index row = 0;
  for (Index p = 0; p < packets.rows(); ++p) {
    for (Index g = 0; g < groups_; ++g) {
      azimuth[g] = azimuth_of<Maker>(packets[p], g * blocks);
    }
    const bool more = p + 1 < packets.rows();
    turning.advance(azimuth, more ? azimuth_of<Maker>(packets[p + 1], 0) : 0, more ? gap_ns[p] : 0);
    if (!wanted[p]) {
      continue;
    }
    for (Index g = 0; g < groups_; ++g) {
      read<Maker>(packets[p], g * slots_, View<int>(distance).first(slots_), intensity);
      const double azimuth_rad = azimuth[g] * radians_per_hundredth;
      const auto [cos_azimuth, sin_azimuth] = cos_sin(azimuth_rad);
      const Group group{
          .distance = distance,
          .intensity = intensity,
          .turned = rotations.of(g, turning.step()[g], &fraction_[g * width]),
          .offset_ns = View<const std::int64_t>(offset_ns_).subspan(g * width, width),
          .azimuth_rad = azimuth_rad,
          .cos_azimuth = cos_azimuth,
          .sin_azimuth = sin_azimuth,
          .began_ns = later(stamp_ns[p], turning.late_ns()[g]),
          .kind = kind[p],
      };
      row += points_.write(group, out, row);
    }
  }
  return row;
}

template class BlockDecoder<Velodyne>;
template class BlockDecoder<Robosense>;
template class BlockDecoder<Airy>;
template class BlockDecoder<Fairy>;

}  // namespace lidarcfg::packets
