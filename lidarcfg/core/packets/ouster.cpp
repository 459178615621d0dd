#include "packets/ouster.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <utility>

#include "simd.h"

namespace lidarcfg::packets::ouster {
namespace {

using Units = simd::Vector<std::uint32_t>;
using simd::Doubles;

constexpr Index group = simd::lanes<std::uint32_t>;  // pixels that are decoded together
constexpr int half = simd::lanes<double>;            // of them, whose coordinates fill a register
constexpr Index word_size = 4;

template <class T>
T read(const Byte* from) {
  T out;
  std::memcpy(&out, from, sizeof out);
  return out;
}

/// Every second word of two registers.
template <std::size_t... I>
Units every_second(Units first, Units second, std::index_sequence<I...>) {
  return __builtin_shufflevector(first, second, (2 * static_cast<int>(I))...);
}

/// Every third word of three registers: those of the first two and of the last are blended, then put in order.
template <std::size_t... I>
Units every_third(Units first, Units second, Units third, std::index_sequence<I...>) {
  constexpr int size = sizeof...(I);
  constexpr auto is_from = [](int part, int lane) { return (part * size + lane) % 3 == 0; };
  const Units two = __builtin_shufflevector(first, second, (is_from(1, I) ? size + static_cast<int>(I) : I)...);
  const Units all = __builtin_shufflevector(two, third, (is_from(2, I) ? size + static_cast<int>(I) : I)...);
  return __builtin_shufflevector(all, all, (3 * static_cast<int>(I) % size)...);
}

/// One word of each pixel of a group.
template <int pixel_words>
Units gather(const Byte* from) {
  constexpr auto each = std::make_index_sequence<group>();
  const auto part = [from](int n) { return simd::load<Units>(from + n * sizeof(Units)); };
  static_assert(1 <= pixel_words && pixel_words <= 5);
  if constexpr (pixel_words == 1) {
    return part(0);
  } else if constexpr (pixel_words == 2) {
    return every_second(part(0), part(1), each);
  } else if constexpr (pixel_words == 3) {
    return every_third(part(0), part(1), part(2), each);
  } else if constexpr (pixel_words == 4) {
    return every_second(every_second(part(0), part(1), each), every_second(part(2), part(3), each), each);
  } else {
    Units out{};
    for (Index k = 0; k < group; ++k) {
      out[k] = read<std::uint32_t>(from + k * pixel_words * word_size);
    }
    return out;
  }
}

/// Decodes columns of pixels of so many words.
template <int pixel_words>
class ColumnDecoder {
 public:
  ColumnDecoder(Index packet_size, const Profile& profile, const Beams& beams, const Points& out)
      : profile_(profile), beams_(beams), out_(out) {
    Index last_word = 0;
    for (const ReturnField& one : profile.returns) {
      last_word = std::max({last_word, one.range_word, one.reflectivity_word});
    }
    const Layout& layout = profile.layout;
    const Index last_column = layout.head + (layout.columns - 1) * layout.column + layout.column_head;
    grouped_ = layout.pixels / group * group;
    while (grouped_ > 0 && last_column + grouped_ * layout.pixel + last_word * word_size > packet_size) {
      grouped_ -= group;  // whose words would be read beyond the packet
    }
  }

  Index count() const { return count_; }

  void decode(const Byte* column) {
    const Index measurement = read<std::uint16_t>(column + 8);
    const std::uint32_t status = read<std::uint32_t>(column + profile_.status);
    if ((status & profile_.status_mask) != profile_.status_mask || measurement >= std::ssize(beams_.heading)) {
      return;
    }
    const auto [cos, sin] = beams_.heading[measurement];
    const Vec3& shift_m = beams_.shift_m;
    const Pose pose{cos, sin, {beams_.ahead_m * cos + shift_m[0], beams_.ahead_m * sin + shift_m[1], shift_m[2]}};
    const Byte* pixels = column + profile_.layout.column_head;
    const Index begin = count_;
    for (Index pixel = 0; pixel < grouped_; pixel += group) {
      decode_group(pixels + pixel * pixel_words * word_size, pixel, pose);
    }
    for (Index pixel = grouped_; pixel < profile_.layout.pixels; ++pixel) {
      decode_pixel(pixels + pixel * pixel_words * word_size, pixel, pose);
    }
    std::fill(out_.time_ns.data() + begin, out_.time_ns.data() + count_, read<std::int64_t>(column));
  }

