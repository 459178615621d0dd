#include "world/bvh.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <stdexcept>
#include <vector>

#include "simd.h"

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

using Float4 = simd::VectorOf<float, 4>::type;  // along x, y and z; the last means nothing

/// A box in registers.
struct Bounds {
  Float4 low = Float4{} + inf;
  Float4 high = Float4{} - inf;

  Bounds() = default;
  explicit Bounds(const Box& box)
      : low{box.low[0], box.low[1], box.low[2], 0}, high{box.high[0], box.high[1], box.high[2], 0} {}

  Box box() const { return {{low[0], low[1], low[2]}, {high[0], high[1], high[2]}}; }

  void add(const Bounds& other) {
    low = simd::min(other.low, low);
    high = simd::max(other.high, high);
  }

  float half_area() const { return box().half_area(); }
};

/// A node of the binary tree; without children, a leaf.
struct Binary {
  Bounds bounds;
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

/// Which bin boxes are in along each axis, by their centres.
struct Binning {
  using Bins = simd::VectorOf<std::int32_t, 4>::type;

  Float4 low;
  Float4 scale;  // 0: along this axis all are the same

  Bins operator()(const Bounds& one) const {
    const Float4 place = simd::max((one.low + one.high - low) * scale, Float4{});  // a NaN is in the first
    return __builtin_convertvector(simd::min(place, Float4{} + (bins - 1)), Bins);
  }
};

struct Bin {
  Bounds bounds;
  Index count = 0;

  void add(const Bin& other) {
    bounds.add(other.bounds);
    count += other.count;
  }
  double cost() const { return static_cast<double>(count) * bounds.half_area(); }
};

class Builder {
 public:
  Builder(View<const Shape> shapes, View<const Kind> kind) : kind_(kind), order_(shapes.size()) {
    std::iota(order_.begin(), order_.end(), 0);
    bounds_.reserve(shapes.size());
    for (Index s = 0; s < std::ssize(shapes); ++s) {
      bounds_.emplace_back(box_of(shapes[s], kind[s]));
    }
    split(0, static_cast<std::int32_t>(shapes.size()), 0);
  }

  Index size() const { return std::ssize(order_); }
  std::int32_t shape(Index slot) const { return order_[slot]; }
  Box box(Index slot) const { return bounds_[slot].box(); }

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
      const auto largest =
          std::max_element(children.begin(), end, [&](int a, int b) { return to_open(a) < to_open(b); });
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
      const Box box = is ? tree_[children[c]].bounds.box() : Box::none();
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
  /// By which children are opened, the largest first; leaves are not.
  float to_open(std::int32_t node) const { return tree_[node].left < 0 ? -1.0f : tree_[node].bounds.half_area(); }

  std::int32_t leaf(const Binary& node) const {
    bool mixed = false;
    for (std::int32_t i = node.first; i < node.end; ++i) {
      mixed |= kind_[order_[i]] != Kind::triangle;
    }
    return LeafCode::of(node.first, node.end - node.first, mixed);
  }

