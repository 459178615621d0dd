#include "world/world.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <stdexcept>

#include "world/shapes.h"

namespace lidarcfg::world {
namespace {

constexpr double larger = 1 + 1e-9;  // by which spheres around objects are, for rounding
constexpr double slack_m = 1e-9;

/// The radius of the sphere around the origin that holds shapes.
double radius_m(const Bvh& bvh) {
  double out = 0;
  for (Index s = 0; s < bvh.size(); ++s) {
    const Shape& shape = bvh.leaves[s].shape;
    if (bvh.kind[s] == Kind::triangle) {
      for (int c = 0; c < 9; c += 3) {
        out = std::max(out, std::hypot(shape[c], shape[c + 1], shape[c + 2]));
      }
    } else if (bvh.kind[s] == Kind::cylinder) {
      out = std::max(out, std::hypot(std::hypot(shape[0], shape[1]) + shape[3], std::abs(shape[2]) + shape[4]));
    } else {
      out = std::max(out, std::hypot(shape[0], shape[1], shape[2]) + shape[3]);
    }
  }
  return out;
}

}  // namespace

Moving::Ray Moving::brought(const Pose& pose, const Vec3& origin, const Vec3& direction) const {
  const Vec3 from{origin[0] - place_m[0] - pose.t[0], origin[1] - place_m[1] - pose.t[1],
                  origin[2] - place_m[2] - pose.t[2]};
  return {transpose_times(pose.R, from), transpose_times(pose.R, direction)};
}

World::World(double ground_m, Bvh fixed, std::vector<Moving> moving)
    : ground_m_(ground_m), fixed_(std::move(fixed)), moving_(std::move(moving)) {
  Index slots = fixed_.size();
  for (Moving& one : moving_) {
    one.first_slot = static_cast<std::int32_t>(slots);
    one.radius_m = radius_m(one.bvh);
    slots += one.bvh.size();
    if (slots > std::numeric_limits<std::int32_t>::max()) {
      throw std::invalid_argument("moving: more than 2^31 shapes");
    }
  }
  slots_ = static_cast<std::int32_t>(slots);
}

World World::along(View<const double> speeds_m_s, std::vector<Path> paths) const {
  World out = *this;
  for (std::size_t p = 0; p < paths.size(); ++p) {
    out.moving_[p].speed_m_s = speeds_m_s[p];
    out.moving_[p].path = std::move(paths[p]);
  }
  return out;
}

const Moving& World::moving_at(std::int32_t slot) const {
  const auto after = std::upper_bound(moving_.begin(), moving_.end(), slot,
                                      [](std::int32_t one, const Moving& object) { return one < object.first_slot; });
  return *(after - 1);
}

Vec3 World::normal(std::int32_t slot, const Vec3& origin, const Vec3& direction, double range_m, double seconds) const {
  if (slot < 0) {
    return {0, 0, 1};
  }
  if (slot < fixed_.size()) {
    return normal_at(fixed_.leaves[slot].shape, fixed_.kind[slot], origin, direction, range_m);
  }
  const Moving& object = moving_at(slot);
  const Pose pose = object.path.at(seconds);
  const auto [start, way] = object.brought(pose, origin, direction);
  const std::int32_t s = slot - object.first_slot;
  return times(pose.R, normal_at(object.bvh.leaves[s].shape, object.bvh.kind[s], start, way, range_m));
}

void World::write(const Packet& packet, View<const double> seconds, View<const Index> rows, const Found& found) const {
  const bool normals = !found.normal.empty();
  const bool cosines = !found.cosine.empty();
  for (int n = 0; n < packet.count(); ++n) {
    const std::int32_t slot = packet.slot(n);
    const Index row = rows[n];
    found.slot[row] = slot;
    found.range_m[row] = slot == no_slot ? std::numeric_limits<double>::infinity() : packet.range(n);
    if (!normals && !cosines) {
      continue;
    }
    if (slot == no_slot) {
      if (cosines) {
        found.cosine[row] = 1;
      }
      continue;
    }
    const Vec3 way = packet.direction(n);
    const Vec3 across = normal(slot, packet.origin(n), way, packet.range(n), seconds[n]);
    if (normals) {
      found.normal[row] = across;
    }
    if (cosines) {
      found.cosine[row] = std::abs(across[0] * way[0] + across[1] * way[1] + across[2] * way[2]);
    }
  }
}

std::int32_t World::object(std::int32_t slot) const {
  if (slot < 0) {
    return slot == ground_slot ? 0 : no_object;
  }
  if (slot < fixed_.size()) {
    return fixed_.object[slot];
  }
  const Moving& object = moving_at(slot);
  return object.bvh.object[slot - object.first_slot];
}

std::int32_t World::triangle(std::int32_t slot) const {
  if (slot < 0) {
    return no_object;
  }
  if (slot < fixed_.size()) {
    return fixed_.number[slot];
  }
  const Moving& object = moving_at(slot);
  return object.bvh.number[slot - object.first_slot];
}

void MovingTracer::during(double first_s, double last_s) {
  const auto count = static_cast<std::int32_t>(world_.moving().size());
  const double middle_s = (first_s + last_s) / 2;
  const double half_s = (last_s - first_s) / 2;
  std::vector<Shape> shapes(count, Shape{});
  std::vector<std::int32_t> number(count);
  for (std::int32_t p = 0; p < count; ++p) {
    const Moving& object = world_.moving()[p];
    const Pose pose = object.path.at(middle_s);
    for (int axis = 0; axis < 3; ++axis) {
      shapes[p][axis] = object.place_m[axis] + pose.t[axis];
    }
    shapes[p][3] = (object.radius_m + object.speed_m_s * half_s) * larger + slack_m;
    number[p] = p;
  }
  swept_ = build(shapes, std::vector<Kind>(count, Kind::instance), number, number);
}

void MovingTracer::hit(Packet& packet, View<const double> seconds) {
  near_.clear();
  packet.list_near(swept_, near_);
  for (const std::int32_t p : near_) {
    hit_object(world_.moving()[p], packet, seconds);
  }
}

void MovingTracer::hit_object(const Moving& object, Packet& packet, View<const double> seconds) {
  const double radius_m = object.radius_m * larger + slack_m;
  const auto take = [&](Packet& brought, View<const Index> rays) {
    for (int n = 0; n < brought.count(); ++n) {
      const int ray = static_cast<int>(rays[n]);
      brought.keep(n, packet.range(ray), packet.slot(ray));
    }
    brought.first_hits(object.bvh, object.first_slot);
    for (int n = 0; n < brought.count(); ++n) {
      packet.keep(static_cast<int>(rays[n]), brought.range(n), brought.slot(n));
    }
  };
  for (int n = 0; n < packet.count(); ++n) {
    const auto [start, way] = object.brought(object.path.at(seconds[n]), packet.origin(n), packet.direction(n));
    const double ahead = -(start[0] * way[0] + start[1] * way[1] + start[2] * way[2]);
    const double u = start[0] + ahead * way[0];
    const double v = start[1] + ahead * way[1];
    const double w = start[2] + ahead * way[2];
    const bool beside = u * u + v * v + w * w > radius_m * radius_m;
    if (!(beside || ahead < -radius_m || ahead - radius_m > packet.range(n))) {
      packer_.add(start, way, n, take);
    }
  }
  packer_.finish(take);
}

void cast(const World& world, Rows<const double> origins, Rows<const double> directions, View<const double> seconds,
          double limit_m, const Found& found) {
  Packet packet;
  const bool moves = !world.moving().empty();
  const auto tracer = moves && !seconds.empty() ? std::make_unique<MovingTracer>(world) : nullptr;
  if (tracer) {
    const auto [first, last] = std::minmax_element(seconds.begin(), seconds.end());
    tracer->during(*first, *last);
  }
  for (Index first = 0; first < std::ssize(seconds);) {
    const auto [count, face] = alike(directions, first, std::ssize(seconds));
    const View<const double> when = seconds.subspan(first, count);
    packet.load(origins, directions, first, count, face);
    packet.hit_ground(world.ground_m(), limit_m);
    packet.first_hits(world.fixed());
    if (tracer) {
      tracer->hit(packet, when);
    }
    std::array<Index, packet_size> rows;
    for (int n = 0; n < count; ++n) {
      rows[n] = first + n;
    }
    world.write(packet, when, rows, found);
    first += count;
  }
}

}  // namespace lidarcfg::world