 private:
  /// Of a column: where the encoder points, and where beams start.
  struct Pose {
    double cos, sin;
    Vec3 start_m;
  };

  /// Decode pixels from a number on: most have one return each, or none has one.
  void decode_group(const Byte* from, Index pixel, const Pose& pose) {
    const ReturnField& first = profile_.returns[0];
    const Units units = gather<pixel_words>(from + first.range_word * word_size) & profile_.range_mask;
    if (profile_.returns.size() == 2) {
      const Index word = profile_.returns[1].range_word;
      if (simd::bits((gather<pixel_words>(from + word * word_size) & profile_.range_mask) != 0) != 0) {
        for (Index n = 0; n < group; ++n) {
          decode_pixel(from + n * pixel_words * word_size, pixel + n, pose);
        }
        return;
      }
    }
    const unsigned found = simd::bits(units != 0);
    if (found == 0) {
      return;
    }
    const Units intensity = gather<pixel_words>(from + first.reflectivity_word * word_size) >> first.reflectivity_shift;
    const Index begin = count_;
    write_bytes(intensity, pixel, found);
    for (int part = 0; part < 2; ++part) {
      write_points(units, part, pixel, pose, found);
    }
    if (profile_.returns.size() == 2) {
      std::fill_n(&out_.return_type[begin], group, beams_.return_type[0]);
    }
  }

  void write_points(Units units, int part, Index pixel, const Pose& pose, unsigned found) {
    const Index at = pixel + part * half;
    const Doubles length_m = simd::half_to_doubles(units, part) * profile_.unit_m - beams_.origin_m;
    const Doubles ahead = simd::load<Doubles>(&beams_.ahead[at]);
    const Doubles right = simd::load<Doubles>(&beams_.right[at]);
    Doubles x = (ahead * pose.cos + right * pose.sin) * length_m + pose.start_m[0];
    Doubles y = (ahead * pose.sin - right * pose.cos) * length_m + pose.start_m[1];
    Doubles z = simd::load<Doubles>(&beams_.up[at]) * length_m + pose.start_m[2];
    if (found != (1u << group) - 1) {
      const unsigned kept = found >> (part * half) & ((1u << half) - 1);
      x = simd::compress(x, kept);
      y = simd::compress(y, kept);
      z = simd::compress(z, kept);
      simd::interleave(x, y, z, out_.xyz_m[count_].data());
      count_ += std::popcount(kept);
    } else {
      simd::interleave(x, y, z, out_.xyz_m[count_].data());
      count_ += half;
    }
  }

  void write_bytes(Units intensity, Index pixel, unsigned found) {
    Index n = count_;
    for (Index k = 0; k < group; ++k) {
      out_.intensity[n] = static_cast<Byte>(intensity[k]);
      out_.ring[n] = beams_.ring[pixel + k];
      n += found >> k & 1;
    }
  }

  void decode_pixel(const Byte* from, Index pixel, const Pose& pose) {
    for (std::size_t r = 0; r < profile_.returns.size(); ++r) {
      const ReturnField& field = profile_.returns[r];
      const std::uint32_t units = read<std::uint32_t>(from + field.range_word * word_size) & profile_.range_mask;
      if (units == 0) {
        continue;
      }
      const double length_m = units * profile_.unit_m - beams_.origin_m;
      const double ahead = beams_.ahead[pixel];
      const double right = beams_.right[pixel];
      out_.xyz_m[count_] = {(ahead * pose.cos + right * pose.sin) * length_m + pose.start_m[0],
                            (ahead * pose.sin - right * pose.cos) * length_m + pose.start_m[1],
                            beams_.up[pixel] * length_m + pose.start_m[2]};
      out_.ring[count_] = beams_.ring[pixel];
      out_.intensity[count_] = static_cast<Byte>(read<std::uint32_t>(from + field.reflectivity_word * word_size) >>
                                                 field.reflectivity_shift);
      out_.return_type[count_] = beams_.return_type[r];
      ++count_;
    }
  }

