#include "world/bvh.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <vector>

namespace lidarcfg::world {
namespace {

constexpr int bins = 16;
constexpr int leaf_most = 3;        // shapes in a leaf
constexpr int levels_by_area = 40;  // deeper down, nodes are halved by count, so that no tree is too deep
constexpr double shape_cost = 1.2;  // to test a shape, in tests of a node
constexpr float inf = std::numeric_limits<float>::infinity();

float below(double value) {
  const float rounded = static_cast<float>(value);
  return rounded > value ? std::nextafter(rounded, -inf) : rounded;
}

float above(double value) {
  const float rounded = static_cast<float>(value);
  return rounded < value ? std::nextafter(rounded, inf) : rounded;
}

/// A node of the binary tree; without children, a leaf.
struct Binary {
  Box box;
  std::int32_t first;  // of the shapes in order
  std::int32_t end;
  std::int32_t left = -1;
  std::int32_t right = -1;
};

/// After which bin of an axis to cut a node, and at which cost: the areas of both sides, times their counts.
struct Cut {
  int axis = -1;
  int bin = 0;
  double cost = std::numeric_limits<double>::infinity();
};

/// A box and which shape it holds.
struct Item {
  Box box;
  std::int32_t shape;
};

/// Which bin a box is in, by its centre.
struct Binning {
  std::array<float, 3> low;
  std::array<float, 3> scale;

  int operator()(const Box& box, int axis) const {
    const float place = (box.low[axis] + box.high[axis] - low[axis]) * scale[axis];
    return place > 0 ? static_cast<int>(std::min<float>(place, bins - 1)) : 0;  // a NaN is in the first
  }
};

struct Bin {
  Box box = Box::none();
  Index count = 0;

  void add(const Bin& other) {
    box.add(other.box);
    count += other.count;
  }
  double cost() const { return static_cast<double>(count) * box.half_area(); }
};

class Builder {
 public:
  Builder(View<const Shape> shapes, View<const Kind> kind) : kind_(kind) {
    items_.reserve(shapes.size());
    for (Index s = 0; s < std::ssize(shapes); ++s) {
      items_.push_back({box_of(shapes[s], kind[s]), static_cast<std::int32_t>(s)});
    }
    split(0, static_cast<std::int32_t>(shapes.size()), 0);
  }

  const std::vector<Item>& items() const { return items_; }

  /// Append the nodes of eight children of a subtree; returns its code.
  std::int32_t collapse(std::int32_t root, std::vector<Node>& out) const {
    const Binary& top = tree_[root];
    if (top.left < 0 && !out.empty()) {
      return leaf(top);
    }
    std::array<std::int32_t, node_size> children{root};
    int count = 1;
    while (count < node_size) {
      const auto end = children.begin() + count;
      const auto largest = std::max_element(children.begin(), end, [&](int a, int b) { return size(a) < size(b); });
      const Binary& opened = tree_[*largest];
      if (opened.left < 0) {
        break;
      }
      *largest = opened.left;
      children[count++] = opened.right;
    }
    const auto number = static_cast<std::int32_t>(out.size());
    out.emplace_back();
    for (int c = 0; c < node_size; ++c) {
      const bool is = c < count;
      const Box box = is ? tree_[children[c]].box : Box::none();
      const std::int32_t code = is ? collapse(children[c], out) : LeafCode::of(0, 0, false);
      Node& node = out[number];  // which may have moved
      node.child[c] = code;
      for (int axis = 0; axis < 3; ++axis) {
        node.side[0][axis][c] = box.low[axis];
        node.side[1][axis][c] = box.high[axis];
      }
    }
    return number;
  }

 private:
  /// By which children are opened, the largest first; leaves last.
  float size(std::int32_t node) const { return tree_[node].left < 0 ? -1.0f : tree_[node].box.half_area(); }

  std::int32_t leaf(const Binary& node) const {
    bool mixed = false;
    for (std::int32_t i = node.first; i < node.end; ++i) {
      mixed |= kind_[items_[i].shape] != Kind::triangle;
    }
    return LeafCode::of(node.first, node.end - node.first, mixed);
  }

