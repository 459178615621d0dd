#include "world/tracer.h"

#include <limits>
#include <memory>

#include "world/packer.h"

namespace lidarcfg::world {

void first_hits(const Bvh& bvh, Rows<const double> origins, Rows<const double> directions, double limit_m,
                View<double> range_m, View<std::int32_t> slot) {
  Packet packet;
  for (Index first = 0; first < origins.columns();) {
    const auto [count, face] = alike(directions, first, directions.columns());
    packet.load(origins, directions, first, count, face);
    packet.limit(limit_m);
    packet.first_hits(bvh);
    for (int n = 0; n < count; ++n) {
      slot[first + n] = packet.slot(n);
      range_m[first + n] = packet.slot(n) == no_slot ? std::numeric_limits<double>::infinity() : packet.range(n);
    }
    first += count;
  }
}

void any_hits(const Bvh& bvh, Rows<const double> origins, Rows<const double> directions, View<bool> hit) {
  const auto packer = std::make_unique<Packer>();
  const auto take = [&](Packet& packet, View<const Index> numbers) {
    packet.limit(1 - ends);
    packet.any_hits(bvh);
    for (Index n = 0; n < std::ssize(numbers); ++n) {
      hit[numbers[n]] = packet.slot(static_cast<int>(n)) >= 0;
    }
  };
  for (Index first = 0; first < origins.columns();) {
    const auto [count, face] = alike(directions, first, origins.columns());
    packer->add(origins, directions, first, count, face, take);
    first += count;
  }
  packer->finish(take);
}

}  // namespace lidarcfg::world
