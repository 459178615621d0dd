#include <algorithm>
#include <string>

#include "bind/arguments.h"
#include "bind/modules.h"
#include "packets/block_decoder.h"
#include "packets/crc.h"
#include "packets/firings.h"
#include "packets/hesai.h"
#include "packets/robosense.h"
#include "packets/velodyne.h"

namespace lidarcfg::bind {

using Pairs = Shaped<Rows<const double>, -1, 2>;
using Focal = Shaped<Rows<const double>, -1, 4>;

template <>
struct Fields<packets::Returns> {
  using T = packets::Returns;
  static constexpr auto members =
      fields(field("xyz_m", &T::xyz_m), field("range_m", &T::range_m), field("azimuth_rad", &T::azimuth_rad),
             field("time_ns", &T::time_ns), field("laser", &T::laser), field("ring", &T::ring),
             field("intensity", &T::intensity), field("return_type", &T::return_type));
};

template <>
struct Fields<packets::Slots> {
  using T = packets::Slots;
  static constexpr auto members =
      fields(field("laser", &T::laser), field("fraction", &T::fraction), field("offset_ns", &T::offset_ns),
             field("kind", &T::kind), field("other", &T::other));
};

template <>
struct Fields<packets::Lasers> {
  using T = packets::Lasers;
  static constexpr auto members = fields(
      field("elevation", &T::elevation), field("azimuth_offset", &T::azimuth_offset), field("forward", &T::forward),
      field("left", &T::left), field("up", &T::up), field("distance_offset", &T::distance_offset),
      field("ring", &T::ring), field<Pairs>("near_offset", &T::near_offset), field<Focal>("focal", &T::focal));
};

template <>
struct Fields<packets::NearLasers> {
  using T = packets::NearLasers;
  static constexpr auto members =
      fields(field("elevation", &T::elevation), field("azimuth_offset", &T::azimuth_offset), field("left", &T::left),
             field("distance_offset", &T::distance_offset), field<Pairs>("near_offset", &T::near_offset));
};

template <>
struct Fields<packets::hesai::Lasers> {
  using T = packets::hesai::Lasers;
  static constexpr auto members =
      fields(field("cos_elevation", &T::cos_elevation), field("sin_elevation", &T::sin_elevation),
             field("cos_offset", &T::cos_offset), field("sin_offset", &T::sin_offset), field("ring", &T::ring),
             field("offset_ns", &T::offset_ns), field("near_ns", &T::near_ns), field("lag_ns", &T::lag_ns));
};

template <>
struct Fields<packets::hesai::PacketFields> {
  using T = packets::hesai::PacketFields;
  static constexpr auto members =
      fields(field("unit_mm", &T::unit_mm), field("start_ns", &T::start_ns), field("loop", &T::loop),
             field("dual", &T::dual), field("near", &T::near), field("far", &T::far), field("turn", &T::turn));
};

namespace {

using Bytes = Rows<const std::uint8_t>;
template <class Maker>
using Recorded = Shaped<Bytes, -1, Maker::packet_bytes>;
template <class Maker>
using Encoded = Shaped<Rows<std::uint8_t>, -1, Maker::packet_bytes>;

constexpr Index lasers_max = 256;           // a byte says which one
constexpr std::int64_t time_max_ns = 1e12;  // of a packet, so that sums of times are exact
constexpr double unit_min_m = 1e-6;

/// Whether all of some values are indices of a list.
template <class T>
bool all_below(View<const T> values, Index count) {
  return std::ranges::all_of(values, [count](Index value) { return 0 <= value && value < count; });
}

/// A matrix row after row.
template <class T>
View<const T> flat(Rows<const T> rows) {
  return {rows.data(), static_cast<std::size_t>(rows.size())};
}

packets::Limits limits_of(const std::array<double, 4>& values) {
  require(values[2] >= unit_min_m, "limits: the unit must be positive, a micrometre at least");
  require(0 <= values[3] && values[3] <= 65535, "limits: units at most 65535");
  return {values[0], values[1], values[2], values[3]};
}

void check_returns(const packets::Returns& out) {
  const std::size_t count = out.xyz_m.size();
  using R = packets::Returns;
  require_columns(out, "out", "one for each of xyz_m",
                  std::tuple(&R::time_ns, &R::laser, &R::ring, &R::intensity, &R::return_type), count);
  require(out.range_m.empty() || out.range_m.size() == count, "out.range_m: none, or one for each of xyz_m");
  require(out.azimuth_rad.size() == out.range_m.size(), "out.azimuth_rad: one for each of range_m");
}

void check_wanted(View<const bool> wanted, Index packets) {
  require(std::ssize(wanted) == packets, "wanted: one for each packet");
}

void check_lasers(const packets::Lasers& lasers) {
  const std::size_t count = lasers.elevation.size();
  require(0 < count && count <= lasers_max, "lasers.elevation: of 1 to 256 lasers");
  using L = packets::Lasers;
  require_columns(lasers, "lasers", "one for each elevation",
                  std::tuple(&L::azimuth_offset, &L::forward, &L::left, &L::up, &L::distance_offset, &L::ring), count);
  const auto is_table = [count](Rows<const double> rows) {
    return rows.rows() == 0 || rows.rows() == static_cast<Index>(count);
  };
  require(is_table(lasers.near_offset), "lasers.near_offset: none, or one for each elevation");
  require(is_table(lasers.focal), "lasers.focal: none, or one for each elevation");
}

void check_slots(const packets::Slots& slots, Index lasers) {
  const Index width = std::ssize(slots.laser);
  const Index groups = slots.fraction.rows();
  require(width > 0 && width % packets::slots_per_column == 0, "slots.laser: of whole columns of 32");
  require(groups > 0 && groups * width <= packets::slots_per_packet,
          "slots.fraction: of groups that fill at most a packet");
  require(slots.fraction.columns() == width, "slots.fraction: one for each laser");
  require(has_shape(slots.offset_ns, groups, width), "slots.offset_ns: one for each fraction");
  require(std::ssize(slots.kind) == width && all_below(slots.kind, 2), "slots.kind: 0 or 1 for each laser");
  require(slots.other.empty() || (std::ssize(slots.other) == width && all_below(slots.other, width)),
          "slots.other: none, or a slot for each laser");
  require(all_below(slots.laser, lasers), "slots.laser: beyond the lasers");
}

void check_times(std::int64_t period_ns, std::int64_t group_ns) {
  require(0 < period_ns && period_ns <= time_max_ns, "period_ns: allowed: 1 to 10^12");
  require(0 < group_ns && group_ns <= time_max_ns, "group_ns: allowed: 1 to 10^12");
}

void check_encoded(Rows<const double> range_m, Bytes reflectivity, View<const std::int64_t> number, Bytes packets) {
  require(range_m.rows() == packets.rows(), "range_m: a row for each packet");
  require(has_shape(reflectivity, range_m.rows(), range_m.columns()), "reflectivity: one for each range");
  require(std::ssize(number) <= packets::slots_per_packet, "number: more than 384 slots");
  require(all_below(number, range_m.columns()), "number: beyond the ranges");
}

template <class Maker>
void bind_blocks(nb::module_& module, const char* decoder, const char* write) {
  using Decoder = packets::BlockDecoder<Maker>;
  nb::class_<Decoder> type(module, decoder, "Decodes data packets (P, size) of one sensor.");
  init(
      type,
      [](const packets::Slots& slots, const packets::Lasers& lasers, std::int64_t period_ns, std::int64_t group_ns,
         double unit_m) {
        check_lasers(lasers);
        check_slots(slots, std::ssize(lasers.elevation));
        require(std::ssize(slots.laser) % Maker::slots_per_block == 0, "slots.laser: of whole blocks");
        check_times(period_ns, group_ns);
        return Decoder(slots, lasers, period_ns, group_ns, unit_m);
      },
      "Copies the tables. From packet to packet it is period_ns, from group to group of blocks group_ns.", "slots",
      "lasers", "period_ns", "group_ns", "unit_m");
  def(
      type, "count",
      [](const Decoder& self, Recorded<Maker> packets, View<const bool> wanted) {
        check_wanted(wanted, packets.rows());
        return self.count(packets, wanted);
      },
      "How many returns the packets that are wanted (P,) hold at most.", "packets", "wanted");
  def(
      type, "decode",
      [](const Decoder& self, Recorded<Maker> packets, View<const bool> wanted, View<const std::int64_t> stamp_ns,
         View<const std::int64_t> gap_ns, View<const std::uint8_t> kind, const packets::Returns& out) {
        check_wanted(wanted, packets.rows());
        require(stamp_ns.size() == wanted.size(), "stamp_ns: one for each packet");
        require(gap_ns.size() == wanted.size(), "gap_ns: one for each packet");
        require(kind.size() == wanted.size(), "kind: one for each packet");
        check_returns(out);
        return self.decode(packets, wanted, stamp_ns, gap_ns, kind, out);
      },
      R"(Fill in an entry for each return of the packets that are wanted (P,); returns how many.

Stamps, the times to the next ones (0 for the last) and the types of single returns are (P,).)",
      "packets", "wanted", "stamp_ns", "gap_ns", "kind", "out");
  def(
      module, write,
      [](Rows<const double> range_m, Bytes reflectivity, View<const std::int64_t> number, View<const double> offset_m,
         std::array<double, 4> limits, Encoded<Maker> packets) {
        check_encoded(range_m, reflectivity, number, packets);
        require(offset_m.size() == number.size(), "offset_m: one for each number");
        return packets::write_returns<Maker>(range_m, reflectivity, number, offset_m, limits_of(limits), packets);
      },
      R"(Write into packets (P, size): slot s holds return number[s] of range_m and reflectivity (P, N).

Limits are the least and greatest range, the unit, and how many units there may be.)",
      "range_m", "reflectivity", "number", "offset_m", "limits", "packets");
}

