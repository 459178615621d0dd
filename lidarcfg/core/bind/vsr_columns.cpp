#include "bind/arguments.h"
#include "bind/modules.h"
#include "vsr/columns.h"

namespace lidarcfg::bind {

template <>
struct Fields<vsr::Span> {
  using S = vsr::Span;
  static constexpr auto members = fields(field("low", &S::low), field("high", &S::high));
};

namespace {

using vsr::Labels;

/// Raises ValueError unless something of each of `count` has the lines along x, y and z of a grid.
template <class T>
void check_lines(const Labels& label, Index count, const Tables<T>& x, const Tables<T>& y, const Tables<T>& z) {
  require(has_shape(x, count, label.rows(), label.columns()), "x: not the lines along x");
  require(has_shape(y, count, label.tables(), label.columns()), "y: not the lines along y");
  require(has_shape(z, count, label.tables(), label.rows()), "z: not the lines along z");
}

}  // namespace

void bind_vsr_columns(nb::module_& module) {
  record<vsr::Span>(module, "Span", "Least and greatest beam gaps on lines, to be widened.");
  def(
      module, "mark_subspaces",
      [](Labels label, Shaped<Rows<const std::int64_t>, 3, 2> cells, View<bool> found) {
        const Index shape[3] = {label.tables(), label.rows(), label.columns()};
        for (Index axis = 0; axis < 3; ++axis) {
          require(cells(axis, 0) >= 0 && cells(axis, 1) <= shape[axis], "cells: outside label");
        }
        vsr::mark_subspaces(label, cells, found);
      },
      "Mark in found (n + 1,) the subspaces of label (nx, ny, nz) with a cuboid in cells (3, 2); last: excluded ones.",
      "label", "cells", "found");
  def(
      module, "count_lines",
      [](Labels label, View<const std::int64_t> row_of, Tables<std::int32_t> x, Tables<std::int32_t> y,
         Tables<std::int32_t> z) {
        check_lines(label, x.tables(), x, y, z);
        for (const std::int64_t row : row_of) {
          require(row < x.tables(), "row_of: beyond the rows of x");
        }
        vsr::count_lines(label, row_of, x, y, z);
      },
      "Count the cuboids of subspaces on lines: x (n, ny, nz), y (n, nx, nz), z (n, nx, ny); row_of (subspaces + 1,).",
      "label", "row_of", "x", "y", "z");
  def(
      module, "widen_spans",
      [](Labels label, Rows<const std::int64_t> gap, std::int64_t blind, vsr::Span x, vsr::Span y, vsr::Span z) {
        check_lines(label, gap.columns(), x.low, y.low, z.low);
        check_lines(label, gap.columns(), x.high, y.high, z.high);
        vsr::widen_spans(label, gap, blind, x, y, z);
      },
      "Widen the spans of lines along x, y and z by the gaps (n, lidars) of what lies on them, but blind ones.",
      "label", "gap", "blind", "x", "y", "z");
}

}  // namespace lidarcfg::bind
