/// The centres of a row of cuboids against a LiDAR's cones.
#pragma once

#include "placement/cones.h"
#include "placement/grid.h"
#include "simd.h"

namespace lidarcfg::placement {

/// The signed squares of the 64 centres of a row.
class RowSquares {
 public:
  /// @param x  (64,)
  RowSquares(const Cones& lidar, const double* x, double y, double z) {
    const double dy = y - lidar.position[1];
    const double dz = z - lidar.position[2];
    for (int i = 0; i < row_size; ++i) {
      const SignedSquares squares = signed_squares(x[i] - lidar.position[0], dy, dz, lidar.axis);
      height_[i] = squares.height;
      distance_[i] = squares.distance;
    }
  }

  /// The centres at or above a beam of a given u.
  Word at_or_above(double beam) const {
    simd::Words found{};
    for (int i = 0; i < row_size; i += simd::lanes<double>) {
      const auto above = simd::load<simd::Doubles>(height_ + i) >= beam * simd::load<simd::Doubles>(distance_ + i);
      found |= reinterpret_cast<simd::Words>(above) & simd::load<simd::Words>(bits_.data() + i);
    }
    Word word = 0;
    for (int lane = 0; lane < simd::lanes<Word>; ++lane) {
      word |= found[lane];
    }
    return word;
  }

 private:
  static constexpr std::array<Word, row_size> bits_ = [] {
    std::array<Word, row_size> out{};
    for (int i = 0; i < row_size; ++i) {
      out[i] = bit(i);
    }
    return out;
  }();

  alignas(64) double height_[row_size];
  alignas(64) double distance_[row_size];
};

}  // namespace lidarcfg::placement