void bind_velodyne(nb::module_& module) {
  bind_blocks<packets::Velodyne>(module, "VelodyneDecoder", "write_velodyne_returns");
  def(
      module, "write_velodyne_near_returns",
      [](Rows<const double> range_m, Bytes reflectivity, Rows<const double> azimuth, View<const std::int64_t> number,
         View<const std::int64_t> laser, const packets::NearLasers& lasers, std::array<double, 4> limits,
         Encoded<packets::Velodyne> packets) {
        check_encoded(range_m, reflectivity, number, packets);
        const std::size_t count = lasers.elevation.size();
        require(azimuth.rows() == range_m.rows() &&
                    (azimuth.columns() == range_m.columns() || 2 * azimuth.columns() == range_m.columns()),
                "azimuth: one for each range or pair of ranges");
        require(laser.size() == number.size() && all_below(laser, count), "laser: one of the lasers for each number");
        using L = packets::NearLasers;
        const char* const why = "one for each elevation";
        require_columns(lasers, "lasers", why, std::tuple(&L::azimuth_offset, &L::left, &L::distance_offset), count);
        require_columns(lasers, "lasers", why, std::tuple(&L::near_offset), count, 2);
        packets::write_near_returns(range_m, reflectivity, azimuth, number, laser, lasers, limits_of(limits), packets);
      },
      "Write those returns again whose distances are corrected for x and y apart: at azimuth (P, N or N / 2).",
      "range_m", "reflectivity", "azimuth", "number", "laser", "lasers", "limits", "packets");
  def(
      module, "uncorrect_velodyne_intensities",
      [](View<const std::int64_t> laser, Focal focal, Encoded<packets::Velodyne> packets) {
        require(std::ssize(laser) <= packets::slots_per_packet, "laser: more than 384 slots");
        require(all_below(laser, focal.rows()), "laser: beyond the rows of focal");
        packets::uncorrect_intensities(laser, focal, packets);
      },
      "Write intensities again: those that the corrections (L, 4) make what they are, or come nearest.", "laser",
      "focal", "packets");
}

