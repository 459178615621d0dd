#include "vsr/flood.h"

#include <limits>

#include "vsr/row_squares.h"
#include "vsr/seen.h"

namespace lidarcfg::vsr {
namespace {

/// The cuboids of a row that links along x join to some of them.
Word along(Word bits, Word links) {
  const Word start = bits << 1 & links;
  bits |= start | ((links ^ (links + start)) & links);  // upwards: a carry runs to the end of the links
  bits |= (bits & links) >> 1;
  links &= links << 1;
  bits |= (bits & links) >> 2;
  links &= links << 2;
  if (((bits & links) >> 4 & ~bits) == 0) {  // most neighbours' ends are no further apart
    return bits;
  }
  for (int shift = 4; shift < row_size; shift *= 2) {
    bits |= (bits & links) >> shift;
    links &= links << shift;
  }
  return bits;
}

constexpr std::size_t sides = 6;  // of a row

/// The gap between two neighbouring beams of a LiDAR that a cuboid lies in, or that the LiDAR is blind to the cuboid.
struct Gap {
  Gap(Index lidar, const Cones& cones) : lidar(lidar), cones(cones) {}

  Index lidar;
  Cones cones;
  double below = -std::numeric_limits<double>::infinity();  // u of the beam below
  double above = std::numeric_limits<double>::infinity();   // and above
  bool is_seen = true;
  XTerms terms;      // of some centres along x
  Index first = -1;  // of these
};

}  // namespace

double Subspace::vsr(const Vec3& edge) const {
  const auto [ex, ey, ez] = edge;
  const auto [x, y, z] = internal;
  const double volume = cuboids * (ex * ey * ez);
  const double surface = 2.0 * ((cuboids - x) * (ey * ez) + (cuboids - y) * (ex * ez) + (cuboids - z) * (ex * ey));
  return volume / surface;
}

/// The beam gaps of some LiDARs that a cuboid lies in, and which others lie in them.
class Flooder::Gaps {
 public:
  Gaps(const Grid& grid, const Barriers& barriers, VisibilityCache& cache, Index cuboid)
      : grid_(grid), barriers_(barriers), cache_(cache) {
    const Index row = cuboid / row_size;
    const RowPlace place = grid.place(row);
    for (const Index lidar : barriers.moved) {
      const Cones cones(barriers.cones[lidar]);
      const Index count = beam_gap({grid.x[place.first + cuboid % row_size], place.y, place.z}, cones);
      Gap& gap = gaps_.emplace_back(lidar, cones);
      if (count > 0) {
        gap.below = cones.beams[count - 1];
      }
      if (count < std::ssize(cones.beams)) {
        gap.above = cones.beams[count];
      }
      gap.is_seen = !barriers.sight.limited() || seen(lidar, row, bit(cuboid % row_size)) != 0;
    }
  }

  /// The cuboids of a row in the gaps.
  Word inside(Index row) {
    Word word = all_bits;
    const RowPlace place = grid_.place(row);
    for (Gap& gap : gaps_) {
      if (gap.is_seen) {
        if (gap.first != place.first) {
          gap.first = place.first;
          gap.terms = XTerms(gap.cones, &grid_.x[place.first]);
        }
        const RowSquares squares(gap.cones, gap.terms, place.y, place.z);
        const auto [from, until] = squares.at_or_above(gap.below, gap.above);
        word &= from & ~until;
      }
    }
    if (barriers_.sight.limited()) {
      for (const Gap& gap : gaps_) {
        if (word) {
          const Word visible = seen(gap.lidar, row, word);
          word &= gap.is_seen ? visible : ~visible;
        }
      }
    }
    return word;
  }

 private:
  /// Which cuboids of a row, of those wanted, a LiDAR sees.
  Word seen(Index lidar, Index row, Word wanted) const {
    return cache_.seen_of_row(lidar, row, centres_of(grid_, row), wanted & grid_.included[row], barriers_.cones,
                              barriers_.sight);
  }

