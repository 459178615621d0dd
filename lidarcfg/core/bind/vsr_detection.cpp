#include <algorithm>

#include "bind/arguments.h"
#include "bind/modules.h"
#include "vsr/detection.h"

namespace lidarcfg::bind {

using namespace vsr;

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

bool are_labels(Labels label, Index subspaces) {
  const auto [low, high] = std::minmax_element(label.data(), label.data() + label.size());
  return label.size() == 0 || (-1 <= *low && *high < subspaces);
}

}  // namespace

void bind_vsr_detection(nb::module_& module) {
  def(
      module, "detected_positions",
      [](Labels labels, Triple size, Index threshold, Index layers, Index misses, View<bool> held) {
        const Triple shape{labels.tables(), labels.rows(), labels.columns()};
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
      R"(At how many places (mx, my) a box of cuboids touches more than `threshold` subspaces; how many places there are.

labels (nx, ny, nz), −1 where excluded; the box's lowest layer is one of the first `layers`. Ends after so
many misses. held (n,) is set for subspaces that a box lies in, if it is not empty.)",
      "labels", "size", "threshold", "layers", "misses", "held");
  def(
      module, "detected_boxes",
      [](Labels labels, Vec3 low, Vec3 edge, View<const std::array<double, 4>> boxes, Vec3 size, Index threshold) {
        check_edge(edge, "edge: not from 1e-9 to 1e9 m");
        require(is_within(threshold, 0, count_max), "threshold: negative, or too large");
        const BoxCounts found = detected_boxes(labels, low, edge, boxes, size, threshold);
        return std::tuple(found.detected, found.free);
      },
      "How many boxes (n, 4: centre x, y, bottom, heading) touch more than `threshold` subspaces; how many are free.",
      "labels", "low", "edge", "boxes", "size", "threshold");
}

}  // namespace lidarcfg::bind
