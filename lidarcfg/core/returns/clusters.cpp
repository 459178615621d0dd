#include "returns/clusters.h"

#include <algorithm>
#include <memory>
#include <numeric>

namespace lidarcfg::returns {
namespace {

/// The returns of all sensors at a place, by phase.
class Found {
 public:
  Found(const ClusterRule& rule, const ClusterCase& wanted, View<const Scanner* const> scanners)
      : clusters_(rule), wanted_(wanted), points_(scanners.size()), alone_(scanners.size()), lowest_(scanners.size()) {
    for (std::size_t s = 0; s < points_.size(); ++s) {
      points_[s].resize(scanners[s]->phases());
    }
  }

  View<std::vector<Vec3>> points(Index sensor) {
    for (std::vector<Vec3>& one : points_[sensor]) {
      one.clear();
    }
    return points_[sensor];
  }

  std::int32_t worst(View<std::int8_t> phases) {
    const auto sensors = static_cast<Index>(points_.size());
    for (Index s = 0; s < sensors; ++s) {
      find_alone(s);
    }
    std::vector<Index> order(sensors);
    std::iota(order.begin(), order.end(), Index{0});
    std::stable_sort(order.begin(), order.end(), [&](Index one, Index other) { return alone_[one] > alone_[other]; });
    const Index rank = wanted_.lost + std::max<Index>(wanted_.sensors, 1) - 1;
    const std::int32_t bound = rank < sensors ? alone_[order[rank]] : 0;
    if (wanted_.sensors > 0 || bound >= wanted_.cap) {
      for (Index n = 0; n < sensors; ++n) {
        phases[order[n]] = static_cast<std::int8_t>(n < wanted_.lost ? -1 : lowest_[order[n]]);
      }
      return bound;
    }
    return worst_together(phases);
  }

 private:
  /// The worst phase of a sensor alone: of the smallest cluster if phases are combined, else of the fewest returns.
  void find_alone(Index sensor) {
    for (std::size_t phase = 0; phase < points_[sensor].size(); ++phase) {
      clusters_.clear();
      clusters_.add(points_[sensor][phase]);
      const std::int32_t size = clusters_.largest();
      if (phase == 0 || size < alone_[sensor]) {
        alone_[sensor] = size;
        lowest_[sensor] = static_cast<int>(phase);
      }
    }
  }

  std::int32_t worst_together(View<std::int8_t> phases) {
    const auto sensors = static_cast<Index>(points_.size());
    std::vector<char> kept(sensors, 1);
    std::fill(kept.begin(), kept.begin() + wanted_.lost, 0);
    std::int32_t least = -1;
    std::vector<int> phase(sensors);
    do {
      for (Index s = 0; s < sensors; ++s) {
        phase[s] = wanted_.joint ? 0 : fewest(s);
      }
      do {
        clusters_.clear();
        for (Index s = 0; s < sensors; ++s) {
          if (kept[s]) {
            clusters_.add(points_[s][phase[s]]);
          }
        }
        const std::int32_t size = clusters_.largest();
        if (least < 0 || size < least) {
          least = size;
          for (Index s = 0; s < sensors; ++s) {
            phases[s] = static_cast<std::int8_t>(kept[s] ? phase[s] : -1);
          }
        }
      } while (wanted_.joint && next(kept, phase));
    } while (std::next_permutation(kept.begin(), kept.end()));
    return least;
  }

  /// The next combination of the phases of the sensors that are left.
  bool next(const std::vector<char>& kept, std::vector<int>& phase) const {
    for (std::size_t s = 0; s < phase.size(); ++s) {
      if (kept[s]) {
        if (++phase[s] < static_cast<int>(points_[s].size())) {
          return true;
        }
        phase[s] = 0;
      }
    }
    return false;
  }

  int fewest(Index sensor) const {
    const auto& points = points_[sensor];
    return static_cast<int>(
        std::min_element(points.begin(), points.end(),
                         [](const auto& one, const auto& other) { return one.size() < other.size(); }) -
        points.begin());
  }

  Clusters clusters_;
  ClusterCase wanted_;
  std::vector<std::vector<std::vector<Vec3>>> points_;
  std::vector<std::int32_t> alone_;
  std::vector<int> lowest_;
};

}  // namespace

std::int32_t Clusters::root(std::int32_t point) {
  while (parent_[point] != point) {
    parent_[point] = parent_[parent_[point]];
    point = parent_[point];
  }
  return point;
}

std::int32_t Clusters::largest() {
  const auto count = static_cast<std::int32_t>(points_.size());
  std::sort(points_.begin(), points_.end());
  parent_.resize(count);
  std::iota(parent_.begin(), parent_.end(), 0);
  const double most = rule_.tolerance_m * rule_.tolerance_m;
  for (std::int32_t i = 0; i < count; ++i) {
    for (std::int32_t j = i + 1; j < count && points_[j][0] - points_[i][0] <= rule_.tolerance_m; ++j) {
      const double x = points_[j][0] - points_[i][0];
      const double y = points_[j][1] - points_[i][1];
      const double z = points_[j][2] - points_[i][2];
      if (x * x + y * y + z * z <= most) {
        const std::int32_t one = root(i);
        const std::int32_t other = root(j);
        parent_[std::max(one, other)] = std::min(one, other);
      }
    }
  }
  size_.assign(count, 0);
  high_.assign(count, 0);
  std::int32_t largest = 0;
  for (std::int32_t i = 0; i < count; ++i) {
    const std::int32_t of = root(i);
    ++size_[of];
    high_[of] |= points_[i][2] >= rule_.above_m;
  }
  for (std::int32_t i = 0; i < count; ++i) {
    largest = std::max(largest, high_[i] ? size_[i] : 0);
  }
  return largest;
}

void count_clusters(View<const Place> places, View<const std::int64_t> which, View<const Scanner* const> scanners,
                    View<const SensorPose> poses, const TargetShape& target, const Obstacles& obstacles,
                    const ClusterRule& rule, const ClusterCase& wanted, View<std::int32_t> counts,
                    Rows<std::int8_t> phases) {
  const auto tracer = std::make_unique<ReturnTracer>();
  AimedBeams beams;
  Found found(rule, wanted, scanners);
  for (const std::int64_t place : which) {
    for (Index s = 0; s < std::ssize(scanners); ++s) {
      beams.aim(*scanners[s], poses[s], target, places[place]);
      tracer->collect(beams, obstacles, found.points(s));
    }
    counts[place] = found.worst(phases[place]);
  }
}

}  // namespace lidarcfg::returns
