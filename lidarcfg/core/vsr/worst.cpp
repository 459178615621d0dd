#include "vsr/worst.h"

#include <algorithm>
#include <cmath>

#include "maths.h"

namespace lidarcfg::vsr {
namespace {

constexpr double surely = 1e-9;  // how much larger than a sum another one must be that rounding has no part in it

/// The words of cuboids with at least 0, 1 and 2 of two links.
struct AtLeast {
  AtLeast(Word any, Word one, Word other) : words{any, one | other, one & other} {}
  Word operator[](int count) const { return words[count]; }

  Word words[3];
};

/// Which cuboids may be in a subspace of more than a given V / S.
///
/// There the mean cuboid has less outer surface than its volume by that ratio, so some cuboid has, and so many of its
/// six faces are links.
class Promising {
 public:
  Promising(double least, const Vec3& edge) {
    const auto [ex, ey, ez] = edge;
    const double inner = least > 0.0 ? 2.0 * (ey * ez + ex * ez + ex * ey) * (1.0 - 1e-9) - ex * ey * ez / least : -1.0;
    for (int z = 0; z < 3; ++z) {
      for (int y = 0; y < 3; ++y) {
        int x = 0;
        while (x < 3 && x * (ey * ez) + y * (ex * ez) + z * (ex * ey) < inner) {
          ++x;
        }
        needed_[z][y] = x;
      }
    }
  }

  /// The cuboids of a row with enough links.
  Word operator()(const Grid& grid, View<const Links> links, Index row) const {
    const Word any = grid.included[row];
    const Links& own = links[row];
    const AtLeast along_x(any, own.x, own.x >> 1 | links[row + 1].x << (row_size - 1));
    const AtLeast along_y(any, own.y, links[row + grid.step_y()].y);
    const AtLeast along_z(any, own.z, links[row + grid.step_z()].z);
    Word word = 0;
    for (int z = 0; z < 3; ++z) {
      for (int y = 0; y < 3; ++y) {
        if (needed_[z][y] < 3) {
          word |= along_z[z] & along_y[y] & along_x[needed_[z][y]];
        }
      }
    }
    return word;
  }

 private:
  int needed_[3][3];  // links along x that a cuboid with z and y along those axes needs; 3: none suffice
};

}  // namespace

void WorstList::clear() {
  std::ranges::fill(values_, -1.0);
  std::ranges::fill(cuboids_, -1);
}

bool WorstList::insert(double value, Index cuboid) {
  const Index size = std::ssize(values_);
  Index place = size;
  while (place > 0 && value > values_[place - 1]) {
    --place;
  }
  if (place == size) {
    return false;
  }
  for (Index after = size - 1; after > place; --after) {
    values_[after] = values_[after - 1];
    cuboids_[after] = cuboids_[after - 1];
  }
  values_[place] = value;
  cuboids_[place] = cuboid;
  return true;
}

double WorstList::norm(double smoothing) const {
  const double greatest = values_[0];
  if (smoothing == 0.0 || greatest <= 0.0) {
    return greatest;
  }
  double total = 0.0;
  for (const double value : values_) {
    total += exp(log(std::max(value, 0.0) / greatest) / smoothing);
  }
  return greatest * exp(smoothing * log(total));
}

bool WorstList::reaches(double bound, double smoothing) const {
  return values_[0] >= bound || (smoothing > 0.0 && norm(smoothing) >= bound * (1.0 + surely));
}

bool find_worst(const Grid& grid, View<const Links> links, double bound, double smoothing, Index first,
                Flooder& flooder, WorstList& worst) {
  const double greatest_weight = grid.weight.empty() ? 1.0 : grid.weight.front();
  const std::vector<Word>& left = flooder.left();
  Promising promising(worst.values().back() / greatest_weight, grid.edge);
  for (Index row = grid.first_row(); row < grid.end_row(); ++row) {
    if (!left[row]) {
      continue;
    }
    Word word = promising(grid, links, row) & left[row];
    while (word) {
      const Subspace& found = flooder.flood(links, row * row_size + lowest(word));
      word &= left[row];
      if (worst.insert(found.vsr(grid.edge) * flooder.weight(), first + flooder.inner_cuboid())) {
        if (worst.reaches(bound, smoothing)) {
          return true;
        }
        promising = Promising(worst.values().back() / greatest_weight, grid.edge);
        word &= promising(grid, links, row);
      }
    }
  }
  return false;
}

}  // namespace lidarcfg::vsr
