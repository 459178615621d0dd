#include "simulate/trace.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <optional>

#include "world/shapes.h"

namespace lidarcfg::simulate {
namespace {

using world::Bvh;
using world::no_slot;

constexpr double inf = std::numeric_limits<double>::infinity();
constexpr std::int64_t block_ns = 50'000'000;  // for which moving objects are held by the same spheres

/// What rays hit.
template <int Width>
struct RayHits {
  double range_m[Width * most_beams];  // inf: nothing
  double cosine[Width * most_beams];   // of the angle between ray and normal
  std::int32_t slot[Width * most_beams];
};

/// The unit normals of a hierarchy's triangles, of which it remembers some.
class Normals {
 public:
  explicit Normals(const Bvh& bvh) : bvh_(bvh) { std::fill(std::begin(slot_), std::end(slot_), no_slot); }

  const Vec3& operator[](std::int32_t slot) {
    const int at = slot % count;
    if (slot_[at] != slot) {
      slot_[at] = slot;
      normal_[at] = world::normal_at(bvh_.leaves[slot].shape, world::Kind::triangle, {}, {}, 0);
    }
    return normal_[at];
  }

 private:
  static constexpr int count = 64;

  const Bvh& bvh_;
  std::int32_t slot_[count];
  Vec3 normal_[count];
};

/// Traces firings, batch by batch.
template <int Width>
class FiringTracer {
 public:
  using Rays = simulate::Rays<Width>;
  using RayHits = simulate::RayHits<Width>;

  FiringTracer(const Stage& stage, const Firings& firings, const Hits& hits)
      : stage_(stage),
        firings_(firings),
        hits_(hits),
        cosines_(hits.cosine.rows() > 0),
        aim_(stage.lasers, stage.mounting),
        normals_(stage.world.fixed()),
        body_normals_(stage.bodies) {}

  void trace();

 private:
  static constexpr int most_rays = Width * most_beams;

  template <class Hit>
  void by_face(Hit hit);
  template <class Hit>
  void by_packet(const Rays& rays, int face, Hit hit);
  void hit_world(const Rays& rays, int face, RayHits& hits);
  void hit_bodies(const Rays& rays, int face, RayHits& hits);
  void find_cosines(const Rays& rays, int first_ray, RayHits& hits);
  void write() const;

  double cosine(const Rays& rays, int n, const Vec3& normal) const {
    return std::abs(normal[0] * rays.directions[0][n] + normal[1] * rays.directions[1][n] +
                    normal[2] * rays.directions[2][n]);
  }

  const Stage& stage_;
  const Firings& firings_;
  const Hits& hits_;
  const bool cosines_;
  Aim<Width> aim_;
  std::optional<world::MovingTracer> moving_;
  Normals normals_;
  Normals body_normals_;

  View<const Index> which_;  // firings of the batch
  Rays rays_;                // of the batch
  RayHits found_;            // what they hit
  double face_[most_rays];   // what they face

