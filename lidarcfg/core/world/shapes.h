/// Where one ray hits one shape, in float64: triangles without cracks between them, spheres and cylinders exactly.
///
/// Triangles as in Woop, Benthin and Wald, Watertight Ray/Triangle Intersection, JCGT 2013: seen along the ray, the
/// sign of an edge function is that of the neighbour reversed, or zero for both, so that no ray passes between the two.
/// The test itself is `Packet`'s, for several rays at once.
#pragma once

#include <cmath>
#include <utility>

#include "world/bvh.h"

namespace lidarcfg::world {

constexpr double tiny = 1e-300;
constexpr double sliver = 1e-4;  // sine between two edges, below which their product is computed in double-double

/// a b - c d, good to the last digit even where both are nearly the same (Dekker 1971).
inline double difference(double a, double b, double c, double d) {
  struct Product {
    double high;
    double low;

    Product(double a, double b) : high(a * b) {
      constexpr double veltkamp = 134217729.0;  // 2^27 + 1: splits a number into halves whose products are exact
      const double s = veltkamp * a;
      const double t = veltkamp * b;
      const double ah = s - (s - a);
      const double bh = t - (t - b);
      const double al = a - ah;
      const double bl = b - bh;
      low = ((ah * bh - high) + ah * bl + al * bh) + al * bl;
    }
  };
  const Product p(a, b);
  const Product q(c, d);
  return (p.high - q.high) + (p.low - q.low);
}

/// The normal of a triangle, of twice its area's length.
inline Vec3 normal(const Vec3& a, const Vec3& b, const Vec3& c) {
  const double px = b[0] - a[0];
  const double py = b[1] - a[1];
  const double pz = b[2] - a[2];
  const double qx = c[0] - a[0];
  const double qy = c[1] - a[1];
  const double qz = c[2] - a[2];
  const double x = py * qz - pz * qy;
  const double y = pz * qx - px * qz;
  const double z = px * qy - py * qx;
  const double p2 = px * px + py * py + pz * pz;
  const double q2 = qx * qx + qy * qy + qz * qz;
  if (x * x + y * y + z * z < sliver * sliver * p2 * q2) {
    return {difference(py, qz, pz, qy), difference(pz, qx, px, qz), difference(px, qy, py, qx)};
  }
  return {x, y, z};
}

/// Where a line enters and leaves a circle; inf, -inf: nowhere.
///
/// What is subtracted is as large as what is left, not its square (Haines and others, Ray Tracing Gems, 2019,
/// chapter 7).
/// @param b     how far ahead the point nearest to the centre is
/// @param off   its distance from the centre
/// @param near  the distance of the start from the centre
std::pair<double, double> chord(double b, double off, double radius, double near);

/// How far a ray from a point relative to the centre is from hitting a sphere, from outside or inside; or inf.
double sphere(const Vec3& start, double radius, const Vec3& direction);

struct CylinderHit {
  double range;
  bool side;  // not its base or its top
};

/// How far a ray from a point relative to the base is from hitting an upright, closed cylinder; or inf.
CylinderHit cylinder(const Vec3& start, double radius, double height, const Vec3& direction);

/// How far a ray along a unit vector is from hitting a sphere, an instance's sphere or a cylinder; or inf.
double round_range(const Shape& shape, Kind kind, const Vec3& origin, const Vec3& direction);

/// The unit normal, towards either side, of a shape where a ray hits it at a range; of a triangle without area, 0.
Vec3 normal_at(const Shape& shape, Kind kind, const Vec3& origin, const Vec3& direction, double range);

}  // namespace lidarcfg::world
