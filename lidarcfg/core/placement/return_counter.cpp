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
                             std::vector<Index> group_ends, const Obstacles& obstacles, std::int32_t enough)
    : scanners_(std::move(scanners)),
      target_(std::move(target)),
      places_(std::move(places)),
      group_ends_(std::move(group_ends)),
      bodies_(*obstacles.tree),
      obstacles_(obstacles),
      enough_(enough),
      known_(scanners_.size()),
      order_(places_.size()),
      possible_(places_.size()),
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
      kept.reserve(most_poses_);
      found = kept.emplace(kept.end());
    } else {
      found = std::min_element(kept.begin(), kept.end(),
                               [](const Known& one, const Known& other) { return one.last_use < other.last_use; });
    }
    found->pose = pose;
    found->bounds.assign(places_.size(), nothing);
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

/// Look up what is known of some sensors at poses, and have the likeliest misses come first if these are others.
void ReturnCounter::begin(View<const std::int64_t> sensors, View<const SensorPose> poses, View<Index> order) {
  const std::vector<Sensor> before = std::exchange(sensors_now_, {});
  for (Index n = 0; n < std::ssize(sensors); ++n) {
    sensors_now_.push_back({sensors[n], &known_at(sensors[n], poses[n])});
  }
  if (!sums_exactly(sensors, std::ssize(order))) {
    std::sort(order.begin(), order.end());
  } else if (sensors_now_ != before) {
    std::stable_sort(order.begin(), order.end(),
                     [&](Index one, Index other) { return possible_[one] < possible_[other]; });
  }
}

View<Index> ReturnCounter::order_of(Index group) {
  const Index first = group ? group_ends_[group - 1] : 0;
  return {order_.data() + first, static_cast<std::size_t>(group_ends_[group] - first)};
}

double ReturnCounter::missed(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group, double most) {
  const View<Index> order = order_of(group);
  begin(sensors, poses, order);
  double missed = 0.0;
  for (std::size_t n = 0; n < order.size() && missed < most; ++n) {
    missed += missed_at(order[n], sensors_now_);
  }
  return missed;
}

double ReturnCounter::missed_among(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group,
                                   Index count) {
  const View<Index> order = order_of(group);
  if (!sums_exactly(sensors, std::ssize(order))) {
    return 0.0;
  }
  begin(sensors, poses, order);
  double missed = 0.0;
  for (const Index place : order.first(std::min(count, std::ssize(order)))) {
    missed += missed_at(place, sensors_now_);
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

/// The sensor of which the most returns are possible at a place, of those whose returns are not counted; or none.
const ReturnCounter::Sensor* ReturnCounter::most_promising(Index place, View<const Sensor> sensors) {
  const Sensor* found = nullptr;
  for (const Sensor& sensor : sensors) {
    const Bounds& bounds = sensor.known->bounds[place];
    if (!bounds.exact && (!found || bounds.most > found->known->bounds[place].most)) {
      found = &sensor;
    }
  }
  return found;
}

/// The probability that the object is missed at a place.
double ReturnCounter::missed_at(Index place, View<const Sensor> sensors) {
  const double missed = find_missed(place, sensors);
  Index possible = 0;
  for (const Sensor& sensor : sensors) {
    possible += sensor.known->bounds[place].most;
  }
  possible_[place] = missed > 0.0 ? -1 : possible;
  return missed;
}

double ReturnCounter::find_missed(Index place, View<const Sensor> sensors) {
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
      bounds.exact = bounds.most == 0;
    }
    most += bounds.most;
  }
  while (most >= enough_) {
    const Sensor* const next = most_promising(place, sensors);
    if (!next) {
      break;
    }
    const Sensor& sensor = *next;
    Bounds& bounds = sensor.known->bounds[place];
    const View<std::int32_t> counts = counts_of(place, sensor);
    std::fill(counts.begin(), counts.end(), 0);
    aim(place, sensor);
    ++traced_;
    least -= bounds.least;
    most -= bounds.most;
    obstacles_.tree = &bodies_;
    const Bounds found = tracer_.count_until(beams_, obstacles_, static_cast<std::int32_t>(enough_ - least),
                                             static_cast<std::int32_t>(enough_ - most), counts);
    bounds = {std::max(bounds.least, found.least), std::min(bounds.most, found.most), found.exact};
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
