/// Links between neighbouring cuboids.
///
/// Two neighbours lie in one subspace if no cone passes between them, that is if every digit of their base-n labels is
/// the same (Liu, Arief and Zhao 2018, section III-B); a LiDAR that does not see a cuboid has one digit for it,
/// whatever its beams. The links of several LiDARs are those of each, joined by `and`.
#pragma once

#include <vector>

#include "vsr/cones.h"
#include "vsr/grid.h"
#include "vsr/row_squares.h"

namespace lidarcfg::vsr {

/// Computes links, one LiDAR after another.
class Linker {
 public:
  explicit Linker(const Grid& grid) : grid_(grid) {}

  /// Take from links (rows,) those that a cone of a LiDAR passes through, or the border of what it sees.
  ///
  /// @param seen   (rows,) the cuboids that the LiDAR sees; empty: all
  /// @param links  (rows,) Grid::links, or some of these
  void cut(const Cones& lidar, View<const Word> seen, View<Links> links);

 private:
  void compare_layer(const Cones& lidar, View<const Word> seen, Index layer, View<Word> beyond);
  void cut_layer(Index beams, View<const Word> seen, Index layer, View<const Word> here, View<const Word> below,
                 View<Links> links) const;

  Grid grid_;
  std::vector<Word> beyond_;   // (2, rows of a layer, beams) the centres at or above each beam, of two layers
  std::vector<XTerms> terms_;  // (chunks,) of the LiDAR
  std::vector<double> beams_;  // of the LiDAR; the last one twice if their number is odd
  Index guess_ = 0;            // a beam that passes near the last row
};

}  // namespace lidarcfg::vsr
