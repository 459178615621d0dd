/// When lasers fire, and where the head points then.
#pragma once

#include "views.h"

namespace lidarcfg::packets {

/// Write times and azimuths of firings, which come at offsets after their packets' stamps.
///
/// @param revolutions         (P,) how far the head has turned at each packet's stamp
/// @param stamp_ns            (P,)
/// @param offset_ns           (N,)
/// @param revolutions_per_ns  the head's speed
/// @param time_ns             (P, N)
/// @param encoder_rad         (P, N) from 0 to 2 pi
void fire(View<const double> revolutions, View<const std::int64_t> stamp_ns, View<const std::int64_t> offset_ns,
          double revolutions_per_ns, Rows<std::int64_t> time_ns, Rows<double> encoder_rad);

}  // namespace lidarcfg::packets
