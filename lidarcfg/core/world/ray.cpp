#include "world/ray.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>

#include "simd.h"
#include "world/descent.h"
#include "world/packet.h"
#include "world/shapes.h"

namespace lidarcfg::world {
namespace {

using namespace simd;

float shortened(double range) { return static_cast<float>(std::min(range, double{farthest})) * (1 + wider); }

/// A ray, as boxes and triangles are tested against it.
class Ray {
 public:
  Ray(const Vec3& origin, const Vec3& direction) : origin_(origin), direction_(direction) {
    const int largest = facing(direction[0], direction[1], direction[2]) & 3;
    for (int axis = 0; axis < 3; ++axis) {
      const bool down = direction[axis] < 0;
      const float inverse = 1 / std::max(static_cast<float>(std::abs(direction[axis])), flattest);
      const float way = down ? -1 : 1;
      const double wide = std::abs(origin[axis]) * wider + pad_m;
      negative_[axis] = down;
      near_origin_[axis] = static_cast<float>(down ? origin[axis] - wide : origin[axis] + wide);
      far_origin_[axis] = static_cast<float>(down ? origin[axis] + wide : origin[axis] - wide);
      near_inverse_[axis] = way * (inverse * (1 - wider));
      far_inverse_[axis] = way * (inverse * (1 + wider));
      axis_[(axis + 5 - largest) % 3] = axis;
    }
    const auto [i, j, k] = axis_;
    shear_ = {direction[i] / direction[k], direction[j] / direction[k], 1 / direction[k]};
  }

  /// Which children of a node it may be in, as bits, and from where on.
  unsigned enter(const Node& node, float most, float* near) const {
    unsigned found = 0;
    for (int c = 0; c < node_size; c += lanes<float>) {
      Floats enters{};
      Floats leaves = Floats{} + most;
      for (int axis = 0; axis < 3; ++axis) {
        const Floats entry = load<Floats>(node.side[negative_[axis]][axis] + c);
        const Floats exit = load<Floats>(node.side[!negative_[axis]][axis] + c);
        enters = max((entry - near_origin_[axis]) * near_inverse_[axis], enters);
        leaves = min((exit - far_origin_[axis]) * far_inverse_[axis], leaves);
      }
      store(near + c, enters);
      found |= bits(enters <= leaves) << c;
    }
    return found;
  }

  /// How far it is from hitting a shape; or inf.
  double range(const Shape& shape, Kind kind) const {
    return kind == Kind::triangle ? triangle(shape) : round_range(shape, kind, origin_, direction_);
  }

 private:
  /// See Packet::hit_triangle, which does the same for several.
  double triangle(const Shape& shape) const {
    const auto [i, j, k] = axis_;
    const Vec3 a{shape[i], shape[j], shape[k]};
    const Vec3 b{shape[3 + i], shape[3 + j], shape[3 + k]};
    const Vec3 c{shape[6 + i], shape[6 + j], shape[6 + k]};
    const auto [sx, sy, sz] = shear_;
    const double az = a[2] - origin_[k];
    const double bz = b[2] - origin_[k];
    const double cz = c[2] - origin_[k];
    const double ax = (a[0] - origin_[i]) - sx * az;
    const double ay = (a[1] - origin_[j]) - sy * az;
    const double bx = (b[0] - origin_[i]) - sx * bz;
    const double by = (b[1] - origin_[j]) - sy * bz;
    const double cx = (c[0] - origin_[i]) - sx * cz;
    const double cy = (c[1] - origin_[j]) - sy * cz;
    const double u = cx * by - cy * bx;
    const double v = ax * cy - ay * cx;
    const double w = bx * ay - by * ax;
    const double low = min(min(u, v), w);
    const double high = max(max(u, v), w);
    if (!((low >= 0 || high <= 0) && (high > low || high != 0))) {
      return std::numeric_limits<double>::infinity();
    }
    const auto [nx, ny, nz] = normal(a, b, c);
    const double along = nx * direction_[i] + ny * direction_[j] + nz * direction_[k];
    const double as = az * sz;
    const double bs = bz * sz;
    const double cs = cz * sz;
    const double far =
        (nx * (a[0] - origin_[i]) + ny * (a[1] - origin_[j]) + nz * (a[2] - origin_[k])) / (along == 0 ? tiny : along);
    return min(max(far, min(min(as, bs), cs)), max(max(as, bs), cs));
  }

  Vec3 origin_;
  Vec3 direction_;
  Vec3 shear_;
  std::array<int, 3> axis_;  // that of the largest component last
  bool negative_[3];
  float near_origin_[3];
  float near_inverse_[3];
  float far_origin_[3];
  float far_inverse_[3];
};

}  // namespace

RayHit first_hit(const Bvh& bvh, const Vec3& origin, const Vec3& direction, double limit) {
  RayHit found{limit, no_slot};
  const auto is_finite = [](double one) { return std::isfinite(one); };
  if (bvh.nodes.empty() || !std::ranges::all_of(origin, is_finite) || !std::ranges::all_of(direction, is_finite)) {
    return found;
  }
  const Ray ray(origin, direction);
  float most = shortened(limit);
  Waiting stack[stack_size];
  Waiting* top = stack;
  *top++ = {0, 0};
  while (top > stack) {
    const auto [near, code] = *--top;
    if (near > most) {
      continue;
    }
    if (code < 0) {
      const LeafCode leaf(code);
      for (std::int32_t s = leaf.first(); s < leaf.end(); ++s) {
        const double far = ray.range(bvh.leaves[s].shape, leaf.mixed() ? bvh.kind[s] : Kind::triangle);
        if (far > 0 && (far < found.range || (far == found.range && s < found.slot))) {
          found = {far, s};
          most = shortened(far);
        }
      }
      continue;
    }
    const Node& node = bvh.nodes[code];
    alignas(32) float enters[node_size];
    Waiting* const base = top;
    for (unsigned children = ray.enter(node, most, enters); children; children &= children - 1) {
      const int c = std::countr_zero(children);
      Waiting* at = top++;
      for (; at > base && at[-1].near < enters[c]; --at) {  // the nearest comes first
        at[0] = at[-1];
      }
      *at = {enters[c], node.child[c]};
    }
  }
  return found;
}

}  // namespace lidarcfg::world
