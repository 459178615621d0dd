#include "returns/known_returns.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <numeric>
#include <tuple>
#include <utility>

namespace lidarcfg::returns {
namespace {

constexpr Index poses_kept = 4096;     // of a scanner, if memory allows: those of many rigs that are searched around
constexpr Index poses_least = 16;      // the sensors of a rig, and of the one before
constexpr Index kept_bytes = 1 << 28;  // that they may take, but for these
constexpr double near_m = 1.0;         // of a place, sensors are likely to see as much

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

bool are_near(const Place& one, const Place& other) {
  return std::abs(one.position_m[0] - other.position_m[0]) <= near_m &&
         std::abs(one.position_m[1] - other.position_m[1]) <= near_m;
}

}  // namespace

KnownReturns::Known::Known(const SensorPose& pose, Index places, Index phases)
    : pose_(pose), phases_(phases), packed_(places, pack(0, unknown)), counts_(places * phases) {}

ReturnTracer::Bounds KnownReturns::Known::bounds(Index place) const {
  return unpack(std::atomic_ref(packed_[place]).load(std::memory_order_acquire));
}

View<const std::int32_t> KnownReturns::Known::counts(Index place) const {
  return {counts_.data() + place * phases_, static_cast<std::size_t>(phases_)};
}

void KnownReturns::Known::keep(Index place, const Bounds& found, View<const std::int32_t> counts) {
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

KnownReturns::Workspace::Workspace(Index places) : order(places), possible(places), probability(0) {
  std::iota(order.begin(), order.end(), Index{0});
}

class KnownReturns::Borrowed {
 public:
  explicit Borrowed(KnownReturns& from) : from_(from) {
    const std::lock_guard lock(from_.mutex_);
    if (!from_.idle_.empty()) {
      workspace_ = std::move(from_.idle_.back());
      from_.idle_.pop_back();
    } else {
      workspace_ = std::make_unique<Workspace>(from_.first_.back());
    }
  }
  Borrowed(const Borrowed&) = delete;
  Borrowed& operator=(const Borrowed&) = delete;
  ~Borrowed() {
    const std::lock_guard lock(from_.mutex_);
    from_.idle_.push_back(std::move(workspace_));
  }

  Workspace& operator*() const { return *workspace_; }

 private:
  KnownReturns& from_;
  std::unique_ptr<Workspace> workspace_;
};

KnownReturns::KnownReturns(std::vector<Scanner> scanners, std::vector<Standing> objects, const Obstacles& obstacles)
    : scanners_(std::move(scanners)),
      objects_(std::move(objects)),
      first_(1, 0),
      bodies_(*obstacles.tree),
      obstacles_{&bodies_, {}, obstacles.origin_m, obstacles.ground_m},
      kept_(scanners_.size()) {
  for (Index object = 0; object < this->objects(); ++object) {
    object_of_.insert(object_of_.end(), places(object), object);
    first_.push_back(std::ssize(object_of_));
  }
  for (const Scanner& scanner : scanners_) {
    pose_bytes_ = std::max(pose_bytes_, first_.back() * static_cast<Index>(sizeof(std::uint64_t) +
                                                                           sizeof(std::int32_t) * scanner.phases()));
  }
  most_poses_ = kept_bytes / std::max<Index>(pose_bytes_ * std::max<Index>(this->scanners(), 1), 1);
  most_poses_ = std::clamp(most_poses_, poses_least, poses_kept);
}

const Place& KnownReturns::place_at(Index place) const {
  const Index object = object_of_[place];
  return objects_[object].places[place - first_[object]];
}

std::size_t KnownReturns::PoseHash::operator()(const SensorPose& pose) const {
  std::size_t seed = 0;
  const auto add = [&](double value) {
    seed ^= std::hash<double>()(value) + 0x9e3779b97f4a7c15 + (seed << 6) + (seed >> 2);
  };
  for (const Vec3& row : pose.R) {
    std::ranges::for_each(row, add);
  }
  std::ranges::for_each(pose.t, add);
  return seed;
}

/// What is known of a scanner at a pose; nothing at a new one, for which the pose that was not used longest goes.
std::shared_ptr<KnownReturns::Known> KnownReturns::known_at(std::int64_t scanner, const SensorPose& pose) {
  const std::lock_guard lock(mutex_);
  auto& [latest, at] = kept_[scanner];
  if (const auto found = at.find(pose); found != at.end()) {
    latest.splice(latest.begin(), latest, found->second);
    return latest.front();
  }
  if (std::ssize(latest) >= most_poses_) {
    at.erase(latest.back()->pose());
    latest.pop_back();
  }
  latest.push_front(std::make_shared<Known>(pose, first_.back(), scanners_[scanner].phases()));
  at.emplace(pose, latest.begin());
  return latest.front();
}

/// Whether sums of probabilities are exact, whatever the order: multiples of a power of two, and not too many.
bool KnownReturns::sums_exactly(const RigAt& rig, Index places) const {
  int bits = std::bit_width(static_cast<std::size_t>(places));
  for (const std::int64_t scanner : rig.scanners) {
    const auto phases = static_cast<unsigned>(scanners_[scanner].phases());
    if (!std::has_single_bit(phases)) {
      return false;
    }
    bits += std::countr_zero(phases);
  }
  return bits <= std::numeric_limits<double>::digits;
}

/// Look up what is known of a rig's sensors. Returns whether it is the rig of the workspace's last call.
bool KnownReturns::take(const RigAt& rig, Workspace& workspace) {
  std::vector<Sensor>& now = workspace.sensors;
  bool same = now.size() == rig.scanners.size();
  for (std::size_t n = 0; same && n < now.size(); ++n) {
    same = now[n].scanner == rig.scanners[n] && now[n].known->pose() == rig.poses[n];
  }
  now.resize(rig.scanners.size());
  for (std::size_t n = 0; !same && n < now.size(); ++n) {
    now[n].scanner = rig.scanners[n];
    now[n].known = known_at(rig.scanners[n], rig.poses[n]);
    now[n].counted.resize(scanners_[rig.scanners[n]].phases());
  }
  return same;
}

/// The places of an object in the order in which to look at them; `same`: for the rig of the last call.
View<const Index> KnownReturns::ordered(const RigAt& rig, Index object, bool same, Workspace& workspace) const {
  const View<Index> order(workspace.order.data() + first_[object], workspace.order.data() + first_[object + 1]);
  if (!sums_exactly(rig, std::ssize(order))) {
    std::sort(order.begin(), order.end());
  } else if (!same) {
    const std::vector<Index>& possible = workspace.possible;
    std::stable_sort(order.begin(), order.end(),
                     [&](Index one, Index other) { return possible[one] < possible[other]; });
  }
  return order;
}

double KnownReturns::misses(const RigAt& rig, View<const double> weights, std::int32_t enough, double most) {
  const Borrowed borrowed(*this);
  Workspace& workspace = *borrowed;
  const bool same = take(rig, workspace);
  workspace.missed.assign(objects(), 0.0);
  std::vector<View<const Index>> left;
  for (Index object = 0; object < objects(); ++object) {
    left.push_back(ordered(rig, object, same, workspace));
  }
  const double all = std::accumulate(weights.begin(), weights.end(), 0.0);
  double value = 0.0;
  const auto add = [&](Index object, Index place) {
    const double here = missed_at(place, enough, workspace);
    if (here == 0.0) {
      return value < most;
    }
    workspace.missed[object] += here;
    value = 0.0;
    for (Index one = 0; one < objects(); ++one) {
      value += weights[one] * (workspace.missed[one] / static_cast<double>(places(one)));
    }
    value /= all;
    return value < most;
  };
  for (const bool likely : {true, false}) {  // first of all objects where they were missed lately
    for (Index object = 0; object < objects(); ++object) {
      while (!left[object].empty() && (!likely || workspace.possible[left[object].front()] < 0)) {
        const Index place = left[object].front();
        left[object] = left[object].subspan(1);
        if (!add(object, place)) {
          return value;
        }
      }
    }
  }
  return value;
}

double KnownReturns::missed(const RigAt& rig, Index object, std::int32_t enough, double most) {
  const Borrowed borrowed(*this);
  const bool same = take(rig, *borrowed);
  double missed = 0.0;
  for (const Index place : ordered(rig, object, same, *borrowed)) {
    missed += missed_at(place, enough, *borrowed);
    if (missed >= most) {
      break;
    }
  }
  return missed;
}

double KnownReturns::missed_among(const RigAt& rig, Index object, std::int32_t enough, Index count) {
  if (!sums_exactly(rig, places(object))) {
    return 0.0;
  }
  const Borrowed borrowed(*this);
  const bool same = take(rig, *borrowed);
  double missed = 0.0;
  for (const Index place : ordered(rig, object, same, *borrowed).first(std::min(count, places(object)))) {
    missed += missed_at(place, enough, *borrowed);
  }
  return missed;
}

void KnownReturns::probabilities(const RigAt& rig, Index object, View<const std::int64_t> places, std::int32_t enough,
                                 View<double> missed) {
  const Borrowed borrowed(*this);
  take(rig, *borrowed);
  for (std::size_t n = 0; n < places.size(); ++n) {
    missed[n] = missed_at(first_[object] + places[n], enough, *borrowed);
  }
}

/// Have what is known at a place be at hand.
void KnownReturns::look_at(Index place, Workspace& workspace) const {
  for (Sensor& sensor : workspace.sensors) {
    sensor.bounds = sensor.known->bounds(place);
    sensor.counts = sensor.known->counts(place);
  }
}

/// The probability that the object is missed at a place.
double KnownReturns::missed_at(Index place, std::int32_t enough, Workspace& workspace) {
  look_at(place, workspace);
  const double missed = find_missed(place, enough, workspace);
  Index possible = 0;
  for (const Sensor& sensor : workspace.sensors) {
    possible += sensor.bounds.most;
  }
  workspace.possible[place] = missed > 0.0 ? -1 : possible;
  return missed;
}

double KnownReturns::find_missed(Index place, std::int32_t enough, Workspace& workspace) {
  std::vector<Sensor>& sensors = workspace.sensors;
  Index least = 0;
  for (const Sensor& sensor : sensors) {
    least += sensor.bounds.least;
  }
  if (least >= enough) {
    return 0.0;
  }
  Index most = 0;
  for (Sensor& sensor : sensors) {
    if (sensor.bounds.most == unknown) {
      workspace.beams.aim(scanners_[sensor.scanner], sensor.known->pose(), object_at(place).shape, place_at(place));
      sensor.bounds = {0, workspace.beams.most_of_a_phase(), false};
      sensor.known->keep(place, sensor.bounds, {});
    }
    most += sensor.bounds.most;
  }
  while (most >= enough) {
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
    count(place, static_cast<std::int32_t>(enough - least), static_cast<std::int32_t>(enough - most), *next, workspace);
    least += next->bounds.least;
    most += next->bounds.most;
    if (least >= enough) {
      return 0.0;
    }
  }
  if (most < enough) {
    return 1.0;
  }
  workspace.counts.clear();
  for (const Sensor& sensor : sensors) {
    workspace.counts.push_back(sensor.counts);
  }
  if (workspace.probability.enough() != enough) {
    workspace.probability = DetectionProbability(enough);
  }
  return 1.0 - workspace.probability.of(workspace.counts);
}

void KnownReturns::lowest(const RigAt& rig, Index object, View<const std::int64_t> places, std::int32_t cap,
                          Index wanted, const LowestCounts& lowest) {
  const Borrowed borrowed(*this);
  take(rig, *borrowed);
  std::vector<char> failed(rig.scanners.size());  // to have the cap where they were counted last, near the place
  const Place* before = nullptr;
  for (std::size_t n = 0; n < places.size(); ++n) {
    const Index place = first_[object] + places[n];
    if (before && !are_near(*before, place_at(place))) {
      std::fill(failed.begin(), failed.end(), 0);
    }
    before = &place_at(place);
    find_lowest(place, cap, wanted, failed, lowest.counts[static_cast<Index>(n)], lowest.phases[static_cast<Index>(n)],
                *borrowed);
  }
}

/// Write the returns (sensors,) in the worst phases at a place, and these phases, as `lowest` does.
void KnownReturns::find_lowest(Index place, std::int32_t cap, Index wanted, std::vector<char>& failed,
                               View<std::int32_t> counts, View<std::int8_t> phases, Workspace& workspace) {
  look_at(place, workspace);
  std::vector<Sensor>& sensors = workspace.sensors;
  Index enough = 0;
  std::vector<std::tuple<bool, double, Index>> open;
  const auto settle = [&](Index s) {
    const Bounds& bounds = sensors[s].bounds;
    counts[s] = std::min(bounds.least, cap);
    if (bounds.least < cap) {
      const View<const std::int32_t> by_phase = sensors[s].counts;
      phases[s] = static_cast<std::int8_t>(std::min_element(by_phase.begin(), by_phase.end()) - by_phase.begin());
    }
    enough += bounds.least >= cap;
  };
  for (Index s = 0; s < std::ssize(sensors); ++s) {
    counts[s] = -1;
    phases[s] = 0;
    if (sensors[s].bounds.exact || sensors[s].bounds.least >= cap) {
      settle(s);
      continue;
    }
    const double x = sensors[s].known->pose().t[0] - place_at(place).position_m[0];
    const double y = sensors[s].known->pose().t[1] - place_at(place).position_m[1];
    open.emplace_back(failed[s], x * x + y * y, s);
  }
  std::sort(open.begin(), open.end());
  for (const auto& [late, distance, s] : open) {
    if (enough >= wanted) {
      return;
    }
    count(place, cap, 0, sensors[s], workspace);
    settle(s);
    failed[s] = counts[s] < cap;
  }
}

/// Count the returns of a sensor from a place; see ReturnTracer::count_until.
void KnownReturns::count(Index place, std::int32_t enough, std::int32_t wanted, Sensor& sensor, Workspace& workspace) {
  std::fill(sensor.counted.begin(), sensor.counted.end(), 0);
  workspace.beams.aim(scanners_[sensor.scanner], sensor.known->pose(), object_at(place).shape, place_at(place));
  const Bounds found = workspace.tracer.count_until(workspace.beams, obstacles_, enough, wanted, sensor.counted);
  sensor.bounds = {std::max(sensor.bounds.least, found.least), std::min(sensor.bounds.most, found.most), found.exact};
  sensor.counts = sensor.counted;
  sensor.known->keep(place, sensor.bounds, sensor.counted);
  ++traced_;
}

}  // namespace lidarcfg::returns
