/// Returns that are close together: what a perception stack takes for one object.
#pragma once

#include <vector>

#include "returns/counts.h"

namespace lidarcfg::returns {

/// What makes a cluster an object.
struct ClusterRule {
  double tolerance_m;  // between neighbours, at most
  double above_m;      // height that at least one of its points has
};

/// The number of points of the largest cluster that is an object; single linkage.
class Clusters {
 public:
  explicit Clusters(const ClusterRule& rule) : rule_(rule) {}

  void clear() { points_.clear(); }
  void add(View<const Vec3> points) { points_.insert(points_.end(), points.begin(), points.end()); }
  std::int32_t largest();

 private:
  std::int32_t root(std::int32_t point);

  ClusterRule rule_;
  std::vector<Vec3> points_;
  std::vector<std::int32_t> parent_;
  std::vector<std::int32_t> size_;
  std::vector<char> high_;
};

/// What fails, and what is asked for.
struct ClusterCase {
  Index lost;        // sensors that fail
  Index sensors;     // so many have the cluster, each alone; 0: all together
  bool joint;        // all combinations of the sensors' phases, not each sensor's lowest
  std::int32_t cap;  // more points are not told apart, where it is cheaper
};

/// Write the points of the largest cluster (places,) in the worst case of failure and in the worst phases, and these
/// phases (places, sensors): -1 for a sensor that fails.
void count_clusters(View<const Place> places, View<const std::int64_t> which, View<const Scanner* const> scanners,
                    View<const SensorPose> poses, const TargetShape& target, const Obstacles& obstacles,
                    const ClusterRule& rule, const ClusterCase& wanted, View<std::int32_t> counts,
                    Rows<std::int8_t> phases);

}  // namespace lidarcfg::returns
