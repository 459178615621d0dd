#include "packets/blocks.h"

#include <vector>

#include "packets/robosense.h"
#include "packets/velodyne.h"

namespace lidarcfg::packets {

template <class Maker>
void write_returns(Rows<const double> range_m, Rows<const std::uint8_t> reflectivity, View<const std::int64_t> number,
                   View<const double> offset_m, Limits limits, Rows<std::uint8_t> packets) {
  std::vector<double> units(number.size());
  for (Index p = 0; p < packets.rows(); ++p) {
    for (std::size_t slot = 0; slot < units.size(); ++slot) {
      units[slot] = range_m(p, number[slot]);
    }
    for (std::size_t slot = 0; slot < units.size(); ++slot) {
      units[slot] = limits.units(units[slot], offset_m[slot]);
    }
    for (std::size_t slot = 0; slot < units.size(); ++slot) {
      std::uint8_t* at = return_at<Maker>(packets[p], slot);
      set_word<Maker>(at, static_cast<std::uint16_t>(units[slot]));
      at[2] = units[slot] > 0 ? reflectivity(p, number[slot]) : 0;
    }
  }
}

template void write_returns<Velodyne>(Rows<const double>, Rows<const std::uint8_t>, View<const std::int64_t>,
                                      View<const double>, Limits, Rows<std::uint8_t>);
template void write_returns<Robosense>(Rows<const double>, Rows<const std::uint8_t>, View<const std::int64_t>,
                                       View<const double>, Limits, Rows<std::uint8_t>);
template void write_returns<Airy>(Rows<const double>, Rows<const std::uint8_t>, View<const std::int64_t>,
                                  View<const double>, Limits, Rows<std::uint8_t>);
template void write_returns<Fairy>(Rows<const double>, Rows<const std::uint8_t>, View<const std::int64_t>,
                                   View<const double>, Limits, Rows<std::uint8_t>);

}  // namespace lidarcfg::packets
