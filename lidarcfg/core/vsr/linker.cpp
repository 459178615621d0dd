#include "vsr/linker.h"

#include <algorithm>

namespace lidarcfg::vsr {
namespace {

/// Write which centres of a row lie at or above each beam, of which there are an even number.
///
/// Only beams that pass between the centres need a comparison, and those lie next to one another: the search for them
/// starts at `guess`, an even one. Returns where it may start for the next row.
Index compare_row(const RowSquares& squares, View<const double> beams, Index guess, View<Word> beyond) {
  const auto compare = [&](Index beam) {
    const auto [one, other] = squares.at_or_above(beams[beam], beams[beam + 1]);
    beyond[beam] = one;
    beyond[beam + 1] = other;
  };
  Index low = guess;  // what is below it is not compared
  Index high = guess + 2;
  compare(guess);
  while (low > 0 && beyond[low] != all_bits) {
    compare(low -= 2);
  }
  while (high < std::ssize(beams) && beyond[high - 1] != 0) {
    compare(high);
    high += 2;
  }
  std::fill(beyond.begin(), beyond.begin() + low, all_bits);
  std::fill(beyond.begin() + high, beyond.end(), Word{0});
  return (low + high) / 4 * 2;
}

/// What differs between each cuboid of a row and the one before it along x.
Word differs_along_x(Word row, Word before) { return row ^ (row << 1 | before >> (row_size - 1)); }

}  // namespace

void Linker::compare_layer(const Cones& lidar, View<const Word> seen, Index layer, View<Word> beyond) {
  const Index beams = std::ssize(beams_);
  const Index step_y = grid_.step_y();
  const Index first = (layer + 1) * grid_.step_z();
  if (beams == 0) {
    return;
  }
  for (Index j = 0; j < std::ssize(grid_.y); ++j) {
    for (Index chunk = 0; chunk < step_y; ++chunk) {
      const Index at = (j + 1) * step_y + chunk;
      if (!grid_.included[first + at]) {
        continue;
      }
      const RowSquares squares(lidar, terms_[chunk], grid_.y[j], grid_.z[layer]);
      const View<Word> words = beyond.subspan(at * beams, beams);
      guess_ = compare_row(squares, beams_, guess_, words);
      if (!seen.empty()) {
        for (Word& word : words) {
          word &= seen[first + at];
        }
      }
    }
  }
}

void Linker::cut_layer(Index beams, View<const Word> seen, Index layer, View<const Word> here, View<const Word> below,
                       View<Links> links) const {
  const Index step_y = grid_.step_y();
  const Index step_z = grid_.step_z();
  for (Index at = step_y; at < step_z - step_y; ++at) {
    const Index row = (layer + 1) * step_z + at;
    if (!grid_.included[row]) {
      continue;
    }
    const Word* const words = here.data() + at * beams;
    const Word* const words_x = words - beams;
    const Word* const words_y = words - step_y * beams;
    const Word* const words_z = below.data() + at * beams;
    Links differs;  // on another side of some beam
    for (Index beam = 0; beam < beams; ++beam) {
      differs.x |= differs_along_x(words[beam], words_x[beam]);
      differs.y |= words[beam] ^ words_y[beam];
      differs.z |= words[beam] ^ words_z[beam];
    }
    if (!seen.empty()) {
      differs.x |= differs_along_x(seen[row], seen[row - 1]);
      differs.y |= seen[row] ^ seen[row - step_y];
      differs.z |= seen[row] ^ seen[row - step_z];
    }
    links[row] &= {~differs.x, ~differs.y, ~differs.z};
  }
}

void Linker::cut(const Cones& lidar, View<const Word> seen, View<Links> links) {
  const Index beams = std::ssize(lidar.beams) + std::ssize(lidar.beams) % 2;
  const Index layer_size = grid_.step_z() * beams;
  beyond_.resize(2 * layer_size);
  beams_.assign(lidar.beams.begin(), lidar.beams.end());
  beams_.resize(beams, beams ? lidar.beams.back() : 0.0);
  terms_.clear();
  for (Index chunk = 0; chunk < grid_.step_y(); ++chunk) {
    terms_.emplace_back(lidar, &grid_.x[chunk * row_size]);
  }
  guess_ = std::min(guess_, std::max<Index>(beams - 2, 0));
  View<Word> here(beyond_.data(), layer_size);
  View<Word> below(beyond_.data() + layer_size, layer_size);
  for (Index layer = 0; layer < std::ssize(grid_.z); ++layer) {
    compare_layer(lidar, seen, layer, here);
    cut_layer(beams, seen, layer, here, below, links);
    std::swap(here, below);
  }
}

}  // namespace lidarcfg::vsr
