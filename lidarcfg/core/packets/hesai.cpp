#include "packets/hesai.h"

#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <stdexcept>

#include "maths.h"
#include "packets/azimuth.h"
#include "packets/hesai_block.h"
#include "times.h"

namespace lidarcfg::packets::hesai {
namespace {

template <class T>
std::vector<T> owned(View<const T> values) {
  return {values.begin(), values.end()};
}

}  // namespace

Decoder::Decoder(const Lasers& lasers, Index blocks, Index return_bytes, Distances distances)
    : layout_{std::ssize(lasers.ring), blocks, return_bytes},
      loops_(lasers.offset_ns.rows()),
      distances_(distances),
      cos_w_(owned(lasers.cos_elevation)),
      sin_w_(owned(lasers.sin_elevation)),
      cos_o_(owned(lasers.cos_offset)),
      sin_o_(owned(lasers.sin_offset)),
      ring_(owned(lasers.ring)),
      offset_ns_(lasers.offset_ns.data(), lasers.offset_ns.data() + lasers.offset_ns.size()),
      near_ns_(lasers.near_ns.data(), lasers.near_ns.data() + lasers.near_ns.size()),
      lag_ns_(lasers.lag_ns.data(), lasers.lag_ns.data() + lasers.lag_ns.size()) {}

Index Decoder::count(Rows<const std::uint8_t> packets, View<const bool> wanted) const {
  Index found = 0;
  for (Index p = 0; p < packets.rows(); ++p) {
    for (Index block = 0; block < (wanted[p] ? layout_.blocks : 0); ++block) {
      const std::uint8_t* at = layout_.returns(packets[p], block);
      for (Index k = 0; k < layout_.lasers; ++k) {
        found += word(at + k * layout_.return_bytes) != 0;
      }
    }
  }
  return found;
}

Index Decoder::decode(Rows<const std::uint8_t> packets, View<const bool> wanted, const PacketFields& fields,
                      const Returns& out) const {
  const Index lasers = layout_.lasers;
  std::array<Block, 2> pairs;
  std::array<double, lasers_max> x, y, z;
  std::vector<double> cos_o(2 * lag_ns_.size()),
      sin_o(2 * lag_ns_.size());                           // (2 loops, L) of offset and turn; near last
  double turn = std::numeric_limits<double>::quiet_NaN();  // of which these are
  Index row = 0;
  for (Index p = 0; p < packets.rows(); ++p) {
    if (!wanted[p]) {
      continue;
    }
    const double unit_m = fields.unit_mm[p] / 1000.0;
    if (fields.turn[p] != turn) {
      turn = fields.turn[p];
      const Index far = std::ssize(lag_ns_);
      for (Index i = 0; i < 2 * far; ++i) {
        const std::int64_t lag_ns = i < far ? lag_ns_[i] : lag_ns_[i - far] + near_ns_[i - far] - offset_ns_[i - far];
        const auto [cos_t, sin_t] = cos_sin(turn * static_cast<double>(lag_ns));
        cos_o[i] = cos_o_[i % lasers] * cos_t - sin_o_[i % lasers] * sin_t;
        sin_o[i] = sin_o_[i % lasers] * cos_t + cos_o_[i % lasers] * sin_t;
      }
    }
    for (Index b = 0; b < layout_.blocks; ++b) {
      Block& block = pairs[b % 2];
      if (fields.dual[p]) {
        if (b % 2 == 0) {
          pairs[0].read(layout_.returns(packets[p], b), layout_, distances_.least);
          pairs[1].read(layout_.returns(packets[p], b + 1), layout_, distances_.least);
        }
        pair(block, pairs[1 - b % 2], lasers, b % 2 == 1, fields.near[p], fields.far[p]);
      } else {
        block.read(layout_.returns(packets[p], b), layout_, distances_.least);
        block.set(lasers, fields.near[p]);
      }
      const std::int64_t start_ns = fields.start_ns(p, b);
      const Index loop = fields.loop(p, b);
      const std::int64_t* offset_ns = &offset_ns_[loop * lasers];
      const std::int64_t* near_ns = &near_ns_[loop * lasers];
      const double azimuth_rad = word(layout_.azimuth(packets[p], b)) * radians_per_hundredth;
      const auto [cos_a, sin_a] = cos_sin(azimuth_rad);
      const double* cos_k = cos_o.data() + loop * lasers;
      const double* sin_k = sin_o.data() + loop * lasers;
      for (Index k = 0; k < lasers; ++k) {  // with a return or without
        const double range_m = block.distance[k] * unit_m;
        const double flat_m = range_m * cos_w_[k];
        x[k] = flat_m * (sin_a * cos_k[k] + cos_a * sin_k[k]);
        y[k] = flat_m * (cos_a * cos_k[k] - sin_a * sin_k[k]);
        z[k] = range_m * sin_w_[k];
      }
      for (Index k = 0; k < (turn != 0 && distances_.near_m > 0 ? lasers : 0); ++k) {
        const double range_m = block.distance[k] * unit_m;
        if (range_m < distances_.near_m) {
          const double flat_m = range_m * cos_w_[k];
          const Index near = (loops_ + loop) * lasers + k;
          x[k] = flat_m * (sin_a * cos_o[near] + cos_a * sin_o[near]);
          y[k] = flat_m * (cos_a * cos_o[near] - sin_a * sin_o[near]);
        }
      }
      for (Index k = 0; k < lasers; ++k) {
        if (block.kind[k] == no_return) {
          continue;
        }
        if (row == out.size()) {
          throw std::invalid_argument("out: fewer rows than returns");
        }
        out.xyz_m[row] = {x[k], y[k], z[k]};
        const bool is_near = block.distance[k] * unit_m < distances_.near_m;
        out.time_ns[row] = later(start_ns, is_near ? near_ns[k] : offset_ns[k]);
        out.laser[row] = static_cast<std::uint8_t>(k);
        out.ring[row] = ring_[k];
        out.intensity[row] = static_cast<std::uint8_t>(block.reflectivity[k]);
        out.return_type[row] = static_cast<std::uint8_t>(block.kind[k]);
        if (out.polar()) {
          constexpr double circle = 2 * std::numbers::pi;
          const Index at = (is_near ? loops_ + loop : loop) * lasers + k;
          const double angle = azimuth_rad + lidarcfg::atan2(sin_o[at], cos_o[at]) - std::numbers::pi / 2;
          out.range_m[row] = block.distance[k] * unit_m;
          out.azimuth_rad[row] = angle - circle * std::floor(angle / circle);
        }
        ++row;
      }
    }
  }
  return row;
}

void write_returns(Tables<const double> range_m, Tables<const std::uint8_t> reflectivity,
                   Rows<const std::uint8_t> laser, View<const std::int64_t> column, Rows<const bool> inside,
                   Limits limits, const Layout& layout, Rows<std::uint8_t> packets) {
  const Index groups = inside.columns();
  const Index firings = laser.columns() / groups;
  std::vector<double> units(firings);
  for (Index p = 0; p < packets.rows(); ++p) {
    for (Index b = 0; b < layout.blocks; ++b) {
      const Index group = b / (layout.blocks / groups);
      if (!inside(p, group)) {
        continue;
      }
      const Index first = group * firings;
      for (Index n = 0; n < firings; ++n) {
        units[n] = limits.units(range_m(p, first + n, column[b]), 0);
      }
      std::uint8_t* returns = layout.returns(packets[p], b);
      for (Index n = 0; n < firings; ++n) {
        const auto whole = static_cast<std::uint16_t>(units[n]);
        std::uint8_t* at = returns + laser(p, first + n) * layout.return_bytes;
        at[0] = whole & 255;
        at[1] = whole >> 8;
        at[2] = whole > 0 ? reflectivity(p, first + n, column[b]) : 0;
      }
    }
  }
}

}  // namespace lidarcfg::packets::hesai
