#include "simulate/trace.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <optional>

#include "world/shapes.h"

namespace lidarcfg::simulate {
namespace {

using world::Bvh;
using world::no_slot;

constexpr double inf = std::numeric_limits<double>::infinity();
constexpr std::int64_t block_ns = 50'000'000;  // for which moving objects are held by the same spheres

double cosine(const Vec3& normal, const Vec3& direction) {
  return std::abs(normal[0] * direction[0] + normal[1] * direction[1] + normal[2] * direction[2]);
}

/// The unit normals of a hierarchy's shapes; that of a triangle is known if it was asked for last.
class Normals {
 public:
  explicit Normals(const Bvh& bvh) : bvh_(bvh) {}

  const Vec3& at(std::int32_t slot, const Vec3& origin, const Vec3& direction, double range_m) {
    if (slot != known_) {
      const world::Kind kind = bvh_.kind[slot];
      normal_ = world::normal_at(bvh_.leaves[slot].shape, kind, origin, direction, range_m);
      known_ = kind == world::Kind::triangle ? slot : no_slot;
    }
    return normal_;
  }

 private:
  const Bvh& bvh_;
  std::int32_t known_ = no_slot;
  Vec3 normal_;
};

/// Traces firings, batch by batch.
template <class Packet>
class FiringTracer {
 public:
  FiringTracer(const Stage& stage, const Firings& firings, const Hits& hits)
      : stage_(stage),
        firings_(firings),
        hits_(hits),
        width_(static_cast<int>(stage.lasers.across.size())),
        cosines_(hits.cosine.rows() > 0),
        aim_(stage.lasers, stage.mounting),
        fixed_normals_(stage.world.fixed()),
        body_normals_(stage.bodies) {}

  void trace();

 private:
  template <class Take>
  void by_face(Take take);
  void hit_world(const Rays& rays, int face);
  void hit_bodies(const Rays& rays, int face);
  void write() const;

  const Stage& stage_;
  const Firings& firings_;
  const Hits& hits_;
  const int width_;  // rays of a beam
  const bool cosines_;
  Aim aim_;
  std::optional<world::MovingTracer> moving_;
  Normals fixed_normals_;
  Normals body_normals_;

  View<const Index> which_;    // firings of the batch
  Rays rays_;                  // of the batch
  int face_[most_rays];        // what they face
  double range_m_[most_rays];  // what they hit
  std::int32_t slot_[most_rays];
  double cosine_[most_rays];

