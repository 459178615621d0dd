/// Detection by returns as the cost of a search, whose trials move few sensors.
///
/// What is known of a sensor at a pose is kept for the latest poses: bounds of its returns from each place (no more
/// than its beams that point at the bounding box), and the returns themselves where these were needed. A place is
/// decided without tracing where the bounds of all sensors say that the returns are, or cannot be, enough. Places that
/// were missed lately come first, so that a trial that is worse is soon known to be.
#pragma once

#include <vector>

#include "placement/return_counts.h"

namespace lidarcfg::placement {

/// Not for several threads at once.
class ReturnCounter {
 public:
  /// For an object that is detected by `enough` returns, which stands at places, and for scanners in front of which
  /// there may be obstacles.
  ReturnCounter(std::vector<Scanner> scanners, TargetShape target, std::vector<Place> places,
                const Obstacles& obstacles, std::int32_t enough);

  Index sensors() const { return std::ssize(scanners_); }
  Index places() const { return std::ssize(places_); }

  /// In how many of the places from `first` to `end` the object is missed, by the mean over phases, by some of the
  /// sensors, whose numbers ascend, at poses. Or, as soon as it is known to be at least `most`, any number that is.
  double missed(View<const std::int64_t> sensors, View<const SensorPose> poses, Index first, Index end, double most);

  /// How many pairs of sensor and place were traced so far.
  std::int64_t traced() const { return traced_; }

 private:
  /// Between how many returns of a sensor at a place there are in any phase.
  struct Bounds {
    std::int32_t least = 0;
    std::int32_t most = unknown;
    bool counted = false;
  };
  static constexpr std::int32_t unknown = std::numeric_limits<std::int32_t>::max();

  struct Known {
    SensorPose pose;
    std::int64_t last_use = 0;
    std::vector<Bounds> bounds;        // (places,)
    std::vector<std::int32_t> counts;  // (places, phases) where they are counted
  };
  struct Sensor {
    std::int64_t number;
    Known* known;
  };

  Known& known_at(std::int64_t sensor, const SensorPose& pose);
  double missed_at(Index place, View<const Sensor> sensors);
  void aim(Index place, const Sensor& sensor);
  View<std::int32_t> counts_of(Index place, const Sensor& sensor);
  bool sums_exactly(View<const std::int64_t> sensors, Index places) const;

  std::vector<Scanner> scanners_;
  TargetShape target_;
  std::vector<Place> places_;
  world::Bvh bodies_;
  Obstacles obstacles_;
  std::int32_t enough_;

  Index most_poses_;                       // that are kept of a sensor
  std::vector<std::vector<Known>> known_;  // by sensor
  std::vector<Index> order_;               // of places
  std::vector<Sensor> sensors_now_;
  std::vector<View<const std::int32_t>> counts_now_;
  DetectionProbability probability_;
  ReturnTracer tracer_;
  AimedBeams beams_;
  std::int64_t uses_ = 0;
  std::int64_t traced_ = 0;
};

}  // namespace lidarcfg::placement
