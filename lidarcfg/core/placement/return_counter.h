/// Detection by returns as the cost of a search, whose trials move few sensors.
///
/// What is known of a sensor at a pose is kept for the latest poses: bounds of its returns from each place (no more
/// than its beams that point at the bounding box), and the returns themselves where these were needed. A place is
/// decided without tracing where the bounds of all sensors say that the returns are, or cannot be, enough. Places that
/// were missed lately come first, so that a trial that is worse is soon known to be.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <vector>

#include "placement/return_counts.h"

namespace lidarcfg::placement {

/// Threads share it, and so what each has found.
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

  /// In how many places of a group the object is missed, by the mean over phases, by some of the sensors, whose numbers
  /// ascend, at poses. Or, as soon as it is known to be at least `most`, any number that is.
  double missed(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group, double most);

  /// The same among `count` of these places, those that are the likeliest to be missed: no more than `missed`.
  /// 0 where sums are not exact.
  double missed_among(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group, Index count);

  /// What is known of poses takes no more memory.
  Index memory_bytes() const { return most_poses_ * pose_bytes_; }

  /// How many pairs of sensor and place were traced so far.
  std::int64_t traced() const { return traced_; }

 private:
  using Bounds = ReturnTracer::Bounds;

  /// What is known of a sensor's returns at a pose. Threads read and write it at once.
  class Known {
   public:
    Known(const SensorPose& pose, Index places, Index phases);

    const SensorPose& pose() const { return pose_; }

    /// Between how many returns there are in any phase.
    Bounds bounds(Index place) const;

    /// (phases,) the returns, where bounds are exact.
    View<const std::int32_t> counts(Index place) const;

    /// Keep what was found, with counts (phases,) where it is exact.
    void keep(Index place, const Bounds& found, View<const std::int32_t> counts);

   private:
    SensorPose pose_;
    Index phases_;
    mutable std::vector<std::uint64_t> packed_;  // (places,) bounds
    std::vector<std::int32_t> counts_;           // (places, phases)
  };

  /// A pose that is kept of a sensor.
  struct Kept {
    std::shared_ptr<Known> known;
    std::int64_t last_use;
  };

  /// A sensor of a trial, and what is known at the place that is looked at.
  struct Sensor {
    std::int64_t number;
    std::shared_ptr<Known> known;
    Bounds bounds;
    View<const std::int32_t> counts;         // where bounds are exact
    std::vector<std::int32_t> counted = {};  // here
  };

  /// What a call works with.
  struct Workspace {
    Workspace(Index places, Index enough);

    std::vector<Index> order;     // of places: those missed lately, then those of the fewest possible returns
    std::vector<Index> possible;  // (places,) returns lately; -1: it was missed
    std::vector<Sensor> sensors;
    std::vector<View<const std::int32_t>> counts;
    DetectionProbability probability;
    ReturnTracer tracer;
    AimedBeams beams;
  };

  std::unique_ptr<Workspace> take_workspace();
  void give_back(std::unique_ptr<Workspace> workspace);
  std::shared_ptr<Known> known_at(std::int64_t sensor, const SensorPose& pose);
  bool sums_exactly(View<const std::int64_t> sensors, Index places) const;
  View<const Index> begin(View<const std::int64_t> sensors, View<const SensorPose> poses, Index group,
                          Workspace& workspace);
  double missed_at(Index place, Workspace& workspace);
  double find_missed(Index place, Workspace& workspace);
  void count(Index place, std::int32_t enough, std::int32_t wanted, Sensor& sensor, Workspace& workspace);

  std::vector<Scanner> scanners_;
  TargetShape target_;
  std::vector<Place> places_;
  std::vector<Index> group_ends_;
  world::Bvh bodies_;
  Obstacles obstacles_;
  std::int32_t enough_;
  Index pose_bytes_ = 0;  // that what is known of a pose of each sensor takes
  Index most_poses_;      // that are kept of a sensor
  std::atomic<std::int64_t> traced_ = 0;

  std::mutex mutex_;                     // of what follows
  std::vector<std::vector<Kept>> kept_;  // by sensor
  std::int64_t uses_ = 0;
  std::vector<std::unique_ptr<Workspace>> idle_;
};

}  // namespace lidarcfg::placement
