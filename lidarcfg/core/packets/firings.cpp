#include "packets/firings.h"

#include <cmath>
#include <numbers>
#include <vector>

#include "times.h"

namespace lidarcfg::packets {

void fire(View<const double> revolutions, View<const std::int64_t> stamp_ns, View<const std::int64_t> offset_ns,
          double revolutions_per_ns, Rows<std::int64_t> time_ns, Rows<double> encoder_rad) {
  std::vector<double> turned(offset_ns.size());  // revolutions, after the stamp
  for (std::size_t n = 0; n < turned.size(); ++n) {
    turned[n] = offset_ns[n] * revolutions_per_ns;
  }
  for (Index p = 0; p < time_ns.rows(); ++p) {
    const double begun = revolutions[p];
    const std::int64_t began_ns = stamp_ns[p];
    double* const angle_rad = encoder_rad[p].data();
    for (std::size_t n = 0; n < turned.size(); ++n) {
      const double turn = begun + turned[n];
      angle_rad[n] = (turn - std::floor(turn)) * (2 * std::numbers::pi);
    }
    for (std::size_t n = 0; n < turned.size(); ++n) {
      time_ns[p][n] = later(began_ns, offset_ns[n]);
    }
  }
}

}  // namespace lidarcfg::packets
