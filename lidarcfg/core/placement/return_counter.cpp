#include "placement/return_counter.h"

#include <algorithm>
#include <bit>
#include <numeric>
#include <utility>

namespace lidarcfg::placement {
namespace {

constexpr Index poses_kept = 256;        // of a sensor, if memory allows: as many food sources are searched around
constexpr Index memory_bytes = 1 << 26;  // that these may take

}  // namespace

ReturnCounter::ReturnCounter(std::vector<Scanner> scanners, TargetShape target, std::vector<Place> places,
                             const Obstacles& obstacles, std::int32_t enough)
    : scanners_(std::move(scanners)),
      target_(std::move(target)),
      places_(std::move(places)),
      bodies_(*obstacles.tree),
      obstacles_(obstacles),
      enough_(enough),
      known_(scanners_.size()),
      order_(places_.size()),
      probability_(enough) {
  obstacles_.boxes = {};
  Index phases = 0;
  for (std::size_t s = 0; s < scanners_.size(); ++s) {
    phases += scanners_[s].phases();
  }
  const Index of_a_pose =
      std::ssize(places_) * static_cast<Index>(sizeof(Bounds) * scanners_.size() + sizeof(std::int32_t) * phases);
  most_poses_ = std::clamp(memory_bytes / std::max<Index>(of_a_pose, 1), Index{2}, poses_kept);
  std::iota(order_.begin(), order_.end(), Index{0});
}

/// What is known of a sensor at a pose; at a new one nothing is, in the place of the pose that was not used longest.
ReturnCounter::Known& ReturnCounter::known_at(std::int64_t sensor, const SensorPose& pose) {
  std::vector<Known>& kept = known_[sensor];
  auto found = std::find_if(kept.begin(), kept.end(), [&](const Known& one) { return one.pose == pose; });
  if (found == kept.end()) {
    if (std::ssize(kept) < most_poses_) {
      found = kept.emplace(kept.end());
    } else {
      found = std::min_element(kept.begin(), kept.end(),
                               [](const Known& one, const Known& other) { return one.last_use < other.last_use; });
    }
    found->pose = pose;
    found->bounds.assign(places_.size(), Bounds{});
    found->counts.assign(places_.size() * scanners_[sensor].phases(), 0);
  }
  found->last_use = ++uses_;
  return *found;
}

/// Whether sums of probabilities are exact, whatever the order: multiples of a power of two, and not too many.
bool ReturnCounter::sums_exactly(View<const std::int64_t> sensors, Index places) const {
  int bits = std::bit_width(static_cast<std::size_t>(places));
  for (const std::int64_t sensor : sensors) {
    const auto phases = static_cast<unsigned>(scanners_[sensor].phases());
    if (!std::has_single_bit(phases)) {
      return false;
    }
    bits += std::countr_zero(phases);
  }
  return bits <= std::numeric_limits<double>::digits;
}

double ReturnCounter::missed(View<const std::int64_t> sensors, View<const SensorPose> poses, Index first, Index end,
                             double most) {
  sensors_now_.clear();
  for (Index n = 0; n < std::ssize(sensors); ++n) {
    sensors_now_.push_back({sensors[n], &known_at(sensors[n], poses[n])});
  }
  double missed = 0.0;
  if (!sums_exactly(sensors, end - first)) {
    for (Index place = first; place < end && missed < most; ++place) {
      missed += missed_at(place, sensors_now_);
    }
    return missed;
  }
  Index next = first;  // where in the order a missed place comes
  for (Index n = first; n < end && missed < most; ++n) {
    const double here = missed_at(order_[n], sensors_now_);
    missed += here;
    if (here > 0.0) {
      std::swap(order_[next++], order_[n]);
    }
  }
  return missed;
}

void ReturnCounter::aim(Index place, const Sensor& sensor) {
  beams_.aim(scanners_[sensor.number], sensor.known->pose, target_, places_[place]);
}

View<std::int32_t> ReturnCounter::counts_of(Index place, const Sensor& sensor) {
  const Index phases = scanners_[sensor.number].phases();
  return {sensor.known->counts.data() + place * phases, static_cast<std::size_t>(phases)};
}

/// The probability that the object is missed at a place.
double ReturnCounter::missed_at(Index place, View<const Sensor> sensors) {
  Index least = 0;
  for (const Sensor& sensor : sensors) {
    least += sensor.known->bounds[place].least;
  }
  if (least >= enough_) {
    return 0.0;
  }
  Index most = 0;
  for (const Sensor& sensor : sensors) {
    Bounds& bounds = sensor.known->bounds[place];
    if (bounds.most == unknown) {
      aim(place, sensor);
      bounds.most = beams_.most_of_a_phase();
      bounds.counted = bounds.most == 0;
    }
    most += bounds.most;
  }
  for (const Sensor& sensor : sensors) {
    if (most < enough_) {
      return 1.0;
    }
    Bounds& bounds = sensor.known->bounds[place];
    if (bounds.counted) {
      continue;
    }
    const View<std::int32_t> counts = counts_of(place, sensor);
    std::fill(counts.begin(), counts.end(), 0);
    aim(place, sensor);
    ++traced_;
    least -= bounds.least;
    most -= bounds.most;
    obstacles_.tree = &bodies_;
    bounds.counted = tracer_.count(beams_, obstacles_, static_cast<std::int32_t>(enough_ - least), counts);
    const auto [low, high] = std::minmax_element(counts.begin(), counts.end());
    bounds.least = *low;
    bounds.most = bounds.counted ? *high : bounds.most;
    least += bounds.least;
    most += bounds.most;
    if (least >= enough_) {
      return 0.0;
    }
  }
  if (most < enough_) {
    return 1.0;
  }
  counts_now_.clear();
  for (const Sensor& sensor : sensors) {
    counts_now_.push_back(counts_of(place, sensor));
  }
  return 1.0 - probability_.of(counts_now_);
}

}  // namespace lidarcfg::placement
