/// Returns from an object: what of a sensor's beams hits it, within range and field of view, before anything else.
#pragma once

#include <vector>

#include "returns/scanner.h"
#include "world/obstacles.h"
#include "world/packet.h"

namespace lidarcfg::returns {

using world::Obstacles;

/// Traces aimed beams. Not for several threads at once.
class ReturnTracer {
 public:
  /// Count all returns, to counts (phases,), of zeros.
  void count(const AimedBeams& beams, const Obstacles& obstacles, View<std::int32_t> counts);

  /// Add where all returns come from, in the vehicle's frame, to points of each phase.
  void collect(const AimedBeams& beams, const Obstacles& obstacles, View<std::vector<Vec3>> points);

  /// Between how many returns each phase has.
  struct Bounds {
    std::int32_t least;
    std::int32_t most;
    bool exact;  // all are counted
  };

  /// The same, until it is known that each phase has at least `enough`, or that none has `wanted`.
  Bounds count_until(const AimedBeams& beams, const Obstacles& obstacles, std::int32_t enough, std::int32_t wanted,
                     View<std::int32_t> counts);

 private:
  static constexpr int capacity = 2 * world::packet_size;

  struct Beam {
    std::int32_t firing;
    std::int32_t head;
  };

  void begin();
  int take(const AimedBeams& beams);
  void trace(const AimedBeams& beams, int count, const Obstacles& obstacles);
  void keep_hit(const AimedBeams& beams, const Beam& beam, const Vec3& origin, const Vec3& direction, double range,
                const Obstacles& obstacles);
  template <class OnReturn>
  void trace_all(const AimedBeams& beams, const Obstacles& obstacles, OnReturn on_return);
  template <class OnReturn>
  void settle(const Obstacles& obstacles, OnReturn on_return);

  // Of the beams, the next one.
  Index next_ = 0;          // of which heads
  std::int32_t taken_ = 0;  // how many of these are before it

  world::Packet packet_;
  Beam beams_[world::packet_size];
  double origins_[3 * world::packet_size];  // of rays, in the object's frame
  double directions_[3 * world::packet_size];

  // Hits that are still to be asked what stands before them.
  double starts_[3 * capacity];  // where their beams start, relative to the obstacles' origin
  double ways_[3 * capacity];    // to where they are
  int phase_[capacity];
  int waiting_ = 0;

  std::vector<std::int32_t> open_;  // (phases,) beams that are not traced yet
};

/// Write the returns at places to counts (places, sensors, phases), of zeros.
///
/// @param which  the places to be counted
void count_returns(View<const Place> places, View<const std::int64_t> which, View<const Scanner* const> scanners,
                   View<const SensorPose> poses, const TargetShape& target, const Obstacles& obstacles,
                   const Tables<std::int32_t>& counts);

/// The probability of `enough` returns in all, where each sensor is in any of its phases, whatever the others'.
class DetectionProbability {
 public:
  explicit DetectionProbability(Index enough) : chance_(enough + 1) {}

  Index enough() const { return std::ssize(chance_) - 1; }

  /// Of sensors' returns, by phase.
  double of(View<const View<const std::int32_t>> counts);

 private:
  std::vector<double> chance_;  // of exactly so many returns; the last: of so many or more
};

/// (P,) that probability of counts (P, sensors, phases), of which each sensor has some phases.
std::vector<double> detection_probabilities(const Tables<const std::int32_t>& counts, View<const std::int64_t> phases,
                                            Index enough);

}  // namespace lidarcfg::returns