  std::int32_t split(std::int32_t first, std::int32_t end, int depth) {
    Box whole = Box::none();
    Box centres = Box::none();
    for (std::int32_t i = first; i < end; ++i) {
      const Box& box = items_[i].box;
      whole.add(box);
      for (int axis = 0; axis < 3; ++axis) {
        const float centre = box.low[axis] + box.high[axis];
        centres.low[axis] = std::min(centres.low[axis], centre);
        centres.high[axis] = std::max(centres.high[axis], centre);
      }
    }
    const auto number = static_cast<std::int32_t>(tree_.size());
    const std::int32_t count = end - first;
    tree_.push_back({whole, first, end});
    Binning binning{centres.low, {}};
    for (int axis = 0; axis < 3; ++axis) {
      const float extent = centres.high[axis] - centres.low[axis];
      binning.scale[axis] = extent > 0 ? static_cast<float>(bins * 0.9999) / extent : 0.0f;
    }
    const Cut cut = depth < levels_by_area && count > 1 ? cheapest(first, end, binning) : Cut{};
    const double area = whole.half_area();
    if (count <= leaf_most && (cut.axis < 0 || !(area > 0) ||
                               area + shape_cost * cut.cost >= shape_cost * static_cast<double>(count) * area)) {
      return number;
    }
    std::int32_t middle = first;
    if (cut.axis >= 0) {
      for (std::int32_t last = end - 1; middle <= last;) {
        if (binning(items_[middle].box, cut.axis) <= cut.bin) {
          ++middle;
        } else {
          std::swap(items_[middle], items_[last]);
          --last;
        }
      }
    }
    if (middle == first || middle == end) {
      middle = first + count / 2;
    }
    const std::int32_t left = split(first, middle, depth + 1);
    const std::int32_t right = split(middle, end, depth + 1);
    tree_[number].left = left;
    tree_[number].right = right;
    return number;
  }

  Cut cheapest(std::int32_t first, std::int32_t end, const Binning& binning) const {
    Cut best;
    for (int axis = 0; axis < 3; ++axis) {
      if (binning.scale[axis] == 0) {
        continue;
      }
      Bin bin[bins];
      for (std::int32_t i = first; i < end; ++i) {
        bin[binning(items_[i].box, axis)].add({items_[i].box, 1});
      }
      double right[bins];
      Bin side;
      for (int b = bins - 1; b > 0; --b) {
        side.add(bin[b]);
        right[b - 1] = side.count ? side.cost() : std::numeric_limits<double>::infinity();
      }
      side = {};
      for (int b = 0; b < bins - 1; ++b) {
        side.add(bin[b]);
        if (side.count && right[b] + side.cost() < best.cost) {
          best = {axis, b, right[b] + side.cost()};
        }
      }
    }
    return best;
  }

  View<const Kind> kind_;
  std::vector<Item> items_;
  std::vector<Binary> tree_;
};

/// What a Bvh's views look at.
struct Memory {
  std::vector<Node> nodes;
  std::vector<Leaf> leaves;
  std::vector<Kind> kind;
  std::vector<std::int32_t> number;
  std::vector<std::int32_t> object;
};

}  // namespace

Box Box::none() { return {{inf, inf, inf}, {-inf, -inf, -inf}}; }

void Box::add(const Box& other) {
  for (int axis = 0; axis < 3; ++axis) {
    low[axis] = std::min(low[axis], other.low[axis]);
    high[axis] = std::max(high[axis], other.high[axis]);
  }
}

float Box::half_area() const {
  const float x = high[0] - low[0];
  const float y = high[1] - low[1];
  const float z = high[2] - low[2];
  return x * y + y * z + z * x;
}

Box box_of(const Shape& shape, Kind kind) {
  Box out;
  for (int axis = 0; axis < 3; ++axis) {
    double least = std::min({shape[axis], shape[3 + axis], shape[6 + axis]});
    double most = std::max({shape[axis], shape[3 + axis], shape[6 + axis]});
    if (kind != Kind::triangle) {
      const bool upright = kind == Kind::cylinder && axis == 2;
      least = upright ? shape[axis] : shape[axis] - shape[3];
      most = shape[axis] + (upright ? shape[4] : shape[3]);
    }
    out.low[axis] = below(least);
    out.high[axis] = above(most);
  }
  return out;
}

Bvh build(View<const Shape> shapes, View<const Kind> kind, View<const std::int32_t> number,
          View<const std::int32_t> object) {
  if (std::ssize(shapes) > most_shapes) {
    throw std::invalid_argument("shapes: more than 268,435,456");
  }
  Bvh out;
  if (shapes.empty()) {
    return out;
  }
  auto memory = std::make_shared<Memory>();
  const Builder builder(shapes, kind);
  builder.collapse(0, memory->nodes);
  memory->nodes.shrink_to_fit();
  memory->leaves.reserve(shapes.size());
  memory->kind.reserve(shapes.size());
  memory->number.reserve(shapes.size());
  memory->object.reserve(shapes.size());
  for (const auto& [box, s] : builder.items()) {
    memory->leaves.push_back({box, shapes[s]});
    memory->kind.push_back(kind[s]);
    memory->number.push_back(number[s]);
    memory->object.push_back(object[s]);
    float reach_m = 0;
    for (int axis = 0; axis < 3; ++axis) {
      reach_m += std::max(std::abs(box.low[axis]), std::abs(box.high[axis]));
    }
    out.reach_m = std::max(out.reach_m, reach_m);
  }
  out.nodes = memory->nodes;
  out.leaves = memory->leaves;
  out.kind = memory->kind;
  out.number = memory->number;
  out.object = memory->object;
  out.memory = memory;
  return out;
}

}  // namespace lidarcfg::world
