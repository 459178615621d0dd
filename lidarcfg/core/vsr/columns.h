/// Loops over upright columns of cuboids, by runs of one subspace.
///
/// A label (nx, ny, nz) is the number of a cuboid's subspace, or -1 where the cuboid is excluded. A label that is
/// neither is refused by std::invalid_argument.
#pragma once

#include "views.h"

namespace lidarcfg::vsr {

using Labels = Tables<const std::int32_t>;
using Lines = Tables<std::int32_t>;

/// A box of cuboids: from and to along x, y and z.
using CellRange = Rows<const std::int64_t>;

/// Mark the subspaces that have a cuboid in a box; the last entry of `found` is for excluded ones.
void mark_subspaces(const Labels& label, const CellRange& cells, View<bool> found);

/// Write how many cuboids of n subspaces lie on the lines along x (n, ny, nz), y (n, nx, nz) and z (n, nx, ny).
///
/// row_of: by the number of a subspace its row in these, or -1; the last entry is for excluded cuboids.
void count_lines(const Labels& label, View<const std::int64_t> row_of, const Lines& x, const Lines& y, const Lines& z);

/// The least and the greatest beam gap of each LiDAR on lines of cuboids: (lidars, a, b) each.
struct Span {
  Lines low;
  Lines high;
};

/// Widen the spans of the lines along x, y and z by the gaps (n, lidars) of what lies on them, but blind ones.
///
/// A cuboid of the same subspace as the one before it on a line has nothing to add to the line.
void widen_spans(const Labels& label, Rows<const std::int64_t> gap, std::int64_t blind, const Span& x, const Span& y,
                 const Span& z);

}  // namespace lidarcfg::vsr
