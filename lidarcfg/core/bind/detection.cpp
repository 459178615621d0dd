#include "placement/detection.h"

#include <algorithm>
#include <bit>

#include "bind/arguments.h"
#include "bind/modules.h"
#include "placement/spheres.h"

namespace lidarcfg::bind {

using namespace placement;

namespace {

using Labels = Tables<const std::int32_t>;
using Triple = std::array<Index, 3>;

constexpr Index count_max = Index{1} << 31;  // of subspaces

bool is_within(Index value, Index least, Index most) { return least <= value && value <= most; }

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

void bind_boxes(nb::module_& module) {
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

}  // namespace

void bind_detection(nb::module_& module) {
  bind_boxes(module);
  bind_spheres(module);
}

}  // namespace lidarcfg::bind
