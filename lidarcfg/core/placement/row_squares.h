/// The centres of a row of cuboids against a LiDAR's cones.
#pragma once

#include "placement/cones.h"
#include "placement/grid.h"
#include "simd.h"

namespace lidarcfg::placement {

/// What the signed squares of 64 centres along x have in common, whatever their y and z.
struct XTerms {
  XTerms() = default;

  /// @param x  (64,)
  XTerms(const Cones& lidar, const double* x) {
    for (int i = 0; i < row_size; ++i) {
      const double dx = x[i] - lidar.position[0];
      height[i] = dx * lidar.axis[0];
      distance[i] = dx * dx;
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