  const Profile profile_;
  const Beams beams_;
  const Points out_;
  Index grouped_;  // pixels of a column that are decoded in groups
  Index count_ = 0;
};

template <int pixel_words>
Index decode_all(Rows<const Byte> packets, const Profile& profile, const Beams& beams, const Points& out) {
  ColumnDecoder<pixel_words> decoder(packets.columns(), profile, beams, out);
  for (Index p = 0; p < packets.rows(); ++p) {
    for (Index column = 0; column < profile.layout.columns; ++column) {
      decoder.decode(&packets(p, profile.layout.head + column * profile.layout.column));
    }
  }
  if (profile.returns.size() == 1) {
    std::fill_n(out.return_type.data(), decoder.count(), beams.return_type[0]);
  }
  return decoder.count();
}

using Remainders = std::array<std::array<std::uint64_t, 256>, 8>;

/// The CRC's remainders of each byte, and of each followed by up to seven bytes of 0.
constexpr Remainders remainders = [] {
  constexpr std::uint64_t polynomial = 0xC96C5795D7870F42;  // ECMA-182, reflected
  Remainders out{};
  for (std::uint64_t byte = 0; byte < 256; ++byte) {
    std::uint64_t value = byte;
    for (int bit = 0; bit < 8; ++bit) {
      value = value >> 1 ^ (value & 1 ? polynomial : 0);
    }
    out[0][byte] = value;
  }
  for (int zeros = 1; zeros < 8; ++zeros) {
    for (int byte = 0; byte < 256; ++byte) {
      const std::uint64_t before = out[zeros - 1][byte];
      out[zeros][byte] = out[0][before & 255] ^ before >> 8;
    }
  }
  return out;
}();

/// The remainder of eight bytes.
std::uint64_t remainder(std::uint64_t bytes) {
  std::uint64_t value = 0;
  for (int k = 0; k < 8; ++k) {
    value ^= remainders[7 - k][bytes >> (8 * k) & 255];
  }
  return value;
}

/// The remainder after four more bytes.
std::uint64_t remainder(std::uint64_t value, std::uint32_t bytes) {
  value ^= bytes;
  for (int k = 0; k < 4; ++k) {
    value = remainders[0][value & 255] ^ value >> 8;
  }
  return value;
}

/// Write a field's values into pixels of a size. All by value: what is written could be any of what is read.
void pack_column(View<const std::uint32_t> values, PixelField field, Index pixel, Byte* pixels) {
  if (field.mask == 0) {
    return;
  }
  Byte* to = pixels + field.word * word_size;
  for (const std::uint32_t value : values) {
    const std::uint32_t word = read<std::uint32_t>(to) | (value & field.mask) << field.shift;
    std::memcpy(to, &word, sizeof word);
    to += pixel;
  }
}

}  // namespace

Index decode_points(Rows<const Byte> packets, const Profile& profile, const Beams& beams, const Points& out) {
  switch (profile.layout.pixel / word_size) {
    case 1:
      return decode_all<1>(packets, profile, beams, out);
    case 2:
      return decode_all<2>(packets, profile, beams, out);
    case 3:
      return decode_all<3>(packets, profile, beams, out);
    case 4:
      return decode_all<4>(packets, profile, beams, out);
    default:
      return decode_all<5>(packets, profile, beams, out);
  }
}

void quantize_returns(Rows<const double> range_m, Rows<const Byte> reflectivity, const Limits& limits,
                      View<const double> photons, bool strongest_first, Rows<std::uint32_t> fields) {
  for (Index n = 0; n < range_m.rows(); ++n) {
    for (Index r = 0; r < range_m.columns(); ++r) {
      const double length_m = range_m(n, r);
      double units = 0.0;
      Byte bright = 0;
      double signal = 0.0;
      if (limits.least_m <= length_m && length_m <= limits.most_m) {
        units = std::rint((length_m + limits.start_m) / limits.unit_m);
        if (!(0 < units && units <= limits.most_units)) {
          units = 0.0;
        }
      }
      if (units > 0) {
        bright = reflectivity(n, r);
        signal = std::min(65535.0, std::rint(photons[bright] / (length_m * length_m)));
      }
      if (r == 1 && fields(0, n) == units && fields(1, n) == bright) {
        units = 0.0;
        bright = 0;
        signal = 0.0;
      }
      fields(3 * r, n) = static_cast<std::uint32_t>(units);
      fields(3 * r + 1, n) = bright;
      fields(3 * r + 2, n) = static_cast<std::uint32_t>(signal);
    }
    if (strongest_first && range_m.columns() == 2 && fields(0, n) > 0 && fields(3, n) > 0) {
      const double first_m = range_m(n, 0);
      const double second_m = range_m(n, 1);
      const bool weaker =
          photons[reflectivity(n, 0)] * (second_m * second_m) < photons[reflectivity(n, 1)] * (first_m * first_m);
      for (Index k = 0; weaker && k < 3; ++k) {
        std::swap(fields(k, n), fields(3 + k, n));
      }
    }
  }
}

void pack_fields(Rows<const std::uint32_t> values, View<const PixelField> fields, const Layout& layout,
                 Rows<Byte> packets) {
  for (Index p = 0; p < packets.rows(); ++p) {
    for (Index column = 0; column < layout.columns; ++column) {
      Byte* const pixels = &packets(p, layout.head + column * layout.column + layout.column_head);
      const Index first = (p * layout.columns + column) * layout.pixels;
      for (Index f = 0; f < std::ssize(fields); ++f) {
        pack_column(values[f].subspan(first, layout.pixels), fields[f], layout.pixel, pixels);
      }
    }
  }
}

void unpack_fields(Rows<const Byte> packets, View<const PixelField> fields, const Layout& layout,
                   Rows<std::uint32_t> values) {
  for (Index f = 0; f < std::ssize(fields); ++f) {
    const PixelField& field = fields[f];
    std::uint32_t* to = values[f].data();
    for (Index p = 0; p < packets.rows(); ++p) {
      for (Index column = 0; column < layout.columns; ++column) {
        const Byte* from = &packets(p, layout.head + column * layout.column + layout.column_head);
        from += field.word * word_size;
        for (Index pixel = 0; pixel < layout.pixels; ++pixel, from += layout.pixel) {
          *to++ = field.get(read<std::uint32_t>(from));
        }
      }
    }
  }
}

void crc64(Rows<const Byte> packets, Index size, View<std::uint64_t> out) {
  constexpr std::uint64_t ones = ~std::uint64_t{0};
  for (Index p = 0; p < packets.rows(); p += 2) {  // two together: the processor waits for each word's remainder
    const Index other = std::min(p + 1, packets.rows() - 1);
    const Byte* const first = packets[p].data();
    const Byte* const second = packets[other].data();
    std::uint64_t a = ones;
    std::uint64_t b = ones;
    Index at = 0;
    for (; at + 8 <= size; at += 8) {
      a = remainder(a ^ read<std::uint64_t>(first + at));
      b = remainder(b ^ read<std::uint64_t>(second + at));
    }
    if (at < size) {
      a = remainder(a, read<std::uint32_t>(first + at));
      b = remainder(b, read<std::uint32_t>(second + at));
    }
    out[p] = a ^ ones;
    out[other] = b ^ ones;
  }
}

}  // namespace lidarcfg::packets::ouster
