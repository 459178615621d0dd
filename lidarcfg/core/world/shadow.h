/// What a tree hides from one point, for targets in rows along x: most by boxes, the rest by packets of segments.
///
/// The segments to a row lie in one plane through the point. Where that plane cuts a box is found for the whole row at
/// once, so only targets behind some box are worth a segment; segments that face the same way wait until they fill a
/// packet, from whichever rows they are. Behind a triangle that hid others lately, the targets of a row that are hidden
/// for certain are found at once, too, without segments.
#pragma once

#include "world/packer.h"

namespace lidarcfg::world {

constexpr Index shadow_boxes = 16;  // around a hierarchy's shapes

/// (6, shadow_boxes) low and high corners of boxes that together hold a hierarchy's shapes, row by row; not all of them
/// need be different. None if there are no shapes.
std::vector<double> boxes_of(const Bvh& bvh);

/// 64 targets along x, relative to the hierarchy's origin.
struct TargetRow {
  const double* x;  // (64,) before `offset_m` is subtracted
  double offset_m;
  double y, z;
  double edge_m;  // along x, from one to the next

  double first_x() const { return x[0] - offset_m; }
};

/// The targets of a row to which a segment from a point may hit one of the boxes (6, shadow_boxes) of `boxes_of`.
std::uint64_t behind_boxes(Rows<const double> boxes, const Vec3& origin, const TargetRow& targets);

/// Segments from one point that wait for others that face the same way.
class ShadowCaster {
 public:
  /// Have segments start at this point from now on.
  void start(const Vec3& origin) { origin_ = origin; }

  /// Take hidden targets from seen (rows,), of those that a word names of a row. Some of them wait until `flush`.
  void apply(const Bvh& bvh, const TargetRow& targets, std::uint64_t word, Index row, View<std::uint64_t> seen);

  /// Cast all segments that wait.
  void flush(const Bvh& bvh, View<std::uint64_t> seen);

  /// How many segments were cast since the last call.
  std::int64_t take_cast_count();

 private:
  void cast(const Bvh& bvh, Packet& packet, View<const Index> targets, View<std::uint64_t> seen);
  std::uint64_t without_occluded(const Bvh& bvh, const TargetRow& targets, std::uint64_t word, Index row,
                                 View<std::uint64_t> seen) const;

  static constexpr int remembered = 8;
  using Occluders = std::array<std::int32_t, remembered>;  // the latest first

  static Occluders no_occluders() {
    Occluders none;
    none.fill(-1);
    return none;
  }

  Vec3 origin_{};
  Packer packer_;  // of segments, whose numbers are row · 64 + bit
  std::vector<Occluders> occluders_ =
      std::vector<Occluders>(faces, no_occluders());  // slots of triangles that hid others; -1: none
  std::int64_t cast_count_ = 0;
};

}  // namespace lidarcfg::world
