#include "packets/hesai_at.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "maths.h"
#include "packets/hesai_block.h"
#include "times.h"

namespace lidarcfg::packets::hesai_at {

using hesai::lasers_max;
using hesai::no_return;

Decoder::Decoder(const Mirror& mirror, Index blocks)
    : layout_{mirror.azimuth_rad.columns(), blocks, 4, 3},
      azimuth_rad_(mirror.azimuth_rad.data(), mirror.azimuth_rad.data() + mirror.azimuth_rad.size()),
      elevation_rad_(mirror.elevation_rad.data(), mirror.elevation_rad.data() + mirror.elevation_rad.size()),
      offset_ns_(mirror.offset_ns.data(), mirror.offset_ns.data() + mirror.offset_ns.size()) {}

Index Decoder::count(Rows<const std::uint8_t> packets, View<const bool> wanted) const {
  Index found = 0;
  for (Index p = 0; p < packets.rows(); ++p) {
    for (Index block = 0; block < (wanted[p] ? layout_.blocks : 0); ++block) {
      const std::uint8_t* at = layout_.returns(packets[p], block);
      for (Index k = 0; k < layout_.lasers; ++k) {
        found += hesai::word(at + k * layout_.return_bytes) != 0;
      }
    }
  }
  return found;
}

Index Decoder::decode(Rows<const std::uint8_t> packets, View<const bool> wanted, const PacketFields& fields,
                      const Returns& out) const {
  const Index lasers = layout_.lasers;
  std::array<hesai::Block, 2> pairs;
  std::array<double, lasers_max> azimuth, x, y, z;
  Index found = 0;
  for (Index p = 0; p < packets.rows(); ++p) {
    if (!wanted[p]) {
      continue;
    }
    const double unit_m = fields.unit_mm[p] / 1000.0;
    for (Index b = 0; b < layout_.blocks; ++b) {
      hesai::Block& block = pairs[b % 2];
      if (fields.dual[p]) {
        if (b % 2 == 0) {
          pairs[0].read(layout_.returns(packets[p], b), layout_, 1);
          pairs[1].read(layout_.returns(packets[p], b + 1), layout_, 1);
        }
        pair(block, pairs[1 - b % 2], lasers, b % 2 == 1, fields.near[p], fields.far[p]);
      } else {
        block.read(layout_.returns(packets[p], b), layout_, 1);
        block.set(lasers, fields.near[p]);
      }
      const double row = fields.row(p, b);
      if (std::isnan(row)) {
        continue;
      }
      const auto low = static_cast<Index>(row);
      const Index high = std::min(low + 1, rows() - 1);
      const double part = row - static_cast<double>(low);
      const double* azimuth_low = &azimuth_rad_[low * lasers];
      const double* azimuth_high = &azimuth_rad_[high * lasers];
      const double* elevation_low = &elevation_rad_[low * lasers];
      const double* elevation_high = &elevation_rad_[high * lasers];
      const std::int64_t* offset_ns = &offset_ns_[low * lasers];
      const double turn = fields.turn(p, b);
      const double swept_rad = fields.swept_rad(p, b);
      for (Index k = 0; k < lasers; ++k) {  // with a return or without
        azimuth[k] = swept_rad + (azimuth_low[k] * (1 - part) + azimuth_high[k] * part) +
                     turn * static_cast<double>(offset_ns[k]);
        const auto [cos_a, sin_a] = cos_sin(azimuth[k]);
        const auto [cos_w, sin_w] = cos_sin(elevation_low[k] * (1 - part) + elevation_high[k] * part);
        const double range_m = block.distance[k] * unit_m;
        const double flat_m = range_m * cos_w;
        x[k] = flat_m * sin_a;
        y[k] = flat_m * cos_a;
        z[k] = range_m * sin_w;
      }
      for (Index k = 0; k < lasers; ++k) {
        if (block.kind[k] == no_return) {
          continue;
        }
        if (found == out.size()) {
          throw std::invalid_argument("out: fewer rows than returns");
        }
        out.xyz_m[found] = {x[k], y[k], z[k]};
        out.time_ns[found] = later(fields.start_ns(p, b), offset_ns[k]);
        out.laser[found] = static_cast<std::uint8_t>(k);
        out.ring[found] = static_cast<std::uint8_t>(k);
        out.intensity[found] = static_cast<std::uint8_t>(block.reflectivity[k]);
        out.return_type[found] = static_cast<std::uint8_t>(block.kind[k]);
        if (out.polar()) {
          constexpr double circle = 2 * std::numbers::pi;
          const double angle = azimuth[k] - std::numbers::pi / 2;
          out.range_m[found] = block.distance[k] * unit_m;
          out.azimuth_rad[found] = angle - circle * std::floor(angle / circle);
        }
        ++found;
      }
    }
  }
  return found;
}

}  // namespace lidarcfg::packets::hesai_at
