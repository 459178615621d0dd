#include "world/shadow.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <utility>

#include "simd.h"
#include "world/shapes.h"

namespace lidarcfg::world {
namespace {

using Word = std::uint64_t;

constexpr double inf = std::numeric_limits<double>::infinity();
constexpr double larger_m = 1e-6;  // by which boxes are larger, for rounding
constexpr double flat = 1e-300;
constexpr double slack = 1e-3;     // of a cuboid
constexpr double within = 1e-6;    // of a triangle's height, or of a segment: what is nearer to an edge or to an end is
                                   // left to segments
constexpr double flattest = 1e-3;  // sine of the angle between a triangle and the way to its corner, from which it is
                                   // tried
constexpr int few = 8;             // targets of a row, up to which segments are quicker

/// The bits whose numbers, 0 to 63, are from start to end.
Word bits_between(double start, double end) {
  const int first = static_cast<int>(std::ceil(start > 0.0 ? std::min(start, 64.0) : 0.0));
  const int last = static_cast<int>(std::floor(end > -1.0 ? std::min(end, 63.0) : -1.0));
  return first <= last ? (~Word{0} >> (63 - last + first)) << first : 0;
}

/// An interval of x, cut down by conditions that are linear in x.
struct Interval {
  double low = -inf;
  double high = inf;

