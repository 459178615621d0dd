#include "vsr/visibility.h"

#include <algorithm>

#include "simd.h"

namespace lidarcfg::vsr {
namespace {

using simd::Doubles;

constexpr Word all = ~Word{0};
constexpr int row_size = 64;

/// The bits of the centres of a row of which `test` is true, asked of their x.
template <class Test>
Word select(const double* x, Test test) {
  Word word = 0;
  for (int n = 0; n < row_size; n += simd::lanes<double>) {
    word |= Word{simd::bits(test(simd::load<Doubles>(x + n)))} << n;
  }
  return word;
}

/// The centres of a row within a LiDAR's range, and not across the ground.
Word in_range(const Centres& centres, View<const double> cone, View<const double> limits, double ground_m) {
  const double least = limits[0];
  const double most = limits[1];
  const double dy = centres.y - cone[1];
  const double dz = centres.z - cone[2];
  if (std::min(centres.z, cone[2]) < ground_m && ground_m < std::max(centres.z, cone[2])) {
    return 0;
  }
  const double start = centres.x[0] - cone[0];
  const double end = centres.x[row_size - 1] - cone[0];
  if (dy * dy + dz * dz >= least && (std::max(start * start, end * end) + dy * dy) + dz * dz <= most) {
    return all;  // rounding is monotonic, so the ends speak for what is between
  }
  return select(centres.x, [&](auto x) {
    const auto dx = x - cone[0];
    const auto square = (dx * dx + dy * dy) + dz * dz;
    return (square >= least) & (square <= most);
  });
}

Vec3 relative(View<const double> cone, const Vec3& origin_m) {
  return {cone[0] - origin_m[0], cone[1] - origin_m[1], cone[2] - origin_m[2]};
}

}  // namespace

Word in_field(const Centres& centres, View<const double> cone, View<const double> limits) {
  const double kind = limits[8];
  if (kind == static_cast<double>(FieldOfView::any)) {
    return all;
  }
  const double dy = centres.y - cone[1];
  const double dz = centres.z - cone[2];
  const auto beside = [&](auto x, Index plane) {
    return ((x - cone[0]) * limits[plane] + dy * limits[plane + 1]) + dz * limits[plane + 2] >= 0.0;
  };
  if (kind == static_cast<double>(FieldOfView::within)) {
    return select(centres.x, [&](auto x) { return beside(x, 2) & beside(x, 5); });
  }
  return select(centres.x, [&](auto x) { return beside(x, 2) | beside(x, 5); });
}

VisibilityCache::VisibilityCache(Index lidars, Index rows)
    : lidars_(lidars), rows_(rows), clear_(lidars * rows), known_(lidars * rows) {}

void VisibilityCache::reset(Index lidar) {
  std::fill_n(clear_.begin() + lidar * rows_, rows_, Word{0});
  std::fill_n(known_.begin() + lidar * rows_, rows_, Word{0});
}

void VisibilityCache::restore(Index lidar, View<const Word> clear) {
  std::copy(clear.begin(), clear.end(), clear_.begin() + lidar * rows_);
  std::fill_n(known_.begin() + lidar * rows_, rows_, all);
}

void VisibilityCache::start(Index lidar, Rows<const double> cones, const Obstacles& obstacles) {
  shadows_.start(relative(cones[lidar], obstacles.origin_m));
}

void VisibilityCache::update(Index lidar, Index row, const Centres& centres, Word wanted, Rows<const double> cones,
                             const Sight& sight) {
  Word& known = known_[lidar * rows_ + row];
  const Word need = wanted & ~known;
  if (need == 0) {
    return;
  }
  const Obstacles& obstacles = sight.obstacles;
  const View<const double> cone = cones[lidar];
  Word word = need & in_range(centres, cone, sight.limits[lidar], obstacles.ground_m);
  clear_[lidar * rows_ + row] |= word;
  known |= need;
  if (word != 0 && obstacles.boxes.columns() > 0) {
    const Vec3& origin = obstacles.origin_m;
    const world::TargetRow targets{centres.x, origin[0], centres.y - origin[1], centres.z - origin[2], centres.edge_m};
    word &= world::behind_boxes(obstacles.boxes, relative(cone, origin), targets);
    if (word != 0) {
      shadows_.apply(*obstacles.tree, targets, word, row, row_words(lidar));
    }
  }
}

void VisibilityCache::flush(Index lidar, const Sight& sight) {
  shadows_.flush(*sight.obstacles.tree, row_words(lidar));
}

Word VisibilityCache::seen_of_row(Index lidar, Index row, const Centres& centres, Word wanted, Rows<const double> cones,
                                  const Sight& sight) {
  if ((wanted & ~known_[lidar * rows_ + row]) != 0) {
    start(lidar, cones, sight.obstacles);
    update(lidar, row, centres, wanted, cones, sight);
    flush(lidar, sight);
  }
  return wanted & clear_[lidar * rows_ + row] & in_field(centres, cones[lidar], sight.limits[lidar]);
}

}  // namespace lidarcfg::vsr
