#include "world/packet.h"

#include <algorithm>
#include <bit>
#include <limits>

#include "world/descent.h"
#include "world/shapes.h"

namespace lidarcfg::world {
namespace {

using namespace simd;

constexpr double farthest_ground_m = 3e38f;
constexpr double infinity = std::numeric_limits<double>::infinity();

/// The row of an axis: the last one that of the largest component.
int row_of(int axis, int face) { return (axis + 5 - (face & 3)) % 3; }

/// Have the memory of a subtree's top fetched, which is wanted soon.
void prefetch(const Bvh& bvh, std::int32_t code) {
  const void* const at = code >= 0 ? static_cast<const void*>(&bvh.nodes[code]) : &bvh.leaves[LeafCode(code).first()];
  for (int line = 0; line < 3; ++line) {
    __builtin_prefetch(static_cast<const char*>(at) + 64 * line);
  }
}

/// A side of an interval of origins, moved outwards by more than what float32 rounds.
float outward(double at, bool down) {
  const double wide = std::abs(at) < infinity ? std::abs(at) * wider + pad_m : 0;
  return static_cast<float>(down ? at - wide : at + wide);
}

/// Combine what each of several vectors has in its lanes: a value for each vector.
template <class V, class Combine>
V by_vector(const V* rows, Combine combine) {
  if constexpr (lanes<double> == 4) {
    const auto pairs = [&](V one, V other) {
      return combine(__builtin_shufflevector(one, other, 0, 4, 2, 6), __builtin_shufflevector(one, other, 1, 5, 3, 7));
    };
    const V left = pairs(rows[0], rows[1]);
    const V right = pairs(rows[2], rows[3]);
    return combine(__builtin_shufflevector(left, right, 0, 1, 4, 5), __builtin_shufflevector(left, right, 2, 3, 6, 7));
  } else {
    return combine(__builtin_shufflevector(rows[0], rows[1], 0, 2), __builtin_shufflevector(rows[0], rows[1], 1, 3));
  }
}

/// The same of groups of rays, from a row on, whose values `take` takes.
template <class Take, class Combine>
Doubles by_group(const double* row, Take take, Combine combine) {
  Doubles rows[lanes<double>];
  for (int g = 0; g < lanes<double>; ++g) {
    rows[g] = take(load<Doubles>(row + g * lanes<double>));
  }
  return by_vector(rows, combine);
}

/// A value, but another if it is infinite or no number.
Doubles finite_or(Doubles values, double other) { return values - values == 0 ? values : Doubles{} + other; }

Doubles lowest_by_group(const double* row) {
  return by_group(
      row, [](Doubles values) { return finite_or(values, infinity); }, [](Doubles a, Doubles b) { return min(a, b); });
}

Doubles highest_by_group(const double* row) {
  return by_group(
      row, [](Doubles values) { return finite_or(values, -infinity); }, [](Doubles a, Doubles b) { return max(a, b); });
}

/// The farthest of ranges, but not farther than `farthest`.
Doubles range_by_group(const double* row) {
  return by_group(
      row, [](Doubles values) { return min(values, Doubles{} + farthest); },
      [](Doubles a, Doubles b) { return max(a, b); });
}

/// Which of several directions in a row face another way.
auto other_facing(int face, const double* from_x, const double* from_y, const double* from_z) {
  const Doubles dx = load<Doubles>(from_x);
  const Doubles dy = load<Doubles>(from_y);
  const Doubles dz = load<Doubles>(from_z);
  const Doubles x = dx < 0 ? -dx : dx;
  const Doubles y = dy < 0 ? -dy : dy;
  const Doubles z = dz < 0 ? -dz : dz;
  const Doubles zero{};
  const Doubles largest = ((z >= x) & (z >= y)) ? zero + 2 : (y >= x ? zero + 1 : zero);
  const Doubles octant = (dx < 0 ? zero + 4 : zero) + (dy < 0 ? zero + 8 : zero) + (dz < 0 ? zero + 16 : zero);
  return largest + octant != face;
}

}  // namespace

void Packet::load(Rows<const double> origins, Rows<const double> directions, Index first, int count, int face) {
  count_ = count;
  face_ = face;
  const int per_chunk = chunk * group_size;
  groups_ = (count + per_chunk - 1) / per_chunk * chunk;
  for (int axis = 0; axis < 3; ++axis) {
    const int row = row_of(axis, face);
    axis_[row] = axis;
    const double* const from = origins[axis].data() + first;
    const double* const way = directions[axis].data() + first;
    std::copy(from, from + count, origin_[row]);
    std::copy(way, way + count, direction_[row]);
    std::fill(origin_[row] + count, origin_[row] + groups_ * group_size, from[count - 1]);
    std::fill(direction_[row] + count, direction_[row] + groups_ * group_size, way[count - 1]);
  }
  bound();
  span_fan();
  sheared_ = false;
}

/// Find the intervals that hold the rays, but for what is infinite or no number: a ray that has that hits no shape.
void Packet::bound() {
  for (int row = 0; row < 3; ++row) {
    const int axis = axis_[row];
    const bool negative = face_ >> (2 + axis) & 1;
    const float way = negative ? -1 : 1;
    double low[most_groups];
    double high[most_groups];
    double flat[most_groups];  // the least and the greatest component of directions
    double steep[most_groups];
    for (int g = 0; g < groups_; g += lanes<double>) {
      const double* const from = origin_[row] + g * group_size;
      const double* const along = direction_[row] + g * group_size;
      store(low + g, lowest_by_group(from));
      store(high + g, highest_by_group(from));
      store(flat + g, negative ? -highest_by_group(along) : lowest_by_group(along));
      store(steep + g, negative ? -lowest_by_group(along) : highest_by_group(along));
    }
    float near_origin = -way * static_cast<float>(infinity);
    float near_inverse = farthest;
    float far_inverse = 0;
    double all_low = infinity;
    double all_high = -infinity;
    for (int g = 0; g < groups_; ++g) {
      const float least = 1 / std::max(static_cast<float>(steep[g]), flattest) * (1 - wider);
      const float most = 1 / std::max(static_cast<float>(flat[g]), flattest) * (1 + wider);
      const bool none = !(low[g] <= high[g] && flat[g] < infinity);
      const float entry = none ? -way * static_cast<float>(infinity) : outward(negative ? low[g] : high[g], negative);
      near_origin_[axis][g] = entry;
      far_origin_[axis][g] = outward(negative ? high[g] : low[g], !negative);
      near_inverse_[axis][g] = way * least;
      far_inverse_[axis][g] = way * most;
      near_origin = negative ? std::min(near_origin, entry) : std::max(near_origin, entry);
      near_inverse = std::min(near_inverse, least);
      far_inverse = std::max(far_inverse, most);
      all_low = std::min(all_low, low[g]);
      all_high = std::max(all_high, high[g]);
    }
    sign_[axis] = negative;
    near_.inverse[axis] = way * near_inverse;
    far_.inverse[axis] = way * far_inverse;
    near_.origin[axis] = near_origin;
    far_.origin[axis] = outward(negative ? all_high : all_low, !negative);
  }
}

void Packet::span_fan() {
  const int last = count_ - 1;
  double normal[3];
  double square = 0;
  for (int row = 0; row < 3; ++row) {
    const int i = (row + 1) % 3;
    const int j = (row + 2) % 3;
    normal[row] = direction_[i][0] * direction_[j][last] - direction_[j][0] * direction_[i][last];
    square += normal[row] * normal[row];
  }
  const bool flat = !(square > 0 && square < infinity);  // no plane
  for (int row = 0; row < 3; ++row) {
    const float one = flat ? 0.0f : static_cast<float>(normal[row] / std::sqrt(square));
    fan_.normal[axis_[row]] = one;
    normal[row] = one;
  }
  Doubles low = Doubles{} + infinity;
  Doubles high = Doubles{} - infinity;
  Doubles dip{};
  Doubles rise{};
  const auto along = [&](const Lanes(&rows)[3], int n) {
    return normal[0] * simd::load<Doubles>(rows[0] + n) + normal[1] * simd::load<Doubles>(rows[1] + n) +
           normal[2] * simd::load<Doubles>(rows[2] + n);
  };
  for (int n = 0; n < groups_ * group_size; n += group_size) {
    const Doubles start = along(origin_, n);
    const Doubles way = along(direction_, n);
    low = min(start, low);  // the second, if the first is no number
    high = max(start, high);
    dip = min(way, dip);
    rise = max(way, rise);
  }
  fan_.low = static_cast<float>(-highest(-low));
  fan_.high = static_cast<float>(highest(high));
  fan_.dip = static_cast<float>(-highest(-dip)) * (1 + wider);
  fan_.rise = static_cast<float>(highest(rise)) * (1 + wider);
}

void Packet::limit(double range) {
  std::fill(range_, range_ + groups_ * group_size, range);
  std::fill(slot_, slot_ + groups_ * group_size, no_slot);
}

void Packet::hit_ground(double ground_m, double limit_m) {
  const int row = row_of(2, face_);
  for (int n = 0; n < groups_ * group_size; n += group_size) {
    const Doubles far = (ground_m - simd::load<Doubles>(origin_[row] + n)) / simd::load<Doubles>(direction_[row] + n);
    const auto ground = (far > 0) & (far <= limit_m) & (far < farthest_ground_m);
    store(range_ + n, ground ? far : Doubles{} + limit_m);
    store(slot_ + n, ground ? Doubles{} + ground_slot : Doubles{} + no_slot);
  }
}

/// Find how far boxes matter, and what turns each ray into an axis.
void Packet::begin() {
  std::fill(range_ + count_, range_ + groups_ * group_size, -1.0);  // the rest of a packet is nowhere
  std::fill(slot_ + count_, slot_ + groups_ * group_size, no_slot);
  for (int g = 0; g < groups_; g += chunk) {
    shorten(g);
  }
  if (!sheared_) {
    for (int n = 0; n < groups_ * group_size; n += group_size) {
      const Doubles ahead = simd::load<Doubles>(direction_[2] + n);
      store(shear_[0] + n, simd::load<Doubles>(direction_[0] + n) / ahead);
      store(shear_[1] + n, simd::load<Doubles>(direction_[1] + n) / ahead);
      store(shear_[2] + n, 1 / ahead);
    }
    sheared_ = true;
  }
}

/// Have boxes tested up to what the groups of a chunk have hit.
void Packet::shorten(int first_group) {
  double far[chunk];
  for (int g = 0; g < chunk; g += lanes<double>) {
    store(far + g, range_by_group(range_ + (first_group + g) * group_size));
  }
  for (int g = 0; g < chunk; ++g) {
    group_most_[first_group + g] = static_cast<float>(far[g]) * (1 + wider);
  }
  Floats most = simd::load<Floats>(group_most_);
  for (int g = chunk; g < groups_; g += chunk) {
    most = max(most, simd::load<Floats>(group_most_ + g));
  }
  most_ = highest(most);
}

/// Which children of a node the packet may be in, as bits, and from where on.
unsigned Packet::enter(const Node& node, float slack_m, float* near) const {
  unsigned found = 0;
  for (int c = 0; c < node_size; c += lanes<float>) {
    Floats enters{};
    Floats leaves = Floats{} + most_;
    for (int axis = 0; axis < 3; ++axis) {
      const Floats entry = simd::load<Floats>(node.side[sign_[axis]][axis] + c);
      const Floats exit = simd::load<Floats>(node.side[!sign_[axis]][axis] + c);
      enters = max((entry - near_.origin[axis]) * near_.inverse[axis], enters);
      leaves = min((exit - far_.origin[axis]) * far_.inverse[axis], leaves);
    }
    Floats highest = Floats{} + (slack_m - fan_.low);
    Floats lowest = Floats{} - (slack_m + fan_.high);
    for (int axis = 0; axis < 3; ++axis) {
      const float normal = fan_.normal[axis];
      highest += normal * simd::load<Floats>(node.side[normal > 0][axis] + c);
      lowest += normal * simd::load<Floats>(node.side[!(normal > 0)][axis] + c);
    }
    store(near + c, enters);
    found |= bits((enters <= leaves) & (highest >= fan_.dip * leaves) & (lowest <= fan_.rise * leaves)) << c;
  }
  return found;
}

/// Which groups of a chunk may be in a box, as bits.
unsigned Packet::groups_at(const Box& box, int g) const {
  Floats enters{};
  Floats leaves = simd::load<Floats>(group_most_ + g);
  for (int axis = 0; axis < 3; ++axis) {
    const float entry = sign_[axis] ? box.high[axis] : box.low[axis];
    const float exit = sign_[axis] ? box.low[axis] : box.high[axis];
    const Floats near = entry - simd::load<Floats>(near_origin_[axis] + g);
    const Floats far = exit - simd::load<Floats>(far_origin_[axis] + g);
    enters = max(near * simd::load<Floats>(near_inverse_[axis] + g), enters);
    leaves = min(far * simd::load<Floats>(far_inverse_[axis] + g), leaves);
  }
  return bits(enters <= leaves);
}

/// Keep a triangle where some groups of a chunk hit it first; returns whether any does.
bool Packet::hit_triangle(const Shape& shape, double slot, double after, int first_group, unsigned which) {
  const auto& [i, j, k] = axis_;
  const Vec3 a{shape[i], shape[j], shape[k]};
  const Vec3 b{shape[3 + i], shape[3 + j], shape[3 + k]};
  const Vec3 c{shape[6 + i], shape[6 + j], shape[6 + k]};
  Vec3 across{};
  bool across_known = false;
  bool found = false;
  for (; which; which &= which - 1) {
    const int n = (first_group + std::countr_zero(which)) * group_size;
    const Doubles ox = simd::load<Doubles>(origin_[0] + n);
    const Doubles oy = simd::load<Doubles>(origin_[1] + n);
    const Doubles oz = simd::load<Doubles>(origin_[2] + n);
    const Doubles sx = simd::load<Doubles>(shear_[0] + n);
    const Doubles sy = simd::load<Doubles>(shear_[1] + n);
    const Doubles az = a[2] - oz;  // the corners as seen along the ray
    const Doubles bz = b[2] - oz;
    const Doubles cz = c[2] - oz;
    const Doubles ax = (a[0] - ox) - sx * az;
    const Doubles ay = (a[1] - oy) - sy * az;
    const Doubles bx = (b[0] - ox) - sx * bz;
    const Doubles by = (b[1] - oy) - sy * bz;
    const Doubles cx = (c[0] - ox) - sx * cz;
    const Doubles cy = (c[1] - oy) - sy * cz;
    const Doubles u = cx * by - cy * bx;
    const Doubles v = ax * cy - ay * cx;
    const Doubles w = bx * ay - by * ax;
    const Doubles low = min(min(u, v), w);
    const Doubles high = max(max(u, v), w);
    auto hit = ((low >= 0) | (high <= 0)) & ((high > low) | (high != 0));
    if (!any(hit)) {
      continue;
    }
    if (!across_known) {
      across = normal(a, b, c);
      across_known = true;
    }
    const auto [nx, ny, nz] = across;
    const Doubles dx = simd::load<Doubles>(direction_[0] + n);
    const Doubles dy = simd::load<Doubles>(direction_[1] + n);
    const Doubles dz = simd::load<Doubles>(direction_[2] + n);
    const Doubles sz = simd::load<Doubles>(shear_[2] + n);
    const Doubles along = nx * dx + ny * dy + nz * dz;
    const Doubles as = az * sz;
    const Doubles bs = bz * sz;
    const Doubles cs = cz * sz;
    Doubles far = (nx * (a[0] - ox) + ny * (a[1] - oy) + nz * (a[2] - oz)) / (along == 0 ? Doubles{} + tiny : along);
    far = min(max(far, min(min(as, bs), cs)), max(max(as, bs), cs));  // no nearer or farther than the corners
    const Doubles nearest = simd::load<Doubles>(range_ + n);
    const Doubles known = simd::load<Doubles>(slot_ + n);
    hit &= (far > after) & ((far < nearest) | ((far == nearest) & (slot < known)));
    store(range_ + n, hit ? far : nearest);
    store(slot_ + n, hit ? Doubles{} + slot : known);
    found |= any(hit);
  }
  return found;
}

/// The same of a sphere or a cylinder.
bool Packet::hit_round(const Shape& shape, Kind kind, double slot, double after, int first_group, unsigned which) {
  bool found = false;
  for (; which; which &= which - 1) {
    const int first = (first_group + std::countr_zero(which)) * group_size;
    for (int n = first; n < first + group_size; ++n) {
      Vec3 way = direction(n);
      double length = 1;
      if (after != 0) {  // a segment
        length = std::sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
        way = {way[0] / length, way[1] / length, way[2] / length};
      }
      const double far = round_range(shape, kind, origin(n), way) / length;
      if (far > after && (far < range_[n] || (far == range_[n] && slot < slot_[n]))) {
        range_[n] = far;
        slot_[n] = slot;
        found = true;
      }
    }
  }
  return found;
}

bool Packet::hit(const Shape& shape, Kind kind, double slot, double after, int first_group, unsigned which) {
  return kind == Kind::triangle ? hit_triangle(shape, slot, after, first_group, which)
                                : hit_round(shape, kind, slot, after, first_group, which);
}

/// Visit the leaves that the packet may be in, nearest first: `visit(leaf)`. Returns false if it gives up after a
/// number of nodes and leaves.
template <class Visit>
bool Packet::walk(const Bvh& bvh, Index most, Visit visit) {
  if (bvh.nodes.empty()) {
    return true;
  }
  begin();
  const float slack_m = 2e-6f * (bvh.reach_m + std::abs(fan_.low) + std::abs(fan_.high));  // for float32
  Waiting stack[stack_size];
  Waiting* top = stack;
  *top++ = {0, 0};
  while (top > stack) {
    const auto [near, code] = *--top;
    if (near > most_) {
      continue;
    }
    if (most-- == 0) {
      return false;
    }
    if (code < 0) {
      visit(LeafCode(code));
      continue;
    }
    const Node& node = bvh.nodes[code];
    alignas(32) float enters[node_size];
    Waiting* const base = top;
    for (unsigned children = enter(node, slack_m, enters); children; children &= children - 1) {
      const int c = std::countr_zero(children);
      Waiting* at = top++;
      for (; at > base && at[-1].near < enters[c]; --at) {  // the nearest comes first
        at[0] = at[-1];
      }
      *at = {enters[c], node.child[c]};
      prefetch(bvh, node.child[c]);
    }
  }
  return true;
}

/// Have rays that hit anything end before everything.
void Packet::end_hit() {
  for (int n = 0; n < groups_ * group_size; ++n) {
    range_[n] = slot_[n] >= 0 ? -1 : range_[n];
  }
}

template <bool Any>
void Packet::hits(const Bvh& bvh, std::int32_t first_slot) {
  const Index most = count_ > 1 ? 128 + 12 * count_ : std::numeric_limits<Index>::max();
  const bool done = walk(bvh, most, [&](LeafCode leaf) {
    for (std::int32_t s = leaf.first(); s < leaf.end(); ++s) {
      const Kind kind = leaf.mixed() ? bvh.kind[s] : Kind::triangle;
      const double slot = static_cast<double>(first_slot) + s;
      for (int g = 0; g < groups_; g += chunk) {
        const unsigned which = groups_at(bvh.leaves[s].box, g);
        if (which && hit(bvh.leaves[s].shape, kind, slot, Any ? ends : 0.0, g, which)) {
          if constexpr (Any) {
            end_hit();
          }
          shorten(g);
        }
      }
    }
  });
  if (!done) {
    in_pieces<Any>(bvh, first_slot);
  }
}

/// The same for packets of fewer rays: these are not near each other, so that they are faster alone.
template <bool Any>
void Packet::in_pieces(const Bvh& bvh, std::int32_t first_slot) {
  double origins[3][packet_size];
  double directions[3][packet_size];
  for (int row = 0; row < 3; ++row) {
    std::copy(origin_[row], origin_[row] + count_, origins[axis_[row]]);
    std::copy(direction_[row], direction_[row] + count_, directions[axis_[row]]);
  }
  const int size = count_ > 4 ? 4 : 1;
  Packet piece;
  for (int first = 0; first < count_; first += size) {
    piece.load({origins[0], 3, packet_size}, {directions[0], 3, packet_size}, first, std::min(size, count_ - first),
               face_);
    for (int n = 0; n < piece.count(); ++n) {
      piece.keep(n, range_[first + n], slot(first + n));
    }
    if constexpr (Any) {
      piece.any_hits(bvh);
    } else {
      piece.first_hits(bvh, first_slot);
    }
    for (int n = 0; n < piece.count(); ++n) {
      keep(first + n, piece.range(n), piece.slot(n));
    }
  }
}

void Packet::first_hits(const Bvh& bvh, std::int32_t first_slot) { hits<false>(bvh, first_slot); }

void Packet::any_hits(const Bvh& bvh) { hits<true>(bvh, 0); }

void Packet::list_near(const Bvh& bvh, std::vector<std::int32_t>& numbers) {
  walk(bvh, std::numeric_limits<Index>::max(), [&](LeafCode leaf) {
    for (std::int32_t s = leaf.first(); s < leaf.end(); ++s) {
      unsigned near = 0;
      for (int g = 0; g < groups_; g += chunk) {
        near |= groups_at(bvh.leaves[s].box, g);
      }
      if (near) {
        numbers.push_back(bvh.number[s]);
      }
    }
  });
}

Vec3 Packet::vector(const Lanes (&rows)[3], int ray) const {
  Vec3 out;
  for (int row = 0; row < 3; ++row) {
    out[axis_[row]] = rows[row][ray];
  }
  return out;
}

Alike alike(Rows<const double> directions, Index first, Index end, int most) {
  const double* const x = directions[0].data();
  const double* const y = directions[1].data();
  const double* const z = directions[2].data();
  const int face = facing(x[first], y[first], z[first]);
  const Index last = std::min(first + most, end);
  Index n = first;
  while (n + lanes<double> <= last && !any(other_facing(face, x + n, y + n, z + n))) {
    n += lanes<double>;
  }
  while (n < last && facing(x[n], y[n], z[n]) == face) {
    ++n;
  }
  return {static_cast<int>(n - first), face};
}

}  // namespace lidarcfg::world