void check_hesai_lasers(const packets::hesai::Lasers& lasers) {
  const std::size_t count = lasers.ring.size();
  require(0 < count && count <= lasers_max, "lasers.ring: of 1 to 256 lasers");
  using L = packets::hesai::Lasers;
  require_columns(lasers, "lasers", "one for each ring",
                  std::tuple(&L::cos_elevation, &L::sin_elevation, &L::cos_offset, &L::sin_offset), count);
  require(lasers.offset_ns.rows() > 0 && lasers.offset_ns.columns() == static_cast<Index>(count),
          "lasers.offset_ns: at least one loop, with one for each ring");
  require_columns(lasers, "lasers", "one for each of offset_ns", std::tuple(&L::near_ns, &L::lag_ns),
                  lasers.offset_ns.rows(), count);
}

void check_hesai_layout(const packets::hesai::Layout& layout) {
  require(0 < layout.lasers && layout.lasers <= lasers_max, "lasers: allowed: 1 to 256");
  require(0 < layout.blocks && layout.blocks <= 256, "blocks: allowed: 1 to 256");
  require(3 <= layout.return_bytes && layout.return_bytes <= 6, "return_bytes: allowed: 3 to 6");
}

void bind_hesai(nb::module_& module) {
  using packets::hesai::Decoder;
  nb::class_<Decoder> type(module, "HesaiDecoder", "Decodes packets (P, size) of one sensor.");
  init(
      type,
      [](const packets::hesai::Lasers& lasers, Index blocks, Index return_bytes, double near_m, int least) {
        check_hesai_lasers(lasers);
        check_hesai_layout({std::ssize(lasers.ring), blocks, return_bytes});
        require(blocks % 2 == 0, "blocks: an even number");
        return Decoder(lasers, blocks, return_bytes, {near_m, least});
      },
      "Copies the tables. Distances of less than `least` units are no returns, those below `near_m` have near_ns.",
      "lasers", "blocks", "return_bytes", "near_m", "least");
  def(
      type, "count",
      [](const Decoder& self, Bytes packets, View<const bool> wanted) {
        require(packets.columns() >= self.layout().end(), "packets: too short for the blocks");
        check_wanted(wanted, packets.rows());
        return self.count(packets, wanted);
      },
      "How many returns the packets that are wanted (P,) hold at most.", "packets", "wanted");
  def(
      type, "decode",
      [](const Decoder& self, Bytes packets, View<const bool> wanted, const packets::hesai::PacketFields& fields,
         const packets::Returns& out) {
        using F = packets::hesai::PacketFields;
        const Index count = packets.rows();
        require(packets.columns() >= self.layout().end(), "packets: too short for the blocks");
        check_wanted(wanted, count);
        require_columns(fields, "fields", "one for each packet",
                        std::tuple(&F::unit_mm, &F::dual, &F::near, &F::far, &F::turn), count);
        require_columns(fields, "fields", "one for each block of each packet", std::tuple(&F::start_ns, &F::loop),
                        count, self.layout().blocks);
        require(all_below(flat(fields.loop), self.loops()), "fields.loop: one of the loops");
        check_returns(out);
        return self.decode(packets, wanted, fields, out);
      },
      "Fill in an entry for each return of the packets that are wanted (P,); returns how many.", "packets", "wanted",
      "fields", "out");
  def(
      module, "write_hesai_returns",
      [](Tables<const double> range_m, Tables<const std::uint8_t> reflectivity, Bytes laser,
         View<const std::int64_t> column, Rows<const bool> inside, std::array<double, 4> limits, Index lasers,
         Index return_bytes, Rows<std::uint8_t> packets) {
        const Index count = packets.rows();
        const Index groups = inside.columns();
        const packets::hesai::Layout layout{lasers, std::ssize(column), return_bytes};
        check_hesai_layout(layout);
        require(packets.columns() >= layout.end(), "packets: too short for the blocks");
        require(inside.rows() == count && groups > 0 && layout.blocks % groups == 0,
                "inside: for each packet, one for as many blocks each");
        require(laser.rows() == count && laser.columns() % groups == 0, "laser: for each packet, as many a group");
        require(all_below(flat(laser), lasers), "laser: beyond the lasers");
        require(range_m.tables() == count && range_m.rows() == laser.columns(), "range_m: one or two for each laser");
        require(has_shape(reflectivity, count, range_m.rows(), range_m.columns()), "reflectivity: one for each range");
        require(all_below(column, range_m.columns()), "column: beyond the returns");
        packets::hesai::write_returns(range_m, reflectivity, laser, column, inside, limits_of(limits), layout, packets);
      },
      R"(Write into packets (P, size): block b holds column[b] of range_m and reflectivity (P, G F, R).

Those are of laser (P, G F), if the group of blocks is inside (P, G).)",
      "range_m", "reflectivity", "laser", "column", "inside", "limits", "lasers", "return_bytes", "packets");
}

}  // namespace