  world::Packet packet_;
  int count_;                       // rays of the batch that face the same way
  int number_[most_rays];           // which they are
  double seconds_[most_rays] = {};  // when they start, if anything moves
  Rays gathered_;                   // they, unless they are the whole batch
  RayHits gathered_hits_;
};

template <int Width>
void FiringTracer<Width>::trace() {
  const bool moves = !stage_.world.moving().empty();
  const Batches batches = divide(firings_, most_beams, moves ? block_ns : 0);
  if (moves) {
    moving_.emplace(stage_.world);
  }
  for (Index b = 0; b < batches.count(); ++b) {
    if (moving_ && (b == 0 || batches.block[b] != batches.block[b - 1])) {
      const double begin_s = seconds_between(stage_.zero_ns, batches.begin_ns(b));
      moving_->during(begin_s, begin_s + batches.block_ns / 1e9);
    }
    which_ = batches[b];
    aim_.set(firings_, which_, firings_.laser[which_[0]]);
    aim_.in_world(rays_);
    by_face([&](const Rays& rays, int face, RayHits& hits) { hit_world(rays, face, hits); });
    if (stage_.bodies.size()) {
      aim_.in_vehicle(rays_);
      by_face([&](const Rays& rays, int face, RayHits& hits) { hit_bodies(rays, face, hits); });
    }
    write();
  }
}

/// Have the batch's rays hit something by `hit(rays, face, hits)`: those that face the same way at a time.
template <int Width>
template <class Hit>
void FiringTracer<Width>::by_face(Hit hit) {
  constexpr double done = -1;
  const int all = aim_.rays();
  double others = 0;
  for (int n = 0; n < all; ++n) {
    face_[n] = world::facing(rays_.directions[0][n], rays_.directions[1][n], rays_.directions[2][n]);
  }
  for (int n = 0; n < all; ++n) {
    others += face_[n] == face_[0] ? 0.0 : 1.0;
  }
  if (others == 0) {
    count_ = all;
    std::iota(number_, number_ + all, 0);
    hit(rays_, static_cast<int>(face_[0]), found_);
    return;
  }
  for (int first = 0; first < all; ++first) {
    const double face = face_[first];
    if (face == done) {
      continue;
    }
    count_ = 0;
    for (int n = first; n < all; ++n) {
      if (face_[n] == face) {
        number_[count_++] = n;
        face_[n] = done;
      }
    }
    for (int n = 0; n < count_; ++n) {
      for (int axis = 0; axis < 3; ++axis) {
        gathered_.origins[axis][n] = rays_.origins[axis][number_[n]];
        gathered_.directions[axis][n] = rays_.directions[axis][number_[n]];
      }
      gathered_hits_.range_m[n] = found_.range_m[number_[n]];
      gathered_hits_.cosine[n] = found_.cosine[number_[n]];
      gathered_hits_.slot[n] = found_.slot[number_[n]];
    }
    hit(gathered_, static_cast<int>(face), gathered_hits_);
    for (int n = 0; n < count_; ++n) {
      found_.range_m[number_[n]] = gathered_hits_.range_m[n];
      found_.cosine[number_[n]] = gathered_hits_.cosine[n];
      found_.slot[number_[n]] = gathered_hits_.slot[n];
    }
  }
}

/// Have packets take the rays that face the same way: `hit(first)` for each, whose rays are from a number on.
template <int Width>
template <class Hit>
void FiringTracer<Width>::by_packet(const Rays& rays, int face, Hit hit) {
  for (int first = 0; first < count_; first += world::packet_size) {
    packet_.load(rays.origins, rays.directions, first, std::min(world::packet_size, count_ - first), face);
    hit(first);
  }
}

template <int Width>
void FiringTracer<Width>::hit_world(const Rays& rays, int face, RayHits& hits) {
  for (int n = 0; moving_ && n < count_; ++n) {
    seconds_[n] = seconds_between(stage_.zero_ns, firings_.time_ns[which_[number_[n] / Width]]);
  }
  by_packet(rays, face, [&](int first) {
    packet_.hit_ground(stage_.world.ground_m(), stage_.limit_m);
    packet_.first_hits(stage_.world.fixed());
    if (moving_) {
      moving_->hit(packet_, View<const double>(seconds_ + first, packet_.count()));
    }
    for (int n = 0; n < packet_.count(); ++n) {
      hits.slot[first + n] = packet_.slot(n);
      hits.range_m[first + n] = packet_.slot(n) == no_slot ? inf : packet_.range(n);
    }
    if (cosines_) {
      find_cosines(rays, first, hits);
    }
  });
}

/// Find the cosines of the angles at which the packet's rays hit the world.
template <int Width>
void FiringTracer<Width>::find_cosines(const Rays& rays, int first_ray, RayHits& hits) {
  const Bvh& fixed = stage_.world.fixed();
  const int last = first_ray + packet_.count();
  for (int first = first_ray; first < last;) {
    const std::int32_t slot = hits.slot[first];
    int end = first + 1;
    if (slot >= 0 && (slot >= fixed.size() || fixed.kind[slot] != world::Kind::triangle)) {
      const int n = first - first_ray;
      const Vec3 normal =
          stage_.world.normal(slot, packet_.origin(n), packet_.direction(n), packet_.range(n), seconds_[first]);
      hits.cosine[first] = cosine(rays, first, normal);
    } else {
      while (end < last && hits.slot[end] == slot) {  // neighbours hit the same plane
        ++end;
      }
      const Vec3 normal = slot >= 0 ? normals_[slot] : Vec3{0, 0, 1};
      for (int n = first; n < end; ++n) {
        hits.cosine[n] = slot == no_slot ? 1.0 : cosine(rays, n, normal);
      }
    }
    first = end;
  }
}

template <int Width>
void FiringTracer<Width>::hit_bodies(const Rays& rays, int face, RayHits& hits) {
  const Bvh& bodies = stage_.bodies;
  by_packet(rays, face, [&](int first) {
    for (int n = 0; n < packet_.count(); ++n) {
      packet_.keep(n, std::min(hits.range_m[first + n], stage_.limit_m), no_slot);
    }
    packet_.first_hits(bodies);
    for (int n = 0; n < packet_.count(); ++n) {
      const std::int32_t slot = packet_.slot(n);
      if (slot == no_slot) {
        continue;
      }
      hits.slot[first + n] = stage_.world.slots() + slot;
      hits.range_m[first + n] = packet_.range(n);
      if (cosines_) {
        const world::Kind kind = bodies.kind[slot];
        const Vec3 normal = kind == world::Kind::triangle
                                ? body_normals_[slot]
                                : world::normal_at(bodies.leaves[slot].shape, kind, packet_.origin(n),
                                                   packet_.direction(n), packet_.range(n));
        hits.cosine[first + n] = cosine(rays, first + n, normal);
      }
    }
  });
}

/// Write what the batch's rays hit.
template <int Width>
void FiringTracer<Width>::write() const {
  const Surfaces& surfaces = stage_.surfaces;
  std::int32_t object[most_rays];
  for (int n = 0; n < aim_.rays(); ++n) {
    object[n] = surfaces.object[found_.slot[n] - no_slot];
  }
  for (Index beam = 0; beam < std::ssize(which_); ++beam) {
    const Index from = beam * Width;
    const Index to = which_[beam] * Width;
    std::copy_n(found_.range_m + from, Width, hits_.range_m.data() + to);
    std::copy_n(object + from, Width, hits_.object.data() + to);
    if (cosines_) {
      std::copy_n(found_.cosine + from, Width, hits_.cosine.data() + to);
    }
    std::uint8_t* const reflectivity = hits_.reflectivity.data() + to;
    for (int ray = 0; ray < Width; ++ray) {
      reflectivity[ray] = surfaces.reflectivity[object[from + ray] - world::no_object];
    }
  }
}

}  // namespace

void trace_firings(const Stage& stage, const Firings& firings, const Hits& hits) {
  if (stage.lasers.across.size() == thin) {
    std::make_unique<FiringTracer<thin>>(stage, firings, hits)->trace();
  } else {
    std::make_unique<FiringTracer<wide>>(stage, firings, hits)->trace();
  }
}

}  // namespace lidarcfg::simulate
