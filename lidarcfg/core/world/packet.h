/// Rays that point nearly the same way and go through a hierarchy together: what each hits first, or anything.
///
/// Boxes are tested in float32 against intervals that hold the rays: those of the whole packet for the eight children
/// of a node at once, those of each group of rays for a shape. Shapes are tested in float64, by the same operations for
/// every ray, so that what a ray hits does not depend on the rays that it travels with.
///
/// Neighbouring rays should be neighbours in a packet; those of wide beams come beam after beam.
#pragma once

#include <cmath>
#include <vector>

#include "simd.h"
#include "world/bvh.h"

namespace lidarcfg::world {

constexpr int no_slot = -2;      // nothing is hit
constexpr int ground_slot = -1;  // the ground is
constexpr double ends = 1e-9;    // of a segment, at both of its ends, that count as its end points
constexpr int faces = 32;        // values of `facing`

/// The largest component of a direction and its octant as one number, which is the same for all rays of a packet.
inline int facing(double dx, double dy, double dz) {
  const double x = std::abs(dx);
  const double y = std::abs(dy);
  const double z = std::abs(dz);
  const int largest = z >= x && z >= y ? 2 : y >= x ? 1 : 0;
  return largest + 4 * (dx < 0) + 8 * (dy < 0) + 16 * (dz < 0);
}

constexpr int packet_size = 32;

/// Up to `packet_size` rays that face the same way.
///
/// Load rays, say how far each may go by `limit` or `keep`, have them hit hierarchies in any order, read ranges and
/// slots. Of two shapes at the same range the one of the lower slot is hit.
class Packet {
 public:
  /// Load rays `first` to `first` + count of (3, N), which face the same way; count is 1 to `packet_size`.
  void load(Rows<const double> origins, Rows<const double> directions, Index first, int count, int face);

  int count() const { return count_; }

  /// Have all rays end at a range, where they hit nothing.
  void limit(double range);

  /// What a ray is known to hit, if anything.
  void keep(int ray, double range, std::int32_t slot) {
    range_[ray] = range;
    slot_[ray] = slot;
  }

  /// Have each ray end at the ground, if that is within a limit, or else at the limit, where it hits nothing.
  void hit_ground(double ground_m, double limit_m);

  /// Keep what rays hit first of a hierarchy, where that is nearer than what they are known to hit; its slots count
  /// from `first_slot`. Directions are unit vectors, or there are triangles only.
  void first_hits(const Bvh& bvh, std::int32_t first_slot = 0);

  /// Keep anything that a hierarchy has on the segments from origins along directions, without their ends. Rays that
  /// have a slot are done, and have range -1 from then on.
  void any_hits(const Bvh& bvh);

  /// Append the numbers of the shapes into whose boxes rays come before what they are known to hit.
  void list_near(const Bvh& bvh, std::vector<std::int32_t>& numbers);

  double range(int ray) const { return range_[ray]; }
  std::int32_t slot(int ray) const { return static_cast<std::int32_t>(slot_[ray]); }
  Vec3 origin(int ray) const { return vector(origin_, ray); }
  Vec3 direction(int ray) const { return vector(direction_, ray); }

 private:
  static constexpr int group_size = simd::lanes<double>;
  static constexpr int chunk = simd::lanes<float>;  // groups whose boxes are tested at once
  static constexpr int most_groups = packet_size / group_size;
  static_assert(packet_size % group_size == 0 && most_groups % chunk == 0);
  using Lanes = double[packet_size];
  using Groups = float[most_groups];

  /// For boxes, along x, y and z: what to subtract from the side that is entered, or left, and what to multiply by.
  struct Interval {
    float origin[3];
    float inverse[3];
  };

  /// The plane through the first ray and the last one, near which those of one laser stay: for points within reach,
  /// normal · p is from low + t dip to high + t rise.
  struct Fan {
    float normal[3];
    float low;
    float high;
    float dip;
    float rise;
  };

  void bound();
  void span_fan();
  void begin();
  void shorten(int first_group);
  template <class Visit>
  bool walk(const Bvh& bvh, Index most, Visit visit);
  unsigned enter(const Node& node, float slack_m, float* near) const;
  unsigned groups_at(const Box& box, int first_group) const;
  bool hit_triangle(const Shape& shape, double slot, double after, int first_group, unsigned which);
  bool hit_round(const Shape& shape, Kind kind, double slot, double after, int first_group, unsigned which);
  bool hit(const Shape& shape, Kind kind, double slot, double after, int first_group, unsigned which);
  template <bool Any>
  void hits(const Bvh& bvh, std::int32_t first_slot);
  template <bool Any>
  void in_pieces(const Bvh& bvh, std::int32_t first_slot);
  void end_hit();
  Vec3 vector(const Lanes (&rows)[3], int ray) const;

  // Axes in the order in which the largest component is last.
  alignas(32) Lanes origin_[3];
  alignas(32) Lanes direction_[3];
  alignas(32) Lanes shear_[3];
  alignas(32) Lanes range_;
  alignas(32) Lanes slot_;
  alignas(32) Groups group_most_;  // the farthest range of each group
  alignas(32) Groups near_origin_[3];
  alignas(32) Groups near_inverse_[3];
  alignas(32) Groups far_origin_[3];
  alignas(32) Groups far_inverse_[3];
  Interval near_;
  Interval far_;
  Fan fan_;
  float most_;   // the farthest range of any ray
  int axis_[3];  // of the rows
  int sign_[3];  // of directions along x, y and z: whether they are negative
  int count_ = 0;
  int face_ = 0;
  int groups_ = 0;  // a multiple of `chunk`
  bool sheared_;
};

/// How many rays from `first` on, of (3, N), face the same way and so can be one packet of up to `most`.
struct Alike {
  int count;
  int face;
};
Alike alike(Rows<const double> directions, Index first, Index end, int most = packet_size);

}  // namespace lidarcfg::world
