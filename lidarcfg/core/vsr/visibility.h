/// What LiDARs see of cuboids, 64 along x at a time: by range, by field of view, and by what stands in between.
#pragma once

#include <vector>

#include "views.h"
#include "world/obstacles.h"
#include "world/shadow.h"

namespace lidarcfg::vsr {

using Word = std::uint64_t;  // a bit for each of 64 cuboids along x

constexpr Index limit_columns = 9;

/// What `Sight::limits` says in its last column of a field of view: all around; up to half a turn; more.
enum class FieldOfView { any = 0, within = 1, beyond = 2 };

using world::Obstacles;

/// What LiDARs at known poses may see; no rows of limits: everything.
struct Sight {
  Rows<const double> limits;  // (lidars, 9) least and greatest range, squared; normals of two planes; FieldOfView
  Obstacles obstacles;

  bool limited() const { return limits.rows() > 0; }
};

/// The centres of 64 cuboids along x.
struct Centres {
  const double* x;  // (64,) evenly spaced; the last one may be repeated
  double y, z;
  double edge_m;  // from one to the next along x
};

/// Which centres are within a LiDAR's field of view: its position first in `cone`, its row of Sight::limits.
Word in_field(const Centres& centres, View<const double> cone, View<const double> limits);

/// What is near enough and not hidden from LiDARs, as far as it is known. Not for several threads at once.
///
/// A LiDAR's number is its row in here, in `cones` (lidars, 6 + beams), of which the first three columns are its
/// position, and in Sight::limits. A row's number is anything below `rows` that tells rows apart.
class VisibilityCache {
 public:
  /// Nothing is known yet.
  VisibilityCache(Index lidars, Index rows);

  Index lidars() const { return lidars_; }
  Index rows() const { return rows_; }

  /// Forget what is known of a LiDAR.
  void reset(Index lidar);

  /// Have everything be known of a LiDAR: `clear` (rows,) of one at the same pose.
  void restore(Index lidar, View<const Word> clear);

  /// (rows,) the cuboids that are known to be clear.
  View<const Word> clear(Index lidar) const { return {clear_.data() + lidar * rows_, static_cast<std::size_t>(rows_)}; }

  /// Have segments start at a LiDAR from now on.
  void start(Index lidar, Rows<const double> cones, const Obstacles& obstacles);

  /// Find which of the cuboids `wanted` of a row are clear; after `start`. What segments have to say comes with
  /// `flush`.
  void update(Index lidar, Index row, const Centres& centres, Word wanted, Rows<const double> cones,
              const Sight& sight);

  /// Cast the segments that wait.
  void flush(Index lidar, const Sight& sight);

  /// Which of the cuboids `wanted` of a row a LiDAR sees.
  Word seen_of_row(Index lidar, Index row, const Centres& centres, Word wanted, Rows<const double> cones,
                   const Sight& sight);

  /// How many segments were cast since the last call.
  std::int64_t take_cast_count() { return shadows_.take_cast_count(); }

 private:
  View<Word> row_words(Index lidar) { return {clear_.data() + lidar * rows_, static_cast<std::size_t>(rows_)}; }

  Index lidars_;
  Index rows_;
  std::vector<Word> clear_;  // (lidars, rows)
  std::vector<Word> known_;  // (lidars, rows) the cuboids of which that is known
  world::ShadowCaster shadows_;
};

}  // namespace lidarcfg::vsr
