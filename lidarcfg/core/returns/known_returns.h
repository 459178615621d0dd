/// The returns from objects at their places, of sensors at poses, rig after rig.
///
/// What is known of a sensor at a pose is kept for the latest poses: between how many returns it has at each place (at
/// most its beams that point at the bounding box), and the returns of each phase where these were needed. So of a rig
/// only the sensors that moved are traced, and those only where the others do not settle the place.
#pragma once

#include <atomic>
#include <list>
#include <memory>
#include <mutex>
#include <unordered_map>
#include <vector>

#include "returns/counts.h"

namespace lidarcfg::returns {

/// An object and the places where it may stand.
struct Standing {
  TargetShape shape;
  std::vector<Place> places;
};

/// A rig: sensors, each of the scanner with its number, at their poses.
struct RigAt {
  View<const std::int64_t> scanners;
  View<const SensorPose> poses;
};

/// Each sensor's returns in its worst phase, up to a cap.
struct LowestCounts {
  Rows<std::int32_t> counts;  // (places, sensors) at most the cap; below 0: unknown
  Rows<std::int8_t> phases;   // (places, sensors) the phase, where there are fewer than the cap
};

/// Threads share it, and so what each has found.
class KnownReturns {
 public:
  /// For scanners in front of which there may be obstacles.
  KnownReturns(std::vector<Scanner> scanners, std::vector<Standing> objects, const Obstacles& obstacles);

  Index scanners() const { return std::ssize(scanners_); }
  Index objects() const { return std::ssize(objects_); }
  Index places(Index object) const { return std::ssize(objects_[object].places); }

  /// The weighted mean over objects of the share of places with fewer than `enough` returns, by the mean over phases.
  /// Or, as soon as it is known to be at least `most`, any number that is.
  double misses(const RigAt& rig, View<const double> weights, std::int32_t enough, double most);

  /// The same of one object: in how many of its places.
  double missed(const RigAt& rig, Index object, std::int32_t enough, double most);

  /// The same among `count` of these places, those that are the likeliest to be missed: no more than `missed`.
  /// 0 where sums are not exact.
  double missed_among(const RigAt& rig, Index object, std::int32_t enough, Index count);

  /// Write how likely an object is missed at each of some of its places.
  void probabilities(const RigAt& rig, Index object, View<const std::int64_t> places, std::int32_t enough,
                     View<double> missed);

  /// Write each sensor's returns in its worst phase at some places of an object, until `wanted` sensors have `cap`: the
  /// others' stay unknown. The nearest sensors come first, but last those that did not have it at the place before, if
  /// that is near.
  void lowest(const RigAt& rig, Index object, View<const std::int64_t> places, std::int32_t cap, Index wanted,
              const LowestCounts& lowest);

  /// What is known of poses takes no more memory.
  Index memory_bytes() const { return most_poses_ * pose_bytes_ * scanners(); }

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

  struct PoseHash {
    std::size_t operator()(const SensorPose& pose) const;
  };

  /// What is known of a scanner at the latest poses.
  struct Kept {
    std::list<std::shared_ptr<Known>> latest;  // the last one that was used first
    std::unordered_map<SensorPose, std::list<std::shared_ptr<Known>>::iterator, PoseHash> at;
  };

  /// A sensor of a rig, and what is known at the place that is looked at.
  struct Sensor {
    std::int64_t scanner;
    std::shared_ptr<Known> known;
    Bounds bounds = {};
    View<const std::int32_t> counts = {};    // where bounds are exact
    std::vector<std::int32_t> counted = {};  // here
  };

  /// What a call works with. Places are numbered over all objects.
  struct Workspace {
    explicit Workspace(Index places);

    std::vector<Index> order;     // of places: those missed lately, then those of the fewest possible returns
    std::vector<Index> possible;  // (places,) returns lately; -1: it was missed
    std::vector<Sensor> sensors;
    std::vector<View<const std::int32_t>> counts;
    std::vector<double> missed;  // (objects,) places so far
    DetectionProbability probability;
    ReturnTracer tracer;
    AimedBeams beams;
  };

  /// A workspace for as long as a call lasts.
  class Borrowed;

  std::shared_ptr<Known> known_at(std::int64_t scanner, const SensorPose& pose);
  bool sums_exactly(const RigAt& rig, Index places) const;
  bool take(const RigAt& rig, Workspace& workspace);
  View<const Index> ordered(const RigAt& rig, Index object, bool same, Workspace& workspace) const;
  void look_at(Index place, Workspace& workspace) const;
  double missed_at(Index place, std::int32_t enough, Workspace& workspace);
  double find_missed(Index place, std::int32_t enough, Workspace& workspace);
  void count(Index place, std::int32_t enough, std::int32_t wanted, Sensor& sensor, Workspace& workspace);
  void find_lowest(Index place, std::int32_t cap, Index wanted, std::vector<char>& failed, View<std::int32_t> counts,
                   View<std::int8_t> phases, Workspace& workspace);
  const Standing& object_at(Index place) const { return objects_[object_of_[place]]; }
  const Place& place_at(Index place) const;

  std::vector<Scanner> scanners_;
  std::vector<Standing> objects_;
  std::vector<Index> first_;      // (objects + 1,) the number of the first place of each
  std::vector<Index> object_of_;  // (places,)
  world::Bvh bodies_;
  Obstacles obstacles_;
  Index pose_bytes_ = 0;  // that what is known of a pose takes, at most
  Index most_poses_;      // that are kept of a scanner
  std::atomic<std::int64_t> traced_ = 0;

  std::mutex mutex_;        // of what follows
  std::vector<Kept> kept_;  // by scanner
  std::vector<std::unique_ptr<Workspace>> idle_;
};

}  // namespace lidarcfg::returns