  /// Keep the part where slope x + level is not negative.
  void narrow(double slope, double level) {
    if (slope > 0.0) {
      low = std::max(low, -level / slope);
    } else if (slope < 0.0) {
      high = std::min(high, -level / slope);
    } else if (!(level >= 0.0)) {
      high = -inf;
    }
  }
};

/// The targets of a row that a triangle hides for certain from a point.
///
/// The volume of the tetrahedron that the point, the target and an edge make is linear in the target's x, and so is
/// the sum of the three; the triangle's own, with the point, is that sum times how far along the segment the hit is.
Word occluded_by_triangle(const Shape& triangle, const Vec3& origin, const TargetRow& targets) {
  const auto [ox, oy, oz] = origin;
  const double ax = triangle[0] - ox;
  const double ay = triangle[1] - oy;
  const double az = triangle[2] - oz;
  const double bx = triangle[3] - ox;
  const double by = triangle[4] - oy;
  const double bz = triangle[5] - oz;
  const double cx = triangle[6] - ox;
  const double cy = triangle[7] - oy;
  const double cz = triangle[8] - oz;
  const double px = bx - ax;
  const double py = by - ay;
  const double pz = bz - az;
  const double qx = cx - bx;
  const double qy = cy - by;
  const double qz = cz - bz;
  const double rx = ax - cx;
  const double ry = ay - cy;
  const double rz = az - cz;
  double nx = py * qz - pz * qy;
  double ny = pz * qx - px * qz;
  double nz = px * qy - py * qx;
  double height = ax * nx + ay * ny + az * nz;
  const double area = nx * nx + ny * ny + nz * nz;
  if (height * height < flattest * flattest * area * (ax * ax + ay * ay + az * az) ||
      area < sliver * sliver * (px * px + py * py + pz * pz) * (qx * qx + qy * qy + qz * qz)) {
    return 0;
  }
  const double sign = height > 0.0 ? 1.0 : -1.0;
  height = sign * height;
  nx = sign * nx;
  ny = sign * ny;
  nz = sign * nz;
  const double dy = targets.y - oy;
  const double dz = targets.z - oz;
  const double most = 1.0 - within;
  const double least = within * nx;
  const double level = within * (ny * dy + nz * dz);
  Interval x;
  x.narrow(most * nx, most * (ny * dy + nz * dz) - height);  // the hit is before the target
  x.narrow(-least, height - level);                          // and not at the point
  const auto narrow_by_edge = [&](double slope, double across) {
    x.narrow(sign * slope - least, sign * across - level);
  };
  narrow_by_edge(by * qz - bz * qy, (bz * qx - bx * qz) * dy + (bx * qy - by * qx) * dz);
  narrow_by_edge(cy * rz - cz * ry, (cz * rx - cx * rz) * dy + (cx * ry - cy * rx) * dz);
  narrow_by_edge(ay * pz - az * py, (az * px - ax * pz) * dy + (ax * py - ay * px) * dz);
  if (!(x.low <= x.high)) {
    return 0;
  }
  const double first_x = targets.first_x();
  return bits_between((x.low + ox - first_x) / targets.edge_m + slack,
                      (x.high + ox - first_x) / targets.edge_m - slack);
}

/// The slot of a triangle of the hierarchy.
bool is_triangle(const Bvh& bvh, std::int32_t slot) {
  return 0 <= slot && slot < bvh.size() && bvh.kind[slot] == Kind::triangle;
}

}  // namespace

Word behind_boxes(Rows<const double> boxes, const Vec3& origin, const TargetRow& targets) {
  using simd::Doubles;
  const auto [ox, oy, oz] = origin;
  const double first_x = targets.first_x();
  const double by = targets.y - oy;
  const double bz = targets.z - oz;
  const double steep_y = 1 / (std::abs(by) > flat ? by : flat);
  const double steep_z = 1 / (std::abs(bz) > flat ? bz : flat);
  Word word = 0;
  for (Index b = 0; b < shadow_boxes; b += simd::lanes<double>) {
    const auto edge = [&](Index row) { return simd::load<Doubles>(&boxes(row, b)); };
    const Doubles low_y = (edge(1) - oy) * steep_y;
    const Doubles high_y = (edge(4) - oy) * steep_y;
    const Doubles low_z = (edge(2) - oz) * steep_z;
    const Doubles high_z = (edge(5) - oz) * steep_z;
    const Doubles enter = simd::max(simd::min(low_y, high_y), simd::min(low_z, high_z));
    const Doubles leave = simd::min(simd::max(low_y, high_y), simd::max(low_z, high_z));
    const Doubles near = simd::max(enter, Doubles{});
    const Doubles far = simd::min(leave, Doubles{} + 1.0);
    const Doubles low = edge(0) - ox;
    const Doubles high = edge(3) - ox;
    const Doubles least = low / simd::max(low > 0.0 ? far : near, Doubles{} + flat);
    const Doubles most = high / simd::max(high > 0.0 ? near : far, Doubles{} + flat);
    for (unsigned cut = simd::bits((near <= far) & (least <= most)); cut; cut &= cut - 1) {
      const int n = std::countr_zero(cut);
      word |= bits_between((least[n] + ox - first_x) / targets.edge_m - slack,
                           (most[n] + ox - first_x) / targets.edge_m + slack);
    }
  }
  return word;
}

std::vector<double> boxes_of(const Bvh& bvh) {
  struct Part {
    Box box;
    std::int32_t child;
  };
  std::vector<Part> parts;
  const auto add_children = [&](const Node& node) {
    for (int c = 0; c < node_size; ++c) {
      Box box;
      for (int axis = 0; axis < 3; ++axis) {
        box.low[axis] = node.side[0][axis][c];
        box.high[axis] = node.side[1][axis][c];
      }
      if (box.low[0] <= box.high[0]) {
        parts.push_back({box, node.child[c]});
      }
    }
  };
  if (!bvh.nodes.empty()) {
    add_children(bvh.nodes[0]);
  }
  const auto is_smaller = [](const Part& a, const Part& b) {
    return (a.child >= 0 ? a.box.half_area() : -1.0f) < (b.child >= 0 ? b.box.half_area() : -1.0f);
  };
  while (!parts.empty() && std::ssize(parts) + node_size - 1 <= shadow_boxes) {
    const auto largest = std::max_element(parts.begin(), parts.end(), is_smaller);
    if (largest->child < 0) {
      break;
    }
    const Node& node = bvh.nodes[largest->child];
    parts.erase(largest);
    add_children(node);
  }
  std::vector<double> out(parts.empty() ? 0 : 6 * shadow_boxes);
  for (Index b = 0; b < (parts.empty() ? 0 : shadow_boxes); ++b) {
    const Box& box = parts[b % std::ssize(parts)].box;
    for (int axis = 0; axis < 3; ++axis) {
      out[axis * shadow_boxes + b] = box.low[axis] - larger_m;
      out[(3 + axis) * shadow_boxes + b] = box.high[axis] + larger_m;
    }
  }
  return out;
}

void ShadowCaster::apply(const Bvh& bvh, const TargetRow& targets, Word word, Index row, View<Word> seen) {
  const double dy = targets.y - origin_[1];
  const double dz = targets.z - origin_[2];
  bool was_cast = false;
  const auto take = [&](Packet& packet, View<const Index> numbers) {
    cast(bvh, packet, numbers, seen);
    was_cast = true;
  };
  word = without_occluded(bvh, targets, word, row, seen);
  while (word) {
    const int bit = std::countr_zero(word);
    word &= word - 1;
    const double dx = (targets.x[bit] - targets.offset_m) - origin_[0];
    if (dx == 0.0 && dy == 0.0 && dz == 0.0) {
      continue;
    }
    packer_.add(origin_, {dx, dy, dz}, row << 6 | bit, take);
    if (was_cast) {  // what hid others may hide the rest
      word = without_occluded(bvh, targets, word, row, seen);
      was_cast = false;
    }
  }
}

void ShadowCaster::flush(const Bvh& bvh, View<Word> seen) {
  packer_.finish([&](Packet& packet, View<const Index> numbers) { cast(bvh, packet, numbers, seen); });
}

/// Cast the segments of a packet, and take the targets that are hidden from `seen`.
void ShadowCaster::cast(const Bvh& bvh, Packet& packet, View<const Index> targets, View<Word> seen) {
  const int count = packet.count();
  const auto [dx, dy, dz] = packet.direction(0);
  Occluders& last = occluders_[facing(dx, dy, dz)];
  cast_count_ += count;
  packet.limit(1 - ends);
  packet.any_hits(bvh);
  for (int n = 0; n < count; ++n) {
    const std::int32_t slot = packet.slot(n);
    if (slot >= 0) {
      seen[targets[n] >> 6] &= ~(Word{1} << (targets[n] & 63));
      if (bvh.kind[slot] == Kind::triangle) {
        const auto found = std::find(last.begin(), last.end() - 1, slot);
        std::rotate(last.begin(), found, found + 1);
        last[0] = slot;
      }
    }
  }
}

/// The targets that a word names of a row, without those behind triangles that hid others lately.
Word ShadowCaster::without_occluded(const Bvh& bvh, const TargetRow& targets, Word word, Index row,
                                    View<Word> seen) const {
  if (std::popcount(word) <= few) {
    return word;
  }
  for (const bool from_end : {false, true}) {
    const int bit = from_end ? 63 - std::countl_zero(word) : std::countr_zero(word);
    const double x = targets.first_x() + targets.edge_m * bit;
    const Occluders& last = occluders_[facing(x - origin_[0], targets.y - origin_[1], targets.z - origin_[2])];
    for (const std::int32_t slot : last) {
      if (is_triangle(bvh, slot)) {
        const Word hidden = word & occluded_by_triangle(bvh.leaves[slot].shape, origin_, targets);
        word &= ~hidden;
        seen[row] &= ~hidden;
      }
    }
    if (word == 0) {
      break;
    }
  }
  return word;
}

std::int64_t ShadowCaster::take_cast_count() { return std::exchange(cast_count_, 0); }

}  // namespace lidarcfg::world
