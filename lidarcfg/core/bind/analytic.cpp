#include "placement/analytic.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "bind/arguments.h"
#include "bind/modules.h"
#include "placement/boundaries.h"
#include "placement/cones.h"
#include "placement/detection.h"
#include "placement/spheres.h"

namespace lidarcfg::bind {

using namespace placement;

template <>
struct Fields<Lattice> {
  static constexpr auto members = fields(field("axis", &Lattice::axis), field("low", &Lattice::low),
                                         field("edge", &Lattice::edge), field("shape", &Lattice::shape));
};

template <>
struct Fields<LineCrossings> {
  using C = LineCrossings;
  static constexpr auto members = fields(field("first", &C::first), field("at", &C::at), field("weight", &C::weight));
};

template <>
struct Fields<Bounds> {
  static constexpr auto members =
      fields(field("foot", &Bounds::foot), field("edges", &Bounds::edges), field("quadrics", &Bounds::quadrics),
             field("first", &Bounds::first), field("item", &Bounds::item));
};

template <>
struct Fields<Sheaf> {
  static constexpr auto members =
      fields(field("axis", &Sheaf::axis), field("label", &Sheaf::label), field("within", &Sheaf::within),
             field("low", &Sheaf::low), field("edge", &Sheaf::edge), field("cones", &Sheaf::cones));
};

template <>
struct Fields<Flips> {
  static constexpr auto members = fields(field("start", &Flips::start), field("first", &Flips::first),
                                         field("at", &Flips::at), field("weight", &Flips::weight));
};

template <>
struct Fields<Sums> {
  static constexpr auto members = fields(field("volume", &Sums::volume), field("shadow", &Sums::shadow),
                                         field("surface", &Sums::surface), field("parent", &Sums::parent));
};

namespace {

using Labels = Tables<const std::int32_t>;
using Triple = std::array<Index, 3>;

constexpr Index count_max = Index{1} << 31;  // of lines, of cuboids along an axis: so that no product overflows

bool is_within(Index value, Index least, Index most) { return least <= value && value <= most; }

bool is_finite(const Vec3& vector) {
  return std::isfinite(vector[0]) && std::isfinite(vector[1]) && std::isfinite(vector[2]);
}

void check_edge(Vec3 edge, const char* message) {
  for (const double one : edge) {
    require(1e-9 <= one && one <= 1e9, message);
  }
}

/// Whether all are from `least` to before `end`.
template <class T>
bool are_within(const T* values, Index count, Index least, Index end) {
  const auto [low, high] = std::minmax_element(values, values + count);
  return count == 0 || (least <= *low && *high < end);
}

bool are_labels(Labels label, Index subspaces) { return are_within(label.data(), label.size(), -1, subspaces); }

/// Whether these are the first of so many items for each of `count`, and where they end.
bool are_first(View<const std::int64_t> first, Index count, Index items) {
  return std::ssize(first) == count + 1 && std::ranges::is_sorted(first) && first.front() == 0 && first.back() == items;
}

Triple shape_of(Labels label) { return {label.tables(), label.rows(), label.columns()}; }

void check_nodes(Labels label, Tables<const Word> ends, const Vec3& half) {
  check_edge(half, "half: not from 1e-9 to 1e9 m");
  const Index words = (label.columns() + 63) / 64;
  require(ends.tables() == label.tables() && ends.rows() == label.rows() && ends.columns() == words,
          "ends: a word for 64 labels");
  require(label.size() > 0, "label: empty");
  for (Index x = 0; x < ends.tables(); ++x) {
    for (Index y = 0; y < ends.rows(); ++y) {  // a search along a column ends there
      require(static_cast<Index>(std::bit_width(ends(x, y, words - 1))) == label.columns() - 64 * (words - 1),
              "ends: columns end elsewhere");
    }
  }
}

void bind_spheres(nb::module_& module) {
  def(
      module, "find_ends",
      [](Labels label) {
        const Index words = (label.columns() + 63) / 64;
        Array<Word, 3> out{std::vector<Word>(label.tables() * label.rows() * words),
                           {static_cast<std::size_t>(label.tables()), static_cast<std::size_t>(label.rows()),
                            static_cast<std::size_t>(words)}};
        find_ends(label, {out.values.data(), label.tables(), label.rows(), words});
        return out;
      },
      "Where columns along z change their subspace, as bits.", "label");
  def(
      module, "largest_sphere",
      [](Labels label, Tables<const Word> ends, Vec3 half, Index number, Triple low, Triple high) {
        check_nodes(label, ends, half);
        const Triple shape = shape_of(label);
        for (int axis = 0; axis < 3; ++axis) {
          require(is_within(low[axis], 0, high[axis]), "low: not from 0 to high");
          require(high[axis] <= shape[axis], "high: beyond the labels");
        }
        const Sphere found = largest_sphere(label, ends, half, number, low, high);
        return std::tuple(found.square, std::tuple(found.centre[0], found.centre[1], found.centre[2]));
      },
      "The square of the radius, and the centre, of the largest sphere in a subspace.", "label", "ends", "half",
      "number", "low", "high");
  def(
      module, "clearance",
      [](Labels label, Vec3 half, Triple node) {
        check_edge(half, "half: not from 1e-9 to 1e9 m");
        require(*std::ranges::min_element(node) >= 0, "node: negative");
        return clearance(label, half, node);
      },
      "The squared distance of a node from the nearest face.", "label", "half", "node");
}

void bind_detection(nb::module_& module) {
  def(
      module, "detected_positions",
      [](Labels labels, Triple size, Index threshold, Index layers, Index misses, View<bool> held) {
        const Triple shape = shape_of(labels);
        for (int axis = 0; axis < 3; ++axis) {
          require(is_within(size[axis], 1, shape[axis]), "size: not from 1 to the labels'");
        }
        require(is_within(threshold, 0, count_max), "threshold: negative, or too large");
        require(layers > 0, "layers: none");
        require(held.empty() || are_labels(labels, std::ssize(held)), "held: not one for each label");
        PlaceCounts found = detected_positions(labels, size, threshold, layers, misses, held);
        const std::array<std::size_t, 2> places{static_cast<std::size_t>(found.columns),
                                                static_cast<std::size_t>(found.rows)};
        return std::tuple(Array<std::int64_t, 2>{std::move(found.detected), places},
                          Array<std::int64_t, 2>{std::move(found.places), places});
      },
      "At how many places a box of cuboids touches more than so many subspaces.", "labels", "size", "threshold",
      "layers", "misses", "held");
  def(
      module, "detected_boxes",
      [](Labels labels, Vec3 low, Vec3 edge, View<const std::array<double, 4>> boxes, Vec3 size, Index threshold) {
        check_edge(edge, "edge: not from 1e-9 to 1e9 m");
        require(is_within(threshold, 0, count_max), "threshold: negative, or too large");
        const BoxCounts found = detected_boxes(labels, low, edge, boxes, size, threshold);
        return std::tuple(found.detected, found.free);
      },
      "How many boxes touch more than so many subspaces.", "labels", "low", "edge", "boxes", "size", "threshold");
}

void check(const Lattice& lattice) {
  require(is_within(lattice.axis, 0, 2), "lattice.axis: not 0, 1 or 2");
  require(is_finite(lattice.low), "lattice.low: not finite");
  check_edge(lattice.edge, "lattice.edge: not from 1e-9 to 1e9 m");
  for (const Index one : lattice.shape) {
    require(is_within(one, 1, count_max / 2), "lattice.shape: empty, or too large");
  }
  require(lattice.shape[1] <= count_max / lattice.shape[2], "lattice.shape: too many lines");
}

LineRange range_of(std::array<Index, 2> lines, const Lattice& lattice) {
  require(is_within(lines[0], 0, lines[1]) && lines[1] <= lattice.count(), "lines: not of the lattice");
  return {lines[0], lines[1]};
}

void check(const LineCrossings& crossed, Index lines, const char* message) {
  require(are_first(crossed.first, lines, std::ssize(crossed.at)) && crossed.at.size() == crossed.weight.size(),
          message);
}

auto to_tuple(FoundCrossings&& found) {
  return std::tuple(std::move(found.first), std::move(found.at), std::move(found.weight));
}

void bind_boundaries(nb::module_& module) {
  module.attr("DIRECTION_BINS") = direction_bins;
  def(
      module, "find_candidates",
      [](const Lattice& lattice, std::array<Index, 2> lines, const Bounds& bounds, const LineCrossings& surfaces) {
        check(lattice);
        check(surfaces, lattice.count(), "surfaces: not of all lines");
        require(is_finite(bounds.foot), "bounds.foot: not finite");
        require(are_first(bounds.first, direction_bins, std::ssize(bounds.item)), "bounds.first: not of all bins");
        require(are_within(bounds.item.data(), std::ssize(bounds.item), 0,
                           std::ssize(bounds.edges) + std::ssize(bounds.quadrics)),
                "bounds.item: neither an edge nor a quadric");
        return to_tuple(find_candidates(lattice, range_of(lines, lattice), bounds, surfaces));
      },
      "Where lines may leave or enter what a LiDAR sees.", "lattice", "lines", "bounds", "surfaces");
  def(
      module, "find_middles",
      [](const Lattice& lattice, std::array<Index, 2> lines, const LineCrossings& crossed) {
        check(lattice);
        const LineRange range = range_of(lines, lattice);
        check(crossed, range.end - range.begin, "crossed: not of the lines");
        return find_middles(lattice, range, crossed);
      },
      "Midpoints of what lies between crossings.", "lattice", "lines", "crossed");
  def(
      module, "find_flips",
      [](const LineCrossings& crossed, View<const bool> states, View<bool> start) {
        check(crossed, std::ssize(start), "crossed: not of the lines");
        require(states.size() == crossed.at.size() + start.size(), "states: one between any two crossings");
        return to_tuple(find_flips(crossed, states, start));
      },
      "Where states change along lines.", "crossed", "states", "start");
  def(
      module, "find_solid_flips",
      [](const Lattice& lattice, const LineCrossings& surfaces, View<const std::int64_t> part, Index parts,
         View<bool> start) {
        check(lattice);
        check(surfaces, std::ssize(start), "surfaces: not of the lines");
        require(part.size() == surfaces.at.size(), "part: one for each crossing");
        require(is_within(parts, 0, 1 << 26), "parts: not from 0 to 2^26");
        require(are_within(part.data(), std::ssize(part), 0, parts), "part: not below parts");
        return to_tuple(find_solid_flips(lattice, surfaces, part, parts, start));
      },
      "Where lines enter and leave closed parts.", "lattice", "surfaces", "part", "parts", "start");
  def(
      module, "cross_triangles",
      [](const Lattice& lattice, Rows<const Vec3> triangles) {
        check(lattice);
        require(triangles.columns() == 3, "triangles: three corners each");
        return cross_triangles(lattice, triangles);
      },
      "Where lines pass through triangles.", "lattice", "triangles");
  def(
      module, "cross_rounds",
      [](const Lattice& lattice, View<const Round> rounds) {
        check(lattice);
        return cross_rounds(lattice, rounds);
      },
      "Where lines pass through spheres and upright cylinders.", "lattice", "rounds");
}

void check(const Sheaf& sheaf, Rows<const std::int64_t> gap, Rows<const double> rows, const Flips& flips,
           const Sums& sums) {
  require(is_within(sheaf.axis, 0, 2), "sheaf.axis: not 0, 1 or 2");
  require(is_finite(sheaf.low), "sheaf.low: not finite");
  check_edge(sheaf.edge, "sheaf.edge: not from 1e-9 to 1e9 m");
  require(sheaf.label.size() > 0, "sheaf.label: empty");
  require(sheaf.within.tables() == sheaf.label.tables() && sheaf.within.rows() == sheaf.label.rows() &&
              sheaf.within.columns() == sheaf.label.columns(),
          "sheaf.within: one for each label");
  const Index subspaces = gap.rows();
  const Index lidars = rows.rows();
  const Index lines = sheaf.lattice().count();
  require(are_labels(sheaf.label, subspaces), "sheaf.label: not a row of gap");
  require(gap.columns() == lidars, "gap: one for each LiDAR");
  require(rows.columns() >= Cones::first_beam, "rows: six numbers before the beams");
  require(sheaf.cones.rows() == lidars && sheaf.cones.columns() >= Cones::first_beam, "sheaf.cones: one for each row");
  require(flips.start.rows() == lidars + 1 && flips.start.columns() == lines,
          "flips.start: one for each line and LiDAR, and one more");
  require(are_first(flips.first, flips.start.size(), std::ssize(flips.at)) && flips.at.size() == flips.weight.size(),
          "flips.first: not of all lines");
  for (const View<double>& one : {sums.volume, sums.shadow, sums.surface}) {
    require(std::ssize(one) == subspaces, "sums: one for each subspace");
  }
  require(std::ssize(sums.parent) == subspaces, "sums.parent: one for each subspace");
  for (Index n = 0; n < subspaces; ++n) {
    require(is_within(sums.parent[n], 0, n), "sums.parent: not a subspace before");
  }
}

}  // namespace

void bind_analytic(nb::module_& module) {
  module.attr("LINES_PER_EDGE") = lines_per_edge;
  def(
      module, "cross_cones",
      [](std::array<double, 2> across, View<const double> cone, double low, double high) {
        require(std::ssize(cone) >= Cones::first_beam, "cone: six numbers before the beams");
        Crossings found;
        cross_cones({across[0], across[1]}, cone, low, high, found);
        FoundCrossings out;
        for (Index n = 0; n < found.size(); ++n) {
          out.add(found[n]);
        }
        return std::tuple(std::move(out.at), std::move(out.weight));
      },
      "Where a line crosses a LiDAR's cones.", "across", "cone", "low", "high");
  def(
      module, "sweep_lines",
      [](const Sheaf& sheaf, Rows<const std::int64_t> gap, Rows<const double> rows, const Flips& flips,
         const Sums& sums) {
        check(sheaf, gap, rows, flips, sums);
        sweep_lines(sheaf, gap, rows, flips, sums);
      },
      "Add what the lines see of subspaces.", "sheaf", "gap", "rows", "flips", "sums");
  bind_boundaries(module);
  bind_detection(module);
  bind_spheres(module);
}

}  // namespace lidarcfg::bind
