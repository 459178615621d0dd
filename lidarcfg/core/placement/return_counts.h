/// Returns from an object: what of a sensor's beams hits it, within range and field of view, before anything else.
#pragma once

#include <limits>

#include "placement/scanner.h"
#include "placement/visibility.h"
#include "world/packet.h"

namespace lidarcfg::placement {

/// Traces aimed beams. Not for several threads at once.
class ReturnTracer {
 public:
  static constexpr std::int32_t all = std::numeric_limits<std::int32_t>::max();

  /// Add returns to counts (phases,), and end once each of them is at least `enough`. Returns whether all are counted.
  bool count(const AimedBeams& beams, const Obstacles& obstacles, std::int32_t enough, View<std::int32_t> counts);

 private:
  static constexpr int capacity = 2 * world::packet_size;

  void trace(const AimedBeams& beams, const AimedBeams::Heads& heads, Index head, int count,
             const Obstacles& obstacles);
  void settle(const Obstacles& obstacles, View<std::int32_t> counts);

  world::Packet packet_;
  double origins_[3 * world::packet_size];  // of rays, in the object's frame
  double directions_[3 * world::packet_size];

  // Hits that are still to be asked what stands before them.
  double starts_[3 * capacity];  // where their beams start, relative to the obstacles' origin
  double ways_[3 * capacity];    // to where they are
  int phase_[capacity];
  int waiting_ = 0;
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

  /// Of sensors' returns, by phase.
  double of(View<const View<const std::int32_t>> counts);

 private:
  std::vector<double> chance_;  // of exactly so many returns; the last: of so many or more
};

/// (P,) that probability of counts (P, sensors, phases), of which each sensor has some phases.
std::vector<double> detection_probabilities(const Tables<const std::int32_t>& counts, View<const std::int64_t> phases,
                                            Index enough);

}  // namespace lidarcfg::placement
