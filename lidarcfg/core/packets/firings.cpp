#include "packets/firings.h"

#include <cmath>
#include <numbers>

namespace lidarcfg::packets {

void fire(View<const double> revolutions, View<const std::int64_t> stamp_ns, View<const std::int64_t> offset_ns,
          double revolutions_per_ns, Rows<std::int64_t> time_ns, Rows<double> encoder_rad) {
  for (Index p = 0; p < time_ns.rows(); ++p) {
    for (Index n = 0; n < time_ns.columns(); ++n) {
      const double turn = revolutions[p] + offset_ns[n] * revolutions_per_ns;
      time_ns(p, n) = stamp_ns[p] + offset_ns[n];
      encoder_rad(p, n) = (turn - std::floor(turn)) * (2 * std::numbers::pi);
    }
  }
}

}  // namespace lidarcfg::packets
