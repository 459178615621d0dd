/// First hits in a whole scene: the ground in closed form, static objects by one hierarchy, dynamic ones by their own.
#pragma once

#include <vector>

#include "world/bvh.h"
#include "world/motion.h"
#include "world/packer.h"
#include "world/packet.h"

namespace lidarcfg::world {

constexpr std::int32_t no_object = -1;

/// A dynamic object, its shapes in its own frame, whose origin is its place.
struct Moving {
  Bvh bvh;
  Vec3 place_m;          // at time 0
  Path path;             // from there
  double speed_m_s = 0;  // at most
  double radius_m = 0;   // of a sphere around the place that holds the object whichever way it turns
  std::int32_t first_slot = 0;

  /// A ray at a time, brought into the object's frame.
  struct Ray {
    Vec3 origin;
    Vec3 direction;
  };
  Ray brought(const Pose& pose, const Vec3& origin, const Vec3& direction) const;
};

/// What N rays hit first, to be written; columns that are not asked for have no rows.
struct Found {
  View<double> range_m;     // (N,) inf: nothing
  View<std::int32_t> slot;  // (N,) of a shape; `ground_slot` or `no_slot`
  View<Vec3> normal;        // (N,) of the surface, towards either side
  View<double> cosine;      // (N,) of the angle between ray and normal
};

/// All that rays may hit, relative to a local origin. Slots count through the static objects' shapes, then through
/// those of one dynamic object after another.
class World {
 public:
  /// `ground_m` is the ground's height; inf: none. Of moving objects, radius and first slot are found here.
  World(double ground_m, Bvh fixed, std::vector<Moving> moving);

  /// This world where its P moving objects have other paths and greatest speeds (P,). Hierarchies are shared.
  World along(View<const double> speeds_m_s, std::vector<Path> paths) const;

  double ground_m() const { return ground_m_; }
  const Bvh& fixed() const { return fixed_; }
  const std::vector<Moving>& moving() const { return moving_; }
  std::int32_t slots() const { return slots_; }

  /// The moving object that a slot beyond the static ones belongs to.
  const Moving& moving_at(std::int32_t slot) const;

  /// The unit normal where a ray hits what is in a slot, at a time; not for `no_slot`.
  Vec3 normal(std::int32_t slot, const Vec3& origin, const Vec3& direction, double range_m, double seconds) const;

  /// Write what a packet's rays hit at times (count,) to rows (count,) of the columns that are asked for.
  void write(const Packet& packet, View<const double> seconds, View<const Index> rows, const Found& found) const;

  std::int32_t object(std::int32_t slot) const;    // that a shape belongs to; 0: the ground, `no_object`: nothing
  std::int32_t triangle(std::int32_t slot) const;  // its number; `no_object`: the ground, or nothing

 private:
  double ground_m_;
  Bvh fixed_;
  std::vector<Moving> moving_;
  std::int32_t slots_;
};

/// Has packets hit a world's moving objects; each thread has its own.
class MovingTracer {
 public:
  explicit MovingTracer(const World& world) : world_(world) {}

  /// Have it trace at these times only: objects are held by spheres that contain them meanwhile.
  void during(double first_s, double last_s);

  /// Keep what a packet's rays hit at times (count,) where that is nearer than what they are known to hit.
  void hit(Packet& packet, View<const double> seconds);

 private:
  void hit_object(const Moving& object, Packet& packet, View<const double> seconds);

  const World& world_;
  Bvh swept_;
  std::vector<std::int32_t> near_;
  Packer packer_;
};

/// Find what rays (3, N) at times (N,) hit first within a limit; it is fastest for neighbours in succession.
void cast(const World& world, Rows<const double> origins, Rows<const double> directions, View<const double> seconds,
          double limit_m, const Found& found);

}  // namespace lidarcfg::world
