#include "returns/counts.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "world/ray.h"

namespace lidarcfg::returns {
namespace {

constexpr double beyond_m = 1.0;  // beyond the greatest range nothing is a return; rays are traced this much farther
constexpr int stride = world::packet_size;

std::int32_t least_of(View<const std::int32_t> counts) { return *std::min_element(counts.begin(), counts.end()); }

std::int32_t most_of(View<const std::int32_t> counts) { return *std::max_element(counts.begin(), counts.end()); }

/// Between how many returns each phase has, of which some are counted and others may come from open beams.
ReturnTracer::Bounds bounds_of(View<const std::int32_t> counts, View<const std::int32_t> open) {
  std::int32_t most = 0;
  for (std::size_t n = 0; n < counts.size(); ++n) {
    most = std::max(most, counts[n] + open[n]);
  }
  return {least_of(counts), most, most_of(open) == 0};
}

}  // namespace

/// Have some of the next beams be those that are traced: of one firing, or any of heads that stand still. Returns how
/// many; none: all were.
int ReturnTracer::take(const AimedBeams& beams) {
  if (beams.scanner().stands_still()) {
    const View<const AimedBeams::Heads> left = beams.heads().subspan(next_);
    const std::size_t some = std::min(left.size(), std::size_t{world::packet_size});
    std::ranges::transform(left.first(some), beams_,
                           [](const AimedBeams::Heads& one) { return Beam{one.firing, one.first}; });
    next_ += static_cast<Index>(some);
    return static_cast<int>(some);
  }
  int count = 0;
  while (count < world::packet_size && next_ < std::ssize(beams.heads())) {
    const AimedBeams::Heads& all = beams.heads()[next_];
    if (count > 0 && beams_[0].firing != all.firing) {
      break;
    }
    const std::int32_t first = all.first + taken_;
    const std::int32_t end = std::min(all.end, first + (world::packet_size - count));
    beams.rays({all.firing, first, end}, origins_ + count, directions_ + count, stride);
    for (std::int32_t head = first; head < end; ++head) {
      beams_[count++] = {all.firing, head};
    }
    taken_ += end - first;
    if (end == all.end) {
      ++next_;
      taken_ = 0;
    }
  }
  return count;
}

void ReturnTracer::begin() {
  waiting_ = 0;
  next_ = 0;
  taken_ = 0;
}

/// Call on_return with the number of each waiting hit that is a return.
template <class OnReturn>
void ReturnTracer::trace_all(const AimedBeams& beams, const Obstacles& obstacles, OnReturn on_return) {
  begin();
  while (const int count = take(beams)) {
    trace(beams, count, obstacles);
    if (waiting_ > capacity - world::packet_size) {
      settle(obstacles, on_return);
    }
  }
  settle(obstacles, on_return);
}

void ReturnTracer::count(const AimedBeams& beams, const Obstacles& obstacles, View<std::int32_t> counts) {
  trace_all(beams, obstacles, [&](int n) { ++counts[phase_[n]]; });
}

void ReturnTracer::collect(const AimedBeams& beams, const Obstacles& obstacles, View<std::vector<Vec3>> points) {
  trace_all(beams, obstacles, [&](int n) {
    Vec3 point;
    for (int k = 0; k < 3; ++k) {
      point[k] = obstacles.origin_m[k] + (starts_[k * capacity + n] + ways_[k * capacity + n]);
    }
    points[phase_[n]].push_back(point);
  });
}

ReturnTracer::Bounds ReturnTracer::count_until(const AimedBeams& beams, const Obstacles& obstacles, std::int32_t enough,
                                               std::int32_t wanted, View<std::int32_t> counts) {
  open_.assign(counts.size(), 0);
  for (const AimedBeams::Heads& heads : beams.heads()) {
    add_by_phase(heads, 1, open_);
  }
  begin();
  const int phases = beams.scanner().phases();
  while (const int count = take(beams)) {
    trace(beams, count, obstacles);
    settle(obstacles, [&](int n) { ++counts[phase_[n]]; });
    for (int n = 0; n < count; ++n) {
      --open_[beams_[n].head % phases];
    }
    const Bounds bounds = bounds_of(counts, open_);
    if (bounds.least >= enough || bounds.most < wanted) {
      return bounds;
    }
  }
  return bounds_of(counts, open_);
}

/// Have those of the beams wait that hit the object within range and field of view.
void ReturnTracer::trace(const AimedBeams& beams, int count, const Obstacles& obstacles) {
  const Scanner& scanner = beams.scanner();
  if (scanner.stands_still()) {  // rays are far apart: of packets few rays would hit the same triangle
    for (int n = 0; n < count; ++n) {
      const auto [origin, direction] = beams.still_ray(beams_[n].firing);
      const auto [range, slot] = world::first_hit(beams.target().bvh, origin, direction, scanner.most_m() + beyond_m);
      if (slot >= 0) {
        keep_hit(beams, beams_[n], origin, direction, range, obstacles);
      }
    }
    return;
  }
  const Rows<const double> origins(origins_, 3, stride);
  const Rows<const double> directions(directions_, 3, stride);
  for (int done = 0; done < count;) {
    const auto [some, face] = world::alike(directions, done, count);
    packet_.load(origins, directions, done, some, face);
    packet_.limit(scanner.most_m() + beyond_m);
    packet_.first_hits(beams.target().bvh);
    for (int n = 0; n < some; ++n) {
      if (packet_.slot(n) >= 0) {
        keep_hit(beams, beams_[done + n], packet_.origin(n), packet_.direction(n), packet_.range(n), obstacles);
      }
    }
    done += some;
  }
}

/// Have a beam's hit at a range wait, if that is within range and field of view.
void ReturnTracer::keep_hit(const AimedBeams& beams, const Beam& beam, const Vec3& origin, const Vec3& direction,
                            double range, const Obstacles& obstacles) {
  const Scanner& scanner = beams.scanner();
  if (!(scanner.least_m() <= range && range <= scanner.most_m()) || scanner.is_outside(beam.firing, beam.head)) {
    return;
  }
  const Vec3 start = beams.point_in_vehicle(origin, obstacles.origin_m);
  const Vec3 way = beams.direction_in_vehicle(direction);
  for (int k = 0; k < 3; ++k) {
    starts_[k * capacity + waiting_] = start[k];
    ways_[k * capacity + waiting_] = way[k] * range;
  }
  phase_[waiting_++] = beam.head % scanner.phases();
}

/// Call on_return with those of the hits that wait that nothing stands before.
template <class OnReturn>
void ReturnTracer::settle(const Obstacles& obstacles, OnReturn on_return) {
  const Rows<const double> starts(starts_, 3, capacity);
  const Rows<const double> ways(ways_, 3, capacity);
  const double ground_m = obstacles.ground_m - obstacles.origin_m[2];
  for (int done = 0; done < waiting_;) {
    int some = waiting_ - done;
    const bool blocks = obstacles.tree->size() > 0;
    if (blocks) {
      const world::Alike alike = world::alike(ways, done, waiting_);
      some = alike.count;
      packet_.load(starts, ways, done, some, alike.face);
      packet_.limit(1 - world::ends);
      packet_.any_hits(*obstacles.tree);
    }
    for (int n = 0; n < some; ++n) {
      const double start = starts(2, done + n);
      const double end = start + ways(2, done + n);
      const bool hidden = blocks && packet_.slot(n) >= 0;
      if (!hidden && !(std::min(start, end) < ground_m && ground_m < std::max(start, end))) {
        on_return(done + n);
      }
    }
    done += some;
  }
  waiting_ = 0;
}

void count_returns(View<const Place> places, View<const std::int64_t> which, View<const Scanner* const> scanners,
                   View<const SensorPose> poses, const TargetShape& target, const Obstacles& obstacles,
                   const Tables<std::int32_t>& counts) {
  const auto tracer = std::make_unique<ReturnTracer>();
  AimedBeams beams;
  for (const std::int64_t place : which) {
    for (Index s = 0; s < std::ssize(scanners); ++s) {
      beams.aim(*scanners[s], poses[s], target, places[place]);
      const View<std::int32_t> by_phase = counts[place][s].first(scanners[s]->phases());
      std::ranges::fill(by_phase, 0);
      tracer->count(beams, obstacles, by_phase);
    }
  }
}

double DetectionProbability::of(View<const View<const std::int32_t>> counts) {
  const Index enough = this->enough();
  Index least = 0;
  Index most = 0;
  for (const View<const std::int32_t> by_phase : counts) {
    least += least_of(by_phase);
    most += most_of(by_phase);
  }
  if (least >= enough || most < enough) {
    return least >= enough ? 1.0 : 0.0;
  }
  std::fill(chance_.begin(), chance_.end(), 0.0);
  chance_[0] = 1.0;
  for (const View<const std::int32_t> by_phase : counts) {
    for (Index had = enough - 1; had >= 0; --had) {
      const double part = chance_[had] / static_cast<double>(by_phase.size());
      if (part == 0.0) {
        continue;
      }
      chance_[had] = 0.0;
      for (const std::int32_t more : by_phase) {
        chance_[std::min(had + more, enough)] += part;
      }
    }
  }
  return chance_[enough];
}

std::vector<double> detection_probabilities(const Tables<const std::int32_t>& counts, View<const std::int64_t> phases,
                                            Index enough) {
  DetectionProbability probability(enough);
  std::vector<View<const std::int32_t>> here(phases.size());
  std::vector<double> out;
  for (Index place = 0; place < counts.tables(); ++place) {
    for (std::size_t s = 0; s < phases.size(); ++s) {
      here[s] = counts[place][static_cast<Index>(s)].first(phases[s]);
    }
    out.push_back(probability.of(here));
  }
  return out;
}

}  // namespace lidarcfg::returns
