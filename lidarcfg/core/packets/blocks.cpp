#include "packets/blocks.h"

#include "packets/robosense.h"
#include "packets/velodyne.h"

namespace lidarcfg::packets {

template <class Maker>
void write_returns(Rows<const double> range_m, Rows<const std::uint8_t> reflectivity, View<const std::int64_t> number,
                   View<const double> offset_m, const Limits& limits, Rows<std::uint8_t> packets) {
  for (Index p = 0; p < packets.rows(); ++p) {
    for (Index slot = 0; slot < std::ssize(number); ++slot) {
      const Index n = number[slot];
      const auto units = static_cast<std::uint16_t>(limits.units(range_m(p, n), offset_m[slot]));
      std::uint8_t* at = return_at<Maker>(packets[p], slot);
      set_word<Maker>(at, units);
      at[2] = units > 0 ? reflectivity(p, n) : 0;
    }
  }
}

template void write_returns<Velodyne>(Rows<const double>, Rows<const std::uint8_t>, View<const std::int64_t>,
                                      View<const double>, const Limits&, Rows<std::uint8_t>);
template void write_returns<Robosense>(Rows<const double>, Rows<const std::uint8_t>, View<const std::int64_t>,
                                       View<const double>, const Limits&, Rows<std::uint8_t>);

}  // namespace lidarcfg::packets
