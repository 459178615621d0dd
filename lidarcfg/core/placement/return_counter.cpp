#include "placement/return_counter.h"

#include <algorithm>
#include <bit>
#include <limits>
#include <numeric>
#include <utility>

namespace lidarcfg::placement {
namespace {

constexpr Index poses_kept = 256;      // of a sensor, if memory allows: as many food sources are searched around
constexpr Index kept_bytes = 1 << 27;  // that these may take; two of a sensor may take more

constexpr int number_bits = 31;
constexpr std::uint64_t number_mask = (std::uint64_t{1} << number_bits) - 1;
constexpr std::uint64_t exact_bit = std::uint64_t{1} << 62;
constexpr std::uint64_t claimed_bit = std::uint64_t{1} << 63;  // a thread writes the counts
constexpr auto unknown = static_cast<std::int32_t>(number_mask);

std::uint64_t pack(std::int32_t least, std::int32_t most) {
  return static_cast<std::uint64_t>(least) | static_cast<std::uint64_t>(most) << number_bits;
}

ReturnTracer::Bounds unpack(std::uint64_t packed) {
  return {static_cast<std::int32_t>(packed & number_mask),
          static_cast<std::int32_t>(packed >> number_bits & number_mask), (packed & exact_bit) != 0};
}

}  // namespace

ReturnCounter::Known::Known(const SensorPose& pose, Index places, Index phases)
    : pose_(pose), phases_(phases), packed_(places, pack(0, unknown)), counts_(places * phases) {}

ReturnTracer::Bounds ReturnCounter::Known::bounds(Index place) const {
  return unpack(std::atomic_ref(packed_[place]).load(std::memory_order_acquire));
}

View<const std::int32_t> ReturnCounter::Known::counts(Index place) const {
  return {counts_.data() + place * phases_, static_cast<std::size_t>(phases_)};
}

void ReturnCounter::Known::keep(Index place, const Bounds& found, View<const std::int32_t> counts) {
  const std::atomic_ref packed(packed_[place]);
  std::uint64_t old = packed.load(std::memory_order_acquire);
  std::uint64_t next;
  do {
    if (old & (exact_bit | claimed_bit)) {
      return;
    }
    const Bounds known = unpack(old);
    next = found.exact ? old | claimed_bit : pack(std::max(known.least, found.least), std::min(known.most, found.most));
  } while (!packed.compare_exchange_weak(old, next, std::memory_order_acq_rel));
  if (found.exact) {
    std::copy(counts.begin(), counts.end(), counts_.begin() + place * phases_);
    packed.store(pack(found.least, found.most) | exact_bit, std::memory_order_release);
  }
}

ReturnCounter::Workspace::Workspace(Index places, Index enough) : order(places), possible(places), probability(enough) {
  std::iota(order.begin(), order.end(), Index{0});
}

ReturnCounter::ReturnCounter(std::vector<Scanner> scanners, TargetShape target, std::vector<Place> places,
                             std::vector<Index> group_ends, const Obstacles& obstacles, std::int32_t enough)
    : scanners_(std::move(scanners)),
      target_(std::move(target)),
      places_(std::move(places)),
      group_ends_(std::move(group_ends)),
      bodies_(*obstacles.tree),
      obstacles_{&bodies_, {}, obstacles.origin_m, obstacles.ground_m},
      enough_(enough),
      kept_(scanners_.size()) {
  for (const Scanner& scanner : scanners_) {
    pose_bytes_ +=
        std::ssize(places_) * static_cast<Index>(sizeof(std::uint64_t) + sizeof(std::int32_t) * scanner.phases());
  }
  most_poses_ = std::clamp(kept_bytes / std::max<Index>(pose_bytes_, 1), Index{2}, poses_kept);
}

std::unique_ptr<ReturnCounter::Workspace> ReturnCounter::take_workspace() {
  {
    const std::lock_guard lock(mutex_);
    if (!idle_.empty()) {
      std::unique_ptr<Workspace> found = std::move(idle_.back());
      idle_.pop_back();
      return found;
    }
  }
  return std::make_unique<Workspace>(std::ssize(places_), enough_);
}

void ReturnCounter::give_back(std::unique_ptr<Workspace> workspace) {
  const std::lock_guard lock(mutex_);
  idle_.push_back(std::move(workspace));
}

/// What is known of a sensor at a pose; nothing at a new one, in the place of the pose that was not used longest.
std::shared_ptr<ReturnCounter::Known> ReturnCounter::known_at(std::int64_t sensor, const SensorPose& pose) {
  const std::lock_guard lock(mutex_);
  std::vector<Kept>& kept = kept_[sensor];
  auto found = std::find_if(kept.begin(), kept.end(), [&](const Kept& one) { return one.known->pose() == pose; });
  if (found == kept.end()) {
    if (std::ssize(kept) < most_poses_) {
      found = kept.emplace(kept.end());
    } else {
      found = std::min_element(kept.begin(), kept.end(),
                               [](const Kept& one, const Kept& other) { return one.last_use < other.last_use; });
    }
    found->known = std::make_shared<Known>(pose, std::ssize(places_), scanners_[sensor].phases());
  }
  found->last_use = ++uses_;
  return found->known;
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

/// Look up what is known of some sensors at poses; returns the places of a group in the order in which to look at them.
View<const Index> ReturnCounter::begin(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group,
                                       Workspace& workspace) {
  std::vector<Sensor>& now = workspace.sensors;
  const Index first = group ? group_ends_[group - 1] : 0;
  const View<Index> order(workspace.order.data() + first, workspace.order.data() + group_ends_[group]);
  const bool exactly = sums_exactly(sensors, std::ssize(order));
  bool same = now.size() == sensors.size();
  for (std::size_t n = 0; same && n < sensors.size(); ++n) {
    same = now[n].number == sensors[n] && now[n].known->pose() == poses[n];
  }
  if (!exactly) {
    std::sort(order.begin(), order.end());
  } else if (!same) {
    const std::vector<Index>& possible = workspace.possible;
    std::stable_sort(order.begin(), order.end(),
                     [&](Index one, Index other) { return possible[one] < possible[other]; });
  }
  now.resize(sensors.size());
  for (std::size_t n = 0; !same && n < sensors.size(); ++n) {
    now[n].number = sensors[n];
    now[n].known = known_at(sensors[n], poses[n]);
    now[n].counted.resize(scanners_[sensors[n]].phases());
  }
  return order;
}

double ReturnCounter::missed(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group, double most) {
  std::unique_ptr<Workspace> workspace = take_workspace();
  double missed = 0.0;
  for (const Index place : begin(sensors, poses, group, *workspace)) {
    missed += missed_at(place, *workspace);
    if (missed >= most) {
      break;
    }
  }
  give_back(std::move(workspace));
  return missed;
}

double ReturnCounter::missed_among(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group,
                                   Index count) {
  const Index places = group_ends_[group] - (group ? group_ends_[group - 1] : 0);
  if (!sums_exactly(sensors, places)) {
    return 0.0;
  }
  std::unique_ptr<Workspace> workspace = take_workspace();
  double missed = 0.0;
  for (const Index place : begin(sensors, poses, group, *workspace).first(std::min(count, places))) {
    missed += missed_at(place, *workspace);
  }
  give_back(std::move(workspace));
  return missed;
}

/// The probability that the object is missed at a place.
double ReturnCounter::missed_at(Index place, Workspace& workspace) {
  for (Sensor& sensor : workspace.sensors) {
    sensor.bounds = sensor.known->bounds(place);
    sensor.counts = sensor.known->counts(place);
  }
  const double missed = find_missed(place, workspace);
  Index possible = 0;
  for (const Sensor& sensor : workspace.sensors) {
    possible += sensor.bounds.most;
  }
  workspace.possible[place] = missed > 0.0 ? -1 : possible;
  return missed;
}

double ReturnCounter::find_missed(Index place, Workspace& workspace) {
  std::vector<Sensor>& sensors = workspace.sensors;
  Index least = 0;
  for (const Sensor& sensor : sensors) {
    least += sensor.bounds.least;
  }
  if (least >= enough_) {
    return 0.0;
  }
  Index most = 0;
  for (Sensor& sensor : sensors) {
    if (sensor.bounds.most == unknown) {
      workspace.beams.aim(scanners_[sensor.number], sensor.known->pose(), target_, places_[place]);
      sensor.bounds = {0, workspace.beams.most_of_a_phase(), false};
      sensor.known->keep(place, sensor.bounds, {});
    }
    most += sensor.bounds.most;
  }
  while (most >= enough_) {
    Sensor* next = nullptr;  // of which the most returns are possible, of those whose returns are not counted
    for (Sensor& sensor : sensors) {
      if (!sensor.bounds.exact && (!next || sensor.bounds.most > next->bounds.most)) {
        next = &sensor;
      }
    }
    if (!next) {
      break;
    }
    least -= next->bounds.least;
    most -= next->bounds.most;
    count(place, static_cast<std::int32_t>(enough_ - least), static_cast<std::int32_t>(enough_ - most), *next,
          workspace);
    least += next->bounds.least;
    most += next->bounds.most;
    if (least >= enough_) {
      return 0.0;
    }
  }
  if (most < enough_) {
    return 1.0;
  }
  workspace.counts.clear();
  for (const Sensor& sensor : sensors) {
    workspace.counts.push_back(sensor.counts);
  }
  return 1.0 - workspace.probability.of(workspace.counts);
}

/// Count the returns of a sensor from a place; see ReturnTracer::count_until.
void ReturnCounter::count(Index place, std::int32_t enough, std::int32_t wanted, Sensor& sensor, Workspace& workspace) {
  std::fill(sensor.counted.begin(), sensor.counted.end(), 0);
  workspace.beams.aim(scanners_[sensor.number], sensor.known->pose(), target_, places_[place]);
  const Bounds found = workspace.tracer.count_until(workspace.beams, obstacles_, enough, wanted, sensor.counted);
  sensor.bounds = {std::max(sensor.bounds.least, found.least), std::min(sensor.bounds.most, found.most), found.exact};
  sensor.counts = sensor.counted;
  sensor.known->keep(place, sensor.bounds, sensor.counted);
  ++traced_;
}

}  // namespace lidarcfg::placement
