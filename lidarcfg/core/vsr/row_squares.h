/// The centres of a row of cuboids against a LiDAR's cones.
#pragma once

#include "vsr/cones.h"
#include "vsr/grid.h"
#include "simd.h"

namespace lidarcfg::vsr {

/// What the signed squares of 64 centres along x have in common, whatever their y and z.
///
/// Here and in RowSquares they are in the order of `simd::mask_place`.
struct XTerms {
  XTerms() = default;

  /// @param x  (64,)
  XTerms(const Cones& lidar, const double* x) {
    for (int i = 0; i < row_size; ++i) {
      const int place = i / simd::mask_block * simd::mask_block + simd::mask_place(i % simd::mask_block);
      const double dx = x[i] - lidar.position[0];
      height[place] = dx * lidar.axis[0];
      distance[place] = dx * dx;
    }
  }

  alignas(64) double height[row_size];
  alignas(64) double distance[row_size];
};

/// The signed squares of the 64 centres of a row: those of `signed_squares`, operation by operation.
class RowSquares {
 public:
  RowSquares(const Cones& lidar, const XTerms& terms, double y, double z) {
    const double dy = y - lidar.position[1];
    const double dz = z - lidar.position[2];
    const double height_y = dy * lidar.axis[1];
    const double height_z = dz * lidar.axis[2];
    const double distance_y = dy * dy;
    const double distance_z = dz * dz;
    for (int i = 0; i < row_size; ++i) {
      const double height = (terms.height[i] + height_y) + height_z;
      height_[i] = height * std::abs(height);
      distance_[i] = (terms.distance[i] + distance_y) + distance_z;
    }
  }

  /// The centres at or above each of two beams of a given u: both at once take little longer than one.
  std::array<Word, 2> at_or_above(double one, double other) const {
    using simd::Doubles;
    constexpr int lanes = simd::lanes<double>;
    std::array<Word, 2> out{};
    for (int block = 0; block < row_size; block += simd::mask_block) {
      simd::Vector<int> halves[2][4];
      for (int n = 0; n < 4; ++n) {
        const int at = block + 2 * n * lanes;
        const auto height = simd::load<Doubles>(height_ + at);
        const auto distance = simd::load<Doubles>(distance_ + at);
        const auto next_height = simd::load<Doubles>(height_ + at + lanes);
        const auto next_distance = simd::load<Doubles>(distance_ + at + lanes);
        halves[0][n] = simd::high_halves(height >= one * distance, next_height >= one * next_distance);
        halves[1][n] = simd::high_halves(height >= other * distance, next_height >= other * next_distance);
      }
      for (int beam = 0; beam < 2; ++beam) {
        const auto& [a, b, c, d] = halves[beam];
        out[beam] |= simd::block_bits(a, b, c, d) << block;
      }
    }
    return out;
  }

 private:
  alignas(64) double height_[row_size];
  alignas(64) double distance_[row_size];
};

}  // namespace lidarcfg::vsr
