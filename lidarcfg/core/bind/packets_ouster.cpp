#include "bind/arguments.h"
#include "bind/modules.h"
#include "packets/ouster.h"

namespace lidarcfg::bind {

using namespace packets::ouster;

/// As the profile of a layout says it, in rows of integers.
struct Decoding {
  Index status;
  std::uint32_t status_mask;
  View<const std::array<std::int64_t, 3>> returns;
  std::uint32_t range_mask;
  double unit_m;
};

template <>
struct Fields<Layout> {
  static constexpr auto members = fields(field("head", &Layout::head), field("columns_per_packet", &Layout::columns),
                                         field("column", &Layout::column), field("column_head", &Layout::column_head),
                                         field("pixels", &Layout::pixels), field("pixel", &Layout::pixel));
};

template <>
struct Fields<Decoding> {
  static constexpr auto members =
      fields(field("status", &Decoding::status), field("status_mask", &Decoding::status_mask),
             field("returns", &Decoding::returns), field("range_mask", &Decoding::range_mask),
             field("unit_m", &Decoding::unit_m));
};

template <>
struct Fields<Beams> {
  static constexpr auto members =
      fields(field("ahead", &Beams::ahead), field("right", &Beams::right), field("up", &Beams::up),
             field("heading", &Beams::heading), field("ahead_m", &Beams::ahead_m), field("origin_m", &Beams::origin_m),
             field("shift_m", &Beams::shift_m), field("ring", &Beams::ring), field("return_type", &Beams::return_type));
};

template <>
struct Fields<Limits> {
  static constexpr auto members =
      fields(field("least_m", &Limits::least_m), field("most_m", &Limits::most_m), field("start_m", &Limits::start_m),
             field("unit_m", &Limits::unit_m), field("most_units", &Limits::most_units));
};

namespace {

constexpr Index size_max = Index{1} << 24;  // of anything in a packet, so that no product overflows

bool is_within(Index value, Index least, Index most) { return least <= value && value <= most; }

void check(const Layout& layout, Rows<const Byte> packets) {
  for (const Index one : {layout.head, layout.columns, layout.column, layout.column_head, layout.pixels}) {
    require(is_within(one, 0, size_max), "layout: negative, or too large");
  }
  require(layout.columns > 0 && layout.pixels > 0, "layout: without pixels");
  require(layout.pixel % 4 == 0 && is_within(layout.pixel, 4, 20), "layout: pixels of another size than 4, 8, 12, 16, 20");
  require(layout.column_head >= 12 && layout.column_head + layout.pixels * layout.pixel <= layout.column,
          "layout: columns without room for their pixels");
  require(layout.head + layout.columns * layout.column <= packets.columns(), "layout: larger than a packet");
}

std::vector<PixelField> fields_of(View<const std::array<std::int64_t, 3>> bits, const Layout& layout) {
  std::vector<PixelField> out;
  for (const auto& [word, shift, mask] : bits) {
    require(is_within(word, 0, layout.pixel / 4 - 1) && is_within(shift, 0, 31) && is_within(mask, 0, 0xFFFFFFFF),
            "bits: not within a pixel");
    out.push_back({word, static_cast<int>(shift), static_cast<std::uint32_t>(mask)});
  }
  return out;
}

std::vector<ReturnField> returns_of(const Decoding& profile, const Layout& layout) {
  require(is_within(std::ssize(profile.returns), 1, 2), "profile.returns: one or two");
  std::vector<ReturnField> out;
  for (const auto& [range, reflectivity, shift] : profile.returns) {
    require(is_within(range, 0, layout.pixel / 4 - 1) && is_within(reflectivity, 0, layout.pixel / 4 - 1) &&
                is_within(shift, 0, 31),
            "profile.returns: not within a pixel");
    out.push_back({range, reflectivity, static_cast<int>(shift)});
  }
  return out;
}

void check(const Beams& beams, const Layout& layout, std::size_t returns) {
  require_columns(beams, "beams", "one for each pixel of a column",
                  std::tuple(&Beams::ahead, &Beams::right, &Beams::up, &Beams::ring), layout.pixels);
  require(beams.return_type.size() == returns, "beams.return_type: one for each return");
}

}  // namespace

void bind_packets_ouster(nb::module_& module) {
  record<Layout>(module, "OusterLayout", "Where columns and pixels are in a packet, in bytes.");
  record<Decoding>(module, "OusterProfile", "Where a column's status and a pixel's returns are.");
  record<Beams>(module, "OusterBeams", "The L pixels of a column, in a frame whose z is the axis.");
  record<Limits>(module, "OusterLimits", "The ranges that packets can hold.");
  def(
      module, "decode_ouster_points",
      [](Rows<const Byte> packets, const Layout& layout, const Decoding& profile, const Beams& beams, View<Vec3> xyz_m,
         View<std::int64_t> time_ns, View<Byte> ring, View<Byte> intensity, View<Byte> return_type) {
        check(layout, packets);
        const std::vector<ReturnField> returns = returns_of(profile, layout);
        require(is_within(profile.status, 0, layout.column - 4), "profile.status: not within a column");
        require(profile.range_mask < std::uint32_t{1} << 31, "profile.range_mask: above 31 bits");
        check(beams, layout, returns.size());
        const Index most = packets.rows() * layout.packet_pixels() * std::ssize(returns);
        require(std::ssize(xyz_m) >= most, "xyz_m: without room for all returns");
        require(std::ssize(time_ns) >= most, "time_ns: without room for all returns");
        require(std::ssize(ring) >= most, "ring: without room for all returns");
        require(std::ssize(intensity) >= most, "intensity: without room for all returns");
        require(std::ssize(return_type) >= most, "return_type: without room for all returns");
        return decode_points(packets,
                             {layout, profile.status, profile.status_mask, returns, profile.range_mask, profile.unit_m},
                             beams, {xyz_m, time_ns, ring, intensity, return_type});
      },
      "Write the returns in packets (P, size), column by column, to columns with room for all; returns how many.",
      "packets", "layout", "profile", "beams", "xyz_m", "time_ns", "ring", "intensity", "return_type");
  def(
      module, "quantize_ouster_returns",
      [](Rows<const double> range_m, Rows<const Byte> reflectivity, const Limits& limits,
         Shaped<View<const double>, 256> photons, bool strongest_first, Rows<std::uint32_t> out) {
        const Index returns = range_m.columns();
        require(is_within(returns, 1, 2), "range_m: one or two returns of each firing");
        require(has_shape(reflectivity, range_m.rows(), returns), "reflectivity: one for each range");
        require(has_shape(out, 3 * returns, range_m.rows()), "out: three rows for each return");
        require(limits.most_units < 4294967296.0, "limits.most_units: above 32 bits");
        quantize_returns(range_m, reflectivity, limits, photons, strongest_first, out);
      },
      "Write range, reflectivity and signal of (N, R) as packets have them to out (3 R, N); photons (256,) at 1 m.",
      "range_m", "reflectivity", "limits", "photons", "strongest_first", "out");
  def(
      module, "pack_ouster_fields",
      [](Rows<const std::uint32_t> values, View<const std::array<std::int64_t, 3>> bits, const Layout& layout,
         Rows<Byte> packets) {
        check(layout, packets);
        require(has_shape(values, std::ssize(bits), packets.rows() * layout.packet_pixels()),
                "values: for each field, one for each pixel");
        pack_fields(values, fields_of(bits, layout), layout, packets);
      },
      "Write fields (F, N) at bits (F, 3: word, shift, mask) into the pixels of packets (P, size).", "values", "bits",
      "layout", "packets");
  def(
      module, "unpack_ouster_fields",
      [](Rows<const Byte> packets, View<const std::array<std::int64_t, 3>> bits, const Layout& layout,
         Rows<std::uint32_t> out) {
        check(layout, packets);
        require(has_shape(out, std::ssize(bits), packets.rows() * layout.packet_pixels()),
                "out: for each field, one for each pixel");
        unpack_fields(packets, fields_of(bits, layout), layout, out);
      },
      "Read fields at bits (F, 3: word, shift, mask) from the pixels of packets (P, size) to out (F, N).", "packets",
      "bits", "layout", "out");
  def(
      module, "crc64",
      [](Rows<const Byte> packets, Index size) {
        require(size % 4 == 0 && is_within(size, 0, packets.columns()), "size: no multiple of 4 within a packet");
        std::vector<std::uint64_t> out(packets.rows());
        crc64(packets, size, out);
        return out;
      },
      "(P,) CRC-64/XZ of the first bytes, a multiple of four, of packets (P, n).", "packets", "size");
}

}  // namespace lidarcfg::bind
