/// Sines and cosines that are the same on every processor, as the system's are not.
#pragma once

#include <cmath>
#include <numbers>

namespace lidarcfg {

struct CosSin {
  double cos;
  double sin;
};

/// Both of an angle, without branches, so that loops vectorise; the error is some 2e-16 up to many revolutions.
///
/// The series of sin and cos up to pi / 4 are those of fdlibm (k_sin.c, k_cos.c, Sun 1993).
inline CosSin cos_sin(double angle_rad) {
  constexpr double quarter = 1.57079632673412561417e00;  // pi / 2 in two parts
  constexpr double quarter_low = 6.07710050650619224932e-11;
  const double quarters = std::floor(angle_rad * (2 / std::numbers::pi) + 0.5);
  const double x = (angle_rad - quarters * quarter) - quarters * quarter_low;
  const double z = x * x;
  const double s = x + x * z *
                           (-1.66666666666666324348e-01 +
                            z * (8.33333333332248946124e-03 +
                                 z * (-1.98412698298579493134e-04 +
                                      z * (2.75573137070700676789e-06 +
                                           z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
  const double c = 1 - 0.5 * z +
                   z * z *
                       (4.16666666666666019037e-02 +
                        z * (-1.38888888888741095749e-03 +
                             z * (2.48015872894767294178e-05 +
                                  z * (-2.75573143513906633035e-07 +
                                       z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
  // The two lowest bits of the number of quarters, as numbers.
  const double halves = std::floor(quarters * 0.5);
  const bool odd = quarters - 2 * halves != 0;
  const bool beyond = halves - 2 * std::floor(halves * 0.5) != 0;
  const double cosine = odd ? s : c;
  const double sine = odd ? c : s;
  return {beyond != odd ? -cosine : cosine, beyond ? -sine : sine};
}

}  // namespace lidarcfg
