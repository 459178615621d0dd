/// What a tree hides from one point, for targets in rows along x: most by boxes, the rest by packets of segments.
///
/// The segments to a row lie in one plane through the point. Where that plane cuts a box is found for the whole row at
/// once, so only targets behind some box are worth a segment; segments that face the same way wait until they fill a
/// packet, from whichever rows they are. Behind a triangle that hid others lately, the targets of a row that are hidden
/// for certain are found at once, too, without segments.
#pragma once

#include <vector>

#include "views.h"

namespace lidarcfg::world {

class Bvh;

/// 64 targets along x, relative to the tree's origin.
struct TargetRow {
  const double* x;  // (64,) before `offset_m` is subtracted
  double offset_m;
  double y, z;
  double edge_m;  // along x, from one to the next

  double first_x() const { return x[0] - offset_m; }
};

/// The targets of a row to which a segment from a point may hit one of the boxes (6, B): low and high corners.
std::uint64_t behind_boxes(Rows<const double> boxes, const Vec3& origin, const TargetRow& targets);

/// Segments from one point that wait for others that face the same way.
class ShadowCaster {
 public:
  static constexpr int faces = 32;
  static constexpr int size = 32;  // segments of a packet

  /// Have segments start at this point from now on.
  void start(const Vec3& origin) { origin_ = origin; }

  /// Take hidden targets from seen (rows,), of those that a word names of a row. Some of them wait until `flush`.
  void apply(const Bvh& tree, const TargetRow& targets, std::uint64_t word, Index row, View<std::uint64_t> seen);

  /// Cast all segments that wait.
  void flush(const Bvh& tree, View<std::uint64_t> seen);

  /// How many segments were cast since the last call.
  std::int64_t take_cast_count();

 private:
  struct Queue {
    std::array<Vec3, size> directions;
    std::array<Index, size> targets;  // row · 64 + bit
    int count = 0;
    std::array<std::int32_t, 2> last_slots{-1, -1};  // of triangles that hid others; -1: none
  };

  void cast(const Bvh& tree, int face, View<std::uint64_t> seen);
  std::uint64_t without_occluded(const Bvh& tree, const TargetRow& targets, std::uint64_t word, Index row,
                                 View<std::uint64_t> seen) const;

  Vec3 origin_{};
  std::vector<Queue> queues_ = std::vector<Queue>(faces);
  std::int64_t cast_count_ = 0;
};

}  // namespace lidarcfg::world
