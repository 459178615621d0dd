#include "vsr/columns.h"

#include <algorithm>
#include <stdexcept>

namespace lidarcfg::vsr {
namespace {

/// The first cuboid up a column from k that is not of the same subspace.
Index run_end(View<const std::int32_t> column, Index k) {
  const std::int32_t one = column[k];
  const Index size = std::ssize(column);
  while (k < size && column[k] == one) {
    ++k;
  }
  return k;
}

/// The place of a subspace in an array of `subspaces` and a last one for excluded cuboids.
Index entry(std::int32_t label, Index subspaces) {
  if (label < -1 || label >= subspaces) {
    throw std::invalid_argument("label: neither -1 nor the number of a subspace");
  }
  return label < 0 ? subspaces : label;
}

/// Widen one line of each LiDAR by the gaps of a subspace.
void widen_line(View<const std::int64_t> gap, std::int64_t blind, const Span& span, Index a, Index b) {
  for (Index lidar = 0; lidar < std::ssize(gap); ++lidar) {
    if (gap[lidar] != blind) {
      const auto value = static_cast<std::int32_t>(gap[lidar]);
      std::int32_t& low = span.low(lidar, a, b);
      std::int32_t& high = span.high(lidar, a, b);
      low = std::min(low, value);
      high = std::max(high, value);
    }
  }
}

}  // namespace

void mark_subspaces(const Labels& label, const CellRange& cells, View<bool> found) {
  for (Index i = cells(0, 0); i < cells(0, 1); ++i) {
    for (Index j = cells(1, 0); j < cells(1, 1); ++j) {
      const View<const std::int32_t> column = label[i][j];
      for (Index k = cells(2, 0); k < cells(2, 1); k = run_end(column, k)) {
        found[entry(column[k], std::ssize(found) - 1)] = true;
      }
    }
  }
}

void count_lines(const Labels& label, View<const std::int64_t> row_of, const Lines& x, const Lines& y, const Lines& z) {
  for (const Lines& lines : {x, y, z}) {
    std::fill_n(lines.data(), lines.size(), 0);
  }
  for (Index i = 0; i < label.tables(); ++i) {
    for (Index j = 0; j < label.rows(); ++j) {
      const View<const std::int32_t> column = label[i][j];
      for (Index k = 0; k < label.columns();) {
        const Index end = run_end(column, k);
        const Index row = row_of[entry(column[k], std::ssize(row_of) - 1)];
        if (row >= 0) {
          z(row, i, j) += static_cast<std::int32_t>(end - k);
          for (Index n = k; n < end; ++n) {
            ++x(row, j, n);
            ++y(row, i, n);
          }
        }
        k = end;
      }
    }
  }
}

void widen_spans(const Labels& label, Rows<const std::int64_t> gap, std::int64_t blind, const Span& x, const Span& y,
                 const Span& z) {
  for (Index i = 0; i < label.tables(); ++i) {
    for (Index j = 0; j < label.rows(); ++j) {
      const View<const std::int32_t> column = label[i][j];
      for (Index k = 0; k < label.columns();) {
        const Index end = run_end(column, k);
        const std::int32_t one = column[k];
        if (entry(one, gap.rows()) != gap.rows()) {
          widen_line(gap[one], blind, z, i, j);
          for (Index n = k; n < end; ++n) {
            if (i == 0 || label(i - 1, j, n) != one) {
              widen_line(gap[one], blind, x, j, n);
            }
            if (j == 0 || label(i, j - 1, n) != one) {
              widen_line(gap[one], blind, y, i, n);
            }
          }
        }
        k = end;
      }
    }
  }
}

}  // namespace lidarcfg::vsr
