/// Detection by returns as the cost of a search, whose trials move few sensors.
///
/// What is known of a sensor at a pose is kept for the latest poses: bounds of its returns from each place (no more
/// than its beams that point at the bounding box), and the returns themselves where these were needed. A place is
/// decided without tracing where the bounds of all sensors say that the returns are, or cannot be, enough. Places that
/// were missed lately come first, so that a trial that is worse is soon known to be.
#pragma once

#include <limits>
#include <vector>

#include "placement/return_counts.h"

namespace lidarcfg::placement {

/// Not for several threads at once.
class ReturnCounter {
 public:
  /// For an object that is detected by `enough` returns, which stands at places, and for scanners in front of which
  /// there may be obstacles.
  ///
  /// @param group_ends  where groups of places end, ascending; the last one is the number of places
  ReturnCounter(std::vector<Scanner> scanners, TargetShape target, std::vector<Place> places,
                std::vector<Index> group_ends, const Obstacles& obstacles, std::int32_t enough);

  Index sensors() const { return std::ssize(scanners_); }
  Index groups() const { return std::ssize(group_ends_); }

  /// In how many places of a group the object is missed, by the mean over phases, by some of the
  /// sensors, whose numbers ascend, at poses. Or, as soon as it is known to be at least `most`, any number that is.
  double missed(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group, double most);

  /// The same among `count` of these places, those that are the likeliest to be missed: no more than `missed`.
  /// 0 where sums are not exact.
  double missed_among(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group, Index count);

  /// How many pairs of sensor and place were traced so far.
  std::int64_t traced() const { return traced_; }

 private:
  using Bounds = ReturnTracer::Bounds;
  static constexpr std::int32_t unknown = std::numeric_limits<std::int32_t>::max();
  static constexpr Bounds nothing{0, unknown, false};  // is known

  struct Known {
    SensorPose pose;
    std::int64_t last_use = 0;
    std::vector<Bounds> bounds;        // (places,)
    std::vector<std::int32_t> counts;  // (places, phases) where bounds are exact
  };
  struct Sensor {
    std::int64_t number;
    Known* known;

    bool operator==(const Sensor&) const = default;
  };

  void begin(View<const std::int64_t> sensors, View<const SensorPose> poses, View<Index> order);
  /// The places of a group, in the order in which they are asked.
  View<Index> order_of(Index group);
  Known& known_at(std::int64_t sensor, const SensorPose& pose);
  static const Sensor* most_promising(Index place, View<const Sensor> sensors);
  double missed_at(Index place, View<const Sensor> sensors);
  double find_missed(Index place, View<const Sensor> sensors);
  void aim(Index place, const Sensor& sensor);
  View<std::int32_t> counts_of(Index place, const Sensor& sensor);
  bool sums_exactly(View<const std::int64_t> sensors, Index places) const;

  std::vector<Scanner> scanners_;
  TargetShape target_;
  std::vector<Place> places_;
  std::vector<Index> group_ends_;
  world::Bvh bodies_;
  Obstacles obstacles_;
  std::int32_t enough_;

  Index most_poses_;                       // that are kept of a sensor
  std::vector<std::vector<Known>> known_;  // by sensor
  std::vector<Index> order_;               // of places: those missed lately, then those of the fewest possible returns
  std::vector<Index> possible_;            // (places,) returns lately; -1: it was missed
  std::vector<Sensor> sensors_now_;
  std::vector<View<const std::int32_t>> counts_now_;
  DetectionProbability probability_;
  ReturnTracer tracer_;
  AimedBeams beams_;
  std::int64_t uses_ = 0;
  std::int64_t traced_ = 0;
};

}  // namespace lidarcfg::placement
