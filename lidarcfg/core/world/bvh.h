/// A bounding volume hierarchy over triangles, spheres and cylinders, whose nodes have eight children.
///
/// It is built by the surface area heuristic, binned as in Wald, On fast Construction of SAH-based Bounding Volume
/// Hierarchies, 2007, as a binary tree, of which each node then takes in its largest descendants.
#pragma once

#include <memory>

#include "views.h"

namespace lidarcfg::world {

constexpr int node_size = 8;

enum class Kind : std::uint8_t { triangle, sphere, cylinder, instance };

/// A triangle: three corners. A sphere or an instance, which is the sphere around a moving object: centre, radius. An
/// upright cylinder: base, radius, height.
using Shape = std::array<double, 9>;

/// Of float32, rounded outwards.
struct Box {
  std::array<float, 3> low;
  std::array<float, 3> high;

  static Box none();
  float half_area() const;
};

Box box_of(const Shape& shape, Kind kind);

/// The shapes of a leaf: those from a slot on, at most three.
class LeafCode {
 public:
  explicit LeafCode(std::int32_t code) : bits_(~code) {}

  static std::int32_t of(std::int32_t first, int count, bool mixed) { return ~(8 * first + 4 * mixed + count); }

  std::int32_t first() const { return bits_ >> 3; }
  std::int32_t end() const { return first() + (bits_ & 3); }
  bool mixed() const { return bits_ & 4; }  // not all of them are triangles

 private:
  std::int32_t bits_;
};

/// What a node says of its children, by columns. A child is the number of a node, or the code of a leaf, below 0; where
/// there is none, its box is empty.
struct alignas(32) Node {
  float side[2][3][node_size];  // low, high; along x, y and z
  std::int32_t child[node_size];
};

/// A shape and its box, side by side in memory.
struct alignas(32) Leaf {
  Box box;
  Shape shape;
};

/// A hierarchy over S shapes, which are in the order of its leaves: a slot is a place there. Copies share its memory,
/// which never changes.
struct Bvh {
  View<const Node> nodes;           // the root first; none: no shapes
  View<const Leaf> leaves;          // (S,)
  View<const Kind> kind;            // (S,)
  View<const std::int32_t> number;  // (S,) that the shape was given
  View<const std::int32_t> object;  // (S,) it belongs to
  float reach_m = 0;                // no coordinates of a point add up to more
  std::shared_ptr<const void> memory;

  Index size() const { return std::ssize(leaves); }
};

constexpr Index most_shapes = Index{1} << 28;  // so that slots fit into leaf codes
constexpr int most_levels = 70;                // of nodes

/// The hierarchy over shapes of kinds (S,) with numbers (S,), which belong to objects (S,); S is at most `most_shapes`.
Bvh build(View<const Shape> shapes, View<const Kind> kind, View<const std::int32_t> number,
          View<const std::int32_t> object);

/// The same hierarchy in memory of its own, from wherever the views come.
///
/// Throws std::invalid_argument where these are not such that rays find their way.
Bvh copy_of(const Bvh& views);

}  // namespace lidarcfg::world
