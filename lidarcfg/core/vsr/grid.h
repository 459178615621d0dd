/// A region as rows of bits, 64 cuboids along x at a time.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <memory>

#include "views.h"

namespace lidarcfg::vsr {

using Word = std::uint64_t;  // a bit for each cuboid of a row
constexpr Word all_bits = ~Word{0};
constexpr int row_size = 64;

/// The word of one cuboid, 0 … 63.
constexpr Word bit(Index cuboid) { return Word{1} << cuboid; }

/// The number of the lowest bit of a word that has one.
constexpr int lowest(Word word) { return std::countr_zero(word); }

/// The links of a row: whether each of its cuboids and the one before it, along x, y and z, are in one subspace.
struct Links {
  Word x = 0;
  Word y = 0;
  Word z = 0;

  Links operator&(const Links& other) const { return {x & other.x, y & other.y, z & other.z}; }
  Links& operator&=(const Links& other) { return *this = *this & other; }
  bool operator==(const Links&) const = default;
};

/// Where a row is.
struct RowPlace {
  Index first;  // of its centres, in Grid::x
  double y, z;
};

/// All that does not depend on the LiDARs. It does not change; copies share its arrays.
///
/// Rows are numbered ((k + 1)(ny + 2) + j + 1) · step_y + chunk, with a margin in which no cuboid counts, so that every
/// neighbour of a cuboid that counts exists. A cuboid's number is its row · 64 + its bit.
class Grid {
 public:
  /// @param x, y, z    centres, at least one along each axis
  /// @param included   (rows,) the cuboids that count, packed along x, with the margin
  /// @param edge       of a cuboid, in metres
  /// @param weight     (levels,) the weights that cuboids have, descending; none: all have 1
  /// @param weighted   (levels, rows) the cuboids of each weight
  ///
  /// Throws std::invalid_argument where shapes differ, or a cuboid of the margin counts.
  Grid(View<const double> x, View<const double> y, View<const double> z, View<const Word> included, const Vec3& edge,
       View<const double> weight, Rows<const Word> weighted);

  View<const double> x;  // the last one is repeated to fill the row
  View<const double> y;
  View<const double> z;
  View<const Word> included;  // (rows,)
  View<const Links> links;    // (rows,) those cuboids whose neighbour before counts, too
  Vec3 edge;
  View<const double> weight;
  Rows<const Word> weighted;

  std::array<Index, 3> shape() const { return {nx_, std::ssize(y), std::ssize(z)}; }
  Index rows() const { return std::ssize(included); }
  Index cuboids() const { return rows() * row_size; }  // numbers of cuboids are below it

  /// From a row to the next along y, and along z.
  Index step_y() const { return std::ssize(x) / row_size; }
  Index step_z() const { return step_y() * (std::ssize(y) + 2); }

  /// The rows that may count: from the first of the first layer to the last of the last.
  Index first_row() const { return step_z(); }
  Index end_row() const { return rows() - step_z(); }

  /// Of a row that has cuboids that count.
  RowPlace place(Index row) const {
    return {row % step_y() * row_size, y[row % step_z() / step_y() - 1], z[row / step_z() - 1]};
  }

 private:
  struct Arrays;

  Index nx_;
  std::shared_ptr<const Arrays> arrays_;
};

}  // namespace lidarcfg::vsr