  Packet packet_;
  int count_;                  // rays of the batch in the packet
  int number_[most_rays];      // which they are
  double seconds_[most_rays] = {};  // when they start, if anything moves
  Rays gathered_;              // they
};

template <class Packet>
void FiringTracer<Packet>::trace() {
  const bool moves = !stage_.world.moving().empty();
  const Batches batches = divide(firings_, most_beams, moves ? block_ns : 0);
  if (moves) {
    moving_.emplace(stage_.world);
  }
  for (Index b = 0; b < batches.count(); ++b) {
    if (moves && (b == 0 || batches.block[b] != batches.block[b - 1])) {
      const std::int64_t begin_ns = batches.zero_ns + batches.block[b] * batches.block_ns;
      const double begin_s = seconds_between(stage_.zero_ns, begin_ns);
      moving_->during(begin_s, begin_s + batches.block_ns / 1e9);
    }
    which_ = batches[b];
    aim_.set(firings_, which_, firings_.laser[which_[0]]);
    aim_.in_world(rays_);
    by_face([&](const Rays& rays, int face) { hit_world(rays, face); });
    if (stage_.bodies.size()) {
      aim_.in_vehicle(rays_);
      by_face([&](const Rays& rays, int face) { hit_bodies(rays, face); });
    }
    write();
  }
}

/// Hand on the batch's rays, those that face the same way together, with what they face.
template <class Packet>
template <class Take>
void FiringTracer<Packet>::by_face(Take take) {
  constexpr int done = -1;
  const int count = aim_.rays();
  bool same = true;
  for (int n = 0; n < count; ++n) {
    face_[n] = world::facing(rays_.directions[0][n], rays_.directions[1][n], rays_.directions[2][n]);
    same &= face_[n] == face_[0];
  }
  for (int first = 0; first < count; ++first) {
    const int face = face_[first];
    if (face == done) {
      continue;
    }
    count_ = 0;
    for (int n = first; n < count; ++n) {
      if (face_[n] == face) {
        number_[count_++] = n;
        face_[n] = done;
      }
    }
    if (same) {
      take(rays_, face);
      return;
    }
    for (int axis = 0; axis < 3; ++axis) {
      for (int n = 0; n < count_; ++n) {
        gathered_.origins[axis][n] = rays_.origins[axis][number_[n]];
        gathered_.directions[axis][n] = rays_.directions[axis][number_[n]];
      }
    }
    take(gathered_, face);
  }
}

template <class Packet>
void FiringTracer<Packet>::hit_world(const Rays& rays, int face) {
  const world::World& world = stage_.world;
  packet_.load(rays.origins, rays.directions, 0, count_, face);
  packet_.hit_ground(world.ground_m(), stage_.limit_m);
  packet_.first_hits(world.fixed());
  if (moving_) {
    for (int n = 0; n < count_; ++n) {
      seconds_[n] = seconds_between(stage_.zero_ns, firings_.time_ns[which_[number_[n] / width_]]);
    }
    moving_->hit(packet_, View<const double>(seconds_, count_));
  }
  for (int n = 0; n < count_; ++n) {
    const std::int32_t slot = packet_.slot(n);
    slot_[number_[n]] = slot;
    range_m_[number_[n]] = slot == no_slot ? inf : packet_.range(n);
  }
  for (int n = 0; n < (cosines_ ? count_ : 0); ++n) {
    const std::int32_t slot = packet_.slot(n);
    const Vec3 way = packet_.direction(n);
    double& out = cosine_[number_[n]];
    if (slot == no_slot) {
      out = 1;
    } else if (0 <= slot && slot < world.fixed().size()) {
      out = cosine(fixed_normals_.at(slot, packet_.origin(n), way, packet_.range(n)), way);
    } else {
      out = cosine(world.normal(slot, packet_.origin(n), way, packet_.range(n), seconds_[n]), way);
    }
  }
}

template <class Packet>
void FiringTracer<Packet>::hit_bodies(const Rays& rays, int face) {
  packet_.load(rays.origins, rays.directions, 0, count_, face);
  for (int n = 0; n < count_; ++n) {
    packet_.keep(n, std::min(range_m_[number_[n]], stage_.limit_m), no_slot);
  }
  packet_.first_hits(stage_.bodies);
  for (int n = 0; n < count_; ++n) {
    const std::int32_t slot = packet_.slot(n);
    if (slot == no_slot) {
      continue;
    }
    const Vec3 way = packet_.direction(n);
    slot_[number_[n]] = stage_.world.slots() + slot;
    range_m_[number_[n]] = packet_.range(n);
    cosine_[number_[n]] = cosine(body_normals_.at(slot, packet_.origin(n), way, packet_.range(n)), way);
  }
}

template <class Packet>
void FiringTracer<Packet>::write() const {
  const Surfaces& surfaces = stage_.surfaces;
  int from = 0;
  for (const Index firing : which_) {
    for (int ray = 0; ray < width_; ++ray, ++from) {
      const std::int32_t surface = slot_[from] - no_slot;
      hits_.range_m(firing, ray) = range_m_[from];
      hits_.reflectivity(firing, ray) = surfaces.reflectivity[surface];
      hits_.object(firing, ray) = surfaces.object[surface];
      if (cosines_) {
        hits_.cosine(firing, ray) = cosine_[from];
      }
    }
  }
}

}  // namespace

void trace_firings(const Stage& stage, const Firings& firings, const Hits& hits) {
  if (stage.lasers.across.size() == 1) {
    std::make_unique<FiringTracer<world::Packet>>(stage, firings, hits)->trace();
  } else {
    std::make_unique<FiringTracer<world::WidePacket>>(stage, firings, hits)->trace();
  }
}

}  // namespace lidarcfg::simulate