  const Grid& grid_;
  const Barriers& barriers_;
  VisibilityCache& cache_;
  std::vector<Gap> gaps_;
};

Flooder::Flooder(const Grid& grid)
    : grid_(grid), left_(grid.included.begin(), grid.included.end()), waiting_(row_size), steps_(row_size) {}

template <bool lazily, class Inside>
const Subspace& Flooder::run(View<const Links> links, Index cuboid, Inside inside) {
  const Index step_y = grid_.step_y();
  const Index step_z = grid_.step_z();
  const bool one_word = step_y == 1;
  Word* const left = left_.data();
  Subspace found;
  auto& [across_x, across_y, across_z] = found.internal;
  Index most = 0;
  step_count_ = 0;
  Step next{cuboid / row_size, bit(cuboid % row_size)};  // not in memory: steps wait for one another
  waiting_[0] = {next.row, 0};
  std::size_t waiting = 1;

  /// Go on from some cuboids of a row, if they are left; returns how many of them are joined to those before.
  const auto go_on = [&](Index row, Word bits) {
    if constexpr (lazily) {
      if (!bits) {
        return 0;
      }
      bits &= inside(row);
    }
    const int count = std::popcount(bits);
    bits &= left[row];
    if (bits) {
      waiting_[waiting++] = next;
      next = {row, bits};
    }
    return count;
  };
  while (waiting > 0) {
    const Index row = next.row;
    Word bits = next.bits & left[row];
    next = waiting_[--waiting];
    if (!bits) {
      continue;
    }
    if (waiting + sides > waiting_.size()) {
      waiting_.resize(2 * waiting_.size());
    }
    if (step_count_ == steps_.size()) {
      steps_.resize(2 * steps_.size());
    }
    const Links own = links[row];
    Word within = own.x & ~Word{1};  // the link to the row before is not within
    if constexpr (lazily) {
      const Word word = inside(row);
      within &= word & word << 1;
    }
    bits = along(bits, within);
    left[row] &= ~bits;
    const Index count = std::popcount(bits);
    if (count > most) {
      most = count;
      fullest_ = step_count_;
    }
    steps_[step_count_++] = {row, bits};
    found.cuboids += count;
    across_x += std::popcount(bits & within);

    across_y += go_on(row - step_y, bits & own.y);
    go_on(row + step_y, bits & links[row + step_y].y);
    across_z += go_on(row - step_z, bits & own.z);
    go_on(row + step_z, bits & links[row + step_z].z);
    if (!one_word) {  // along x, where the region is longer than a row
      across_x += go_on(row - 1, (bits & own.x) << (row_size - 1));
      go_on(row + 1, bits >> (row_size - 1) & links[row + 1].x);
    }
  }
  return found_ = found;
}

const Subspace& Flooder::flood(View<const Links> links, Index cuboid) {
  return run<false>(links, cuboid, [](Index) { return all_bits; });
}

const Subspace& Flooder::flood(const Barriers& barriers, VisibilityCache& cache, Index cuboid) {
  compared_rows_ = 0;
  if (barriers.moved.empty()) {
    return flood(barriers.links, cuboid);
  }
  known_.resize(grid_.rows());
  inside_.resize(grid_.rows());
  ++stamp_;
  Gaps gaps(grid_, barriers, cache, cuboid);
  return run<true>(barriers.links, cuboid, [&](Index row) {
    if (known_[row] != stamp_) {
      known_[row] = stamp_;
      inside_[row] = gaps.inside(row);
      ++compared_rows_;
    }
    return inside_[row];
  });
}

Index Flooder::inner_cuboid() const {
  auto [row, bits] = steps_[fullest_];
  for (int n = std::popcount(bits) / 2; n > 0; --n) {
    bits &= bits - 1;
  }
  return row * row_size + lowest(bits);
}

double Flooder::weight() const {
  if (grid_.weight.empty()) {
    return 1.0;
  }
  for (Index level = 0; level < std::ssize(grid_.weight) - 1; ++level) {
    for (const auto& [row, bits] : steps()) {
      if (bits & grid_.weighted(level, row)) {
        return grid_.weight[level];
      }
    }
  }
  return grid_.weight.back();
}

}  // namespace lidarcfg::vsr