void bind_packets(nb::module_& module) {
  record<packets::Returns>(module, "Returns",
                           "Columns of returns, to be written; those that are not asked for are empty.");
  record<packets::Slots>(module, "BlockSlots", "The slots of a packet's groups of blocks.");
  record<packets::Lasers>(module, "BlockLasers", "The lasers of a sensor whose packets are blocks.");
  record<packets::NearLasers>(module, "NearLasers",
                              "The lasers of a sensor whose distances near by have offsets of their own.");
  record<packets::hesai::Lasers>(module, "HesaiLasers", "The lasers of a Hesai sensor, and when they fire.");
  record<packets::hesai::PacketFields>(module, "HesaiFields", "What Hesai packets say beside their blocks.");
  def(
      module, "crc32_mpeg2",
      [](Bytes packets, Index first, Index end) {
        require(0 <= first && first <= end && end <= packets.columns(), "end: beyond the packets, or before first");
        std::vector<std::uint32_t> out(packets.rows());
        for (Index p = 0; p < packets.rows(); ++p) {
          out[p] = packets::crc32_mpeg2(packets[p].subspan(first, end - first));
        }
        return out;
      },
      "The CRC (P,) of each packet's bytes from first until end.", "packets", "first", "end");
  def(
      module, "crc32c",
      [](Bytes packets, Index first, Index end) {
        require(0 <= first && first <= end && end <= packets.columns(), "end: beyond the packets, or before first");
        std::vector<std::uint32_t> out(packets.rows());
        for (Index p = 0; p < packets.rows(); ++p) {
          out[p] = packets::crc32c(packets[p].first(first), packets[p].subspan(end));
        }
        return out;
      },
      "The CRC-32C (P,) of each packet's bytes but those from first until end.", "packets", "first", "end");
  bind_velodyne(module);
  bind_blocks<packets::Robosense>(module, "RobosenseDecoder", "write_robosense_returns");
  bind_blocks<packets::Airy>(module, "AiryDecoder", "write_airy_returns");
  bind_hesai(module);
  bind_packets_ouster(module);
  def(
      module, "fire",
      [](View<const double> revolutions, View<const std::int64_t> stamp_ns, View<const std::int64_t> offset_ns,
         double revolutions_per_ns, Rows<std::int64_t> time_ns, Rows<double> encoder_rad) {
        require(stamp_ns.size() == revolutions.size(), "stamp_ns: one for each of revolutions");
        require(has_shape(time_ns, std::ssize(revolutions), std::ssize(offset_ns)),
                "time_ns: for each of revolutions, one for each of offset_ns");
        require(has_shape(encoder_rad, time_ns.rows(), time_ns.columns()), "encoder_rad: one for each of time_ns");
        packets::fire(revolutions, stamp_ns, offset_ns, revolutions_per_ns, time_ns, encoder_rad);
      },
      "Write times and azimuths (P, N) of firings that come at offsets (N,) after stamps (P,).", "revolutions",
      "stamp_ns", "offset_ns", "revolutions_per_ns", "time_ns", "encoder_rad");
}

}  // namespace lidarcfg::bind
