#include "vsr/evaluator.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "parallel.h"
#include "vsr/seen.h"

namespace lidarcfg::vsr {
namespace {

constexpr double inf = std::numeric_limits<double>::infinity();
constexpr double nan = std::numeric_limits<double>::quiet_NaN();

/// Once floods have compared more than one in so many rows, all are, which costs less than one by one.
constexpr Index lazy = 4;

/// The LiDARs of a row of flags.
std::vector<std::int64_t> numbers(View<const bool> flags) {
  std::vector<std::int64_t> out;
  for (Index n = 0; n < std::ssize(flags); ++n) {
    if (flags[n]) {
      out.push_back(n);
    }
  }
  return out;
}

}  // namespace

TrialEvaluator::TrialEvaluator(const Grid& grid, Rows<const bool> cases, Index certificates)
    : grid_(grid),
      lidars_(cases.columns()),
      linker_(grid),
      flooder_(grid),
      visibility_(0, 0),
      links_(grid.rows()),
      own_(lidars_, std::vector<Links>(grid.rows())),
      left_(cases.rows(), std::vector<Word>(grid.rows())),
      order_(cases.rows()),
      worst_(certificates) {
  for (Index number = 0; number < cases.rows(); ++number) {
    cases_.push_back(numbers(cases[number]));
  }
}

/// Write the cases to `order_`, first those of certificates, as these stand; returns how many these are.
Index TrialEvaluator::order_cases(View<const std::int64_t> certificates) {
  Index count = 0;
  const auto append = [&](Index number) {
    if (std::find(order_.begin(), order_.begin() + count, number) == order_.begin() + count) {
      order_[count++] = number;
    }
  };
  for (const std::int64_t certificate : certificates) {
    if (certificate >= 0) {
      append(certificate / grid_.cuboids());
    }
  }
  const Index known = count;
  for (Index number = 0; number < cases(); ++number) {
    append(number);
  }
  return known;
}

/// Which LiDARs of a case have moved.
View<const std::int64_t> TrialEvaluator::find_moved(const Batch& batch, Index trial, Index only_case) {
  moved_.clear();
  for (const std::int64_t lidar : cases_[only_case]) {
    if (batch.moved(trial, lidar)) {
      moved_.push_back(lidar);
    }
  }
  return moved_;
}

/// Write to `links_` those that all LiDARs of a case have; those that moved count if `with_moved`, by `own_`.
void TrialEvaluator::join_links(const Batch& batch, Index trial, Index only_case, bool with_moved) {
  std::vector<const Links*>& every = joined_;
  every.clear();
  for (const std::int64_t lidar : cases_[only_case]) {
    if (!batch.moved(trial, lidar)) {
      every.push_back(batch.links[batch.source[trial]][lidar].data());
    } else if (with_moved) {
      every.push_back(own_[lidar].data());
    }
  }
  for (Index row = grid_.first_row(); row < grid_.end_row(); ++row) {
    Links links = grid_.links[row];
    for (const Links* const of_one : every) {
      links &= of_one[row];
    }
    links_[row] = links;
  }
}

/// Write the links of a LiDAR, by its number in cones, limits and the visibility cache.
void TrialEvaluator::link(Index lidar, Rows<const double> cones, const Sight& sight, View<Links> links) {
  std::ranges::copy(grid_.links, links.begin());
  View<const Word> seen;
  if (sight.limited()) {
    seen_.resize(grid_.rows());
    find_seen(grid_, lidar, cones, sight, visibility_, seen_);
    seen = seen_;
  }
  linker_.cut(Cones(cones[lidar]), seen, links);
}

/// Compute all links of the LiDARs that moved.
void TrialEvaluator::link_moved(const Batch& batch, Index trial) {
  for (Index lidar = 0; lidar < lidars_; ++lidar) {
    if (batch.moved(trial, lidar)) {
      link(lidar, batch.placed.cones[trial], batch.placed.sight(trial), own_[lidar]);
    }
  }
}

/// Flood the subspaces of a trial's certificates until one refutes it. Where costs are smoothed, several together may.
///
/// All links are computed when that costs less (see `lazy`); not where LiDARs may be blind to cuboids, as rows that no
/// flood gets to would cost most there.
TrialEvaluator::Refutation TrialEvaluator::refute(const Batch& batch, Index trial) {
  Refutation out;
  const double bound = batch.upper_bound[trial];
  const View<const std::int64_t> certificates = batch.certificates[trial];
  const Index known = order_cases(bound < inf ? certificates : View<const std::int64_t>());
  for (Index number = 0; number < known; ++number) {
    const Index only_case = order_[number];
    std::swap(flooder_.left(), left_[only_case]);
    join_links(batch, trial, only_case, out.linked);
    Barriers barriers{links_, batch.placed.cones[trial], {}, batch.placed.sight(trial)};
    if (!out.linked) {
      barriers.moved = find_moved(batch, trial, only_case);
    }
    for (const std::int64_t certificate : certificates) {
      const Index cuboid = certificate - only_case * grid_.cuboids();
      if (cuboid < 0 || cuboid >= grid_.cuboids() || !(flooder_.left()[cuboid / row_size] & bit(cuboid % row_size))) {
        continue;
      }
      if (lazy * out.compared_rows > grid_.rows() && !out.linked && !batch.placed.limited()) {
        out.linked = true;
        out.compared_rows += grid_.step_y() * std::ssize(grid_.y) * std::ssize(grid_.z);
        link_moved(batch, trial);
        join_links(batch, trial, only_case, true);
        barriers.moved = {};
      }
      const Subspace& found = flooder_.flood(barriers, visibility_, cuboid);
      out.compared_rows += flooder_.compared_rows();
      const double value = found.vsr(grid_.edge) * flooder_.weight();
      if (value >= bound || (worst_.insert(value, only_case * grid_.cuboids() + flooder_.inner_cuboid()) &&
                             worst_.reaches(bound, batch.smoothing))) {
        std::swap(flooder_.left(), left_[only_case]);
        out.certificate = certificate;
        return out;
      }
    }
    std::swap(flooder_.left(), left_[only_case]);
  }
  return out;
}

/// Find the worst subspaces of a trial in all cases, or until one is no less than the bound; all links must be known.
///
/// Returns how many cases were evaluated.
Index TrialEvaluator::evaluate(const Batch& batch, Index trial) {
  for (Index number = 0; number < cases(); ++number) {
    const Index only_case = order_[number];
    join_links(batch, trial, only_case, true);
    std::swap(flooder_.left(), left_[only_case]);
    const bool reached = find_worst(grid_, links_, batch.upper_bound[trial], batch.smoothing,
                                    only_case * grid_.cuboids(), flooder_, worst_);
    std::swap(flooder_.left(), left_[only_case]);
    if (reached) {
      return number + 1;
    }
  }
  return cases();
}

/// Write what a source will need that takes the trial's place.
void TrialEvaluator::keep(const Batch& batch, Index trial, const BatchResult& result) {
  std::ranges::copy(worst_.cuboids(), result.certificates[trial].begin());
  Index last = -1;
  for (Index lidar = 0; lidar < lidars_; ++lidar) {
    if (batch.moved(trial, lidar)) {
      last = lidar;
    }
  }
  if (last >= 0 && result.links.rows()) {
    std::ranges::copy(own_[last], result.links[trial].begin());
  }
  if (last >= 0 && result.clear.rows()) {
    std::ranges::copy(visibility_.clear(last), result.clear[trial].begin());
  }
}

Effort TrialEvaluator::evaluate_batch(View<std::int64_t> counter, Index most, const Batch& batch, bool in_full,
                                      const BatchResult& result) {
  Effort effort;
  const bool limited = batch.placed.limited();
  if (limited && visibility_.lidars() != lidars_) {
    visibility_ = VisibilityCache(lidars_, grid_.rows());
  }
  visibility_.take_cast_count();
  for (Index n = 0; n < most; ++n) {
    const Index trial = take(counter, std::ssize(batch.source));
    if (trial < 0) {
      break;
    }
    for (Index lidar = 0; limited && lidar < lidars_; ++lidar) {
      if (batch.moved(trial, lidar) && batch.same_position(trial, lidar)) {
        visibility_.restore(lidar, batch.clear[batch.source[trial]][lidar]);
      } else if (batch.moved(trial, lidar)) {
        visibility_.reset(lidar);
      }
    }
    worst_.clear();
    for (std::vector<Word>& left : left_) {
      std::ranges::copy(grid_.included, left.begin());
    }
    const Refutation refutation = refute(batch, trial);
    result.cost[trial] = inf;
    result.refuted_by[trial] = refutation.certificate;
    if (refutation.certificate >= 0 || !in_full) {
      result.cost[trial] = refutation.certificate >= 0 ? inf : nan;
      effort.compared_rows += refutation.compared_rows;
      continue;
    }
    if (!refutation.linked) {
      link_moved(batch, trial);
    }
    effort.full_cases += evaluate(batch, trial);
    const double cost = worst_.norm(batch.smoothing);
    if (cost < batch.upper_bound[trial]) {
      result.cost[trial] = cost;
      keep(batch, trial, result);
    } else {
      result.refuted_by[trial] = worst_.cuboids()[0];
    }
  }
  effort.cast_segments = visibility_.take_cast_count();
  return effort;
}

void TrialEvaluator::recompute_links(View<std::int64_t> counter, Index most, const Sources& sources) {
  const bool limited = sources.placed.limited();
  if (limited && visibility_.lidars() != lidars_) {
    visibility_ = VisibilityCache(lidars_, grid_.rows());
  }
  for (Index taken = 0; taken < most; ++taken) {
    const Index n = take(counter, std::ssize(sources.row));
    if (n < 0) {
      break;
    }
    const Index row = sources.row[n];
    for (Index lidar = 0; lidar < lidars_; ++lidar) {
      if (!sources.changed(n, lidar)) {
        continue;
      }
      const View<Word> clear = limited ? sources.clear[row][lidar] : View<Word>();
      if (limited && sources.same_position(n, lidar)) {
        visibility_.restore(lidar, clear);
      } else if (limited) {
        visibility_.reset(lidar);
      }
      link(lidar, sources.placed.cones[n], sources.placed.sight(n), sources.links[row][lidar]);
      if (limited) {
        std::ranges::copy(visibility_.clear(lidar), clear.begin());
      }
    }
  }
}

void promote_certificates(Rows<std::int64_t> certificates, View<const std::int64_t> source,
                          View<const std::int64_t> refuted_by) {
  for (Index trial = 0; trial < std::ssize(source); ++trial) {
    if (refuted_by[trial] < 0) {
      continue;
    }
    const View<std::int64_t> row = certificates[source[trial]];
    Index place = 0;
    while (place < std::ssize(row) - 1 && row[place] != refuted_by[trial]) {
      ++place;
    }
    for (; place > 0; --place) {
      row[place] = row[place - 1];
    }
    row[0] = refuted_by[trial];
  }
}

}  // namespace lidarcfg::vsr