  /// Add a subtree over boxes; returns its number.
  std::int32_t split(std::int32_t first, std::int32_t end, int depth) {
    Bounds whole;
    Bounds centres;
    for (std::int32_t i = first; i < end; ++i) {
      const Bounds& one = bounds_[i];
      whole.add(one);
      const Float4 centre = one.low + one.high;
      centres.low = simd::min(centre, centres.low);
      centres.high = simd::max(centre, centres.high);
    }
    const auto number = static_cast<std::int32_t>(tree_.size());
    const std::int32_t count = end - first;
    tree_.push_back({whole, first, end});
    const Float4 extent = centres.high - centres.low;
    const Binning binning{centres.low, extent > 0 ? static_cast<float>(bins * 0.9999) / extent : Float4{}};
    const Cut cut = depth < levels_by_area && count > 1 ? cheapest(first, end, binning) : Cut{};
    const double area = whole.half_area();
    if (count <= leaf_most && (cut.axis < 0 || !(area > 0) ||
                               area + shape_cost * cut.cost >= shape_cost * static_cast<double>(count) * area)) {
      return number;
    }
    std::int32_t middle = first;
    if (cut.axis >= 0) {
      for (std::int32_t last = end - 1; middle <= last;) {
        if (binning(bounds_[middle])[cut.axis] <= cut.bin) {
          ++middle;
        } else {
          std::swap(bounds_[middle], bounds_[last]);
          std::swap(order_[middle], order_[last]);
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
    Bin all[3][bins];
    for (std::int32_t i = first; i < end; ++i) {
      const Binning::Bins bin = binning(bounds_[i]);
      for (int axis = 0; axis < 3; ++axis) {
        Bin& one = all[axis][bin[axis]];
        one.bounds.add(bounds_[i]);
        ++one.count;
      }
    }
    Cut best;
    for (int axis = 0; axis < 3; ++axis) {
      if (binning.scale[axis] == 0) {
        continue;
      }
      const auto& bin = all[axis];
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
  std::vector<std::int32_t> order_;  // of the shapes
  std::vector<Bounds> bounds_;       // theirs, in this order
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

Bvh view_of(const std::shared_ptr<const Memory>& memory) {
  Bvh out{memory->nodes, memory->leaves, memory->kind, memory->number, memory->object, 0, memory};
  for (const Leaf& leaf : memory->leaves) {
    float reach_m = 0;
    for (int axis = 0; axis < 3; ++axis) {
      reach_m += std::max(std::abs(leaf.box.low[axis]), std::abs(leaf.box.high[axis]));
    }
    out.reach_m = std::max(out.reach_m, reach_m);
  }
  return out;
}

void require(bool holds, const char* message) {
  if (!holds) {
    throw std::invalid_argument(message);
  }
}

/// Whether a node's child may be the leaf of this code, or none.
bool is_leaf(std::int32_t code, Index shapes) {
  const LeafCode leaf(code);
  return leaf.first() <= leaf.end() && leaf.end() <= shapes;
}

void check(const Bvh& bvh) {
  const Index shapes = bvh.size();
  require(shapes <= most_shapes, "leaves: too many");
  require(std::ssize(bvh.kind) == shapes, "kind: one for each leaf");
  require(std::ssize(bvh.number) == shapes, "number: one for each leaf");
  require(std::ssize(bvh.object) == shapes, "object: one for each leaf");
  require(bvh.nodes.empty() == bvh.leaves.empty(), "nodes: none, or without leaves");
  require(std::ranges::all_of(bvh.kind, [](Kind one) { return one <= Kind::instance; }), "kind: unknown");
  std::vector<int> level(bvh.nodes.size());  // of the nodes that another one leads to
  for (Index n = 0; n < std::ssize(bvh.nodes); ++n) {
    require(level[n] > 0 || n == 0, "nodes: not after the node that leads to it");
    for (const std::int32_t code : bvh.nodes[n].child) {
      if (code < 0) {
        require(is_leaf(code, shapes), "nodes: beyond the leaves");
        continue;
      }
      require(n < code && code < std::ssize(bvh.nodes) && level[code] == 0, "nodes: not a tree");
      level[code] = level[n] + 1;
      require(level[code] < most_levels, "nodes: too many levels");
    }
  }
}

}  // namespace

Box Box::none() { return {{inf, inf, inf}, {-inf, -inf, -inf}}; }

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
  auto memory = std::make_shared<Memory>();
  if (!shapes.empty()) {
    const Builder builder(shapes, kind);
    builder.collapse(0, memory->nodes);
    memory->nodes.shrink_to_fit();
    memory->leaves.reserve(shapes.size());
    memory->kind.reserve(shapes.size());
    memory->number.reserve(shapes.size());
    memory->object.reserve(shapes.size());
    for (Index slot = 0; slot < builder.size(); ++slot) {
      const std::int32_t s = builder.shape(slot);
      memory->leaves.push_back({builder.box(slot), shapes[s]});
      memory->kind.push_back(kind[s]);
      memory->number.push_back(number[s]);
      memory->object.push_back(object[s]);
    }
  }
  return view_of(memory);
}

Bvh copy_of(const Bvh& views) {
  check(views);
  return view_of(std::make_shared<Memory>(Memory{{views.nodes.begin(), views.nodes.end()},
                                                 {views.leaves.begin(), views.leaves.end()},
                                                 {views.kind.begin(), views.kind.end()},
                                                 {views.number.begin(), views.number.end()},
                                                 {views.object.begin(), views.object.end()}}));
}

}  // namespace lidarcfg::world
