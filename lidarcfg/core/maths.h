/// Elementary functions that are the same on every processor, as the system's are not.
///
/// The series are those of fdlibm (k_sin.c, k_cos.c, s_atan.c, e_exp.c, e_log.c; Sun 1993). Errors are below two units
/// in the last place, of the tangent below three.
#pragma once

#include <cmath>
#include <limits>
#include <numbers>

#include "angles.h"

namespace lidarcfg {

/// Both of any angle: large ones are brought to half a revolution first.
inline CosSin cos_sin_of_any(double angle_rad) {
  constexpr double many_revolutions_rad = 1e5;
  constexpr double turn = 2 * std::numbers::pi;
  constexpr double turn_low = 2.4492935982947064e-16;
  if (std::abs(angle_rad) < many_revolutions_rad) {
    return cos_sin(angle_rad);
  }
  const double rest = std::remainder(angle_rad, turn);
  return cos_sin(std::remainder(rest - (angle_rad - rest) / turn * turn_low, turn));
}

inline double sin(double angle_rad) { return cos_sin_of_any(angle_rad).sin; }
inline double cos(double angle_rad) { return cos_sin_of_any(angle_rad).cos; }

inline double tan(double angle_rad) {
  const auto [cosine, sine] = cos_sin_of_any(angle_rad);
  return sine / cosine;
}

/// Of a number that is not negative: the angle's distance from one of four angles by the series, and that angle.
inline double atan_of_positive(double x) {
  constexpr double angle[] = {0.0, 4.63647609000806093515e-01, 7.85398163397448278999e-01, 9.82793723247329054082e-01,
                              1.57079632679489655800e+00};  // of 0, 1/2, 1, 3/2 and infinity
  constexpr double angle_low[] = {0.0, 2.26987774529616870924e-17, 3.06161699786838301793e-17,
                                  1.39033110312309984516e-17, 6.12323399573676603587e-17};
  int near = 0;
  if (x >= 2.4375) {
    near = 4;
    x = -1.0 / x;
  } else if (x >= 1.1875) {
    near = 3;
    x = (x - 1.5) / (1.0 + 1.5 * x);
  } else if (x >= 0.6875) {
    near = 2;
    x = (x - 1.0) / (x + 1.0);
  } else if (x >= 0.4375) {
    near = 1;
    x = (2.0 * x - 1.0) / (2.0 + x);
  }
  const double z = x * x;
  const double w = z * z;
  const double odd = z * (3.33333333333329318027e-01 +
                          w * (1.42857142725034663711e-01 +
                               w * (9.09088713343650656196e-02 +
                                    w * (6.66107313738753120669e-02 +
                                         w * (4.97687799461593236017e-02 + w * 1.62858201153657823623e-02)))));
  const double even =
      w *
      (-1.99999999998764832476e-01 +
       w * (-1.11111104054623557880e-01 +
            w * (-7.69187620504482999495e-02 + w * (-5.83357013379057348645e-02 + w * -3.65315727442169155270e-02))));
  return angle[near] - ((x * (odd + even) - angle_low[near]) - x);
}

/// The angle of a point, from -pi to pi; zeros and infinities as IEEE 754 has them.
inline double atan2(double y, double x) {
  if (std::isnan(x) || std::isnan(y)) {
    return std::numeric_limits<double>::quiet_NaN();
  }
  const double up = std::abs(y);
  const double ahead = std::abs(x);
  double angle;
  if (std::isinf(up) && std::isinf(ahead)) {
    angle = std::numbers::pi / 4;
  } else if (up == 0.0 && ahead == 0.0) {
    angle = 0.0;
  } else {
    angle = atan_of_positive(up / ahead);
  }
  if (std::signbit(x)) {
    constexpr double pi_low = 1.2246467991473531772e-16;
    angle = std::numbers::pi - (angle - pi_low);
  }
  return std::copysign(angle, y);
}

inline double atan(double x) { return std::copysign(atan_of_positive(std::abs(x)), x); }
inline double asin(double x) { return atan2(x, std::sqrt((1.0 - x) * (1.0 + x))); }
inline double acos(double x) { return atan2(std::sqrt((1.0 - x) * (1.0 + x)), x); }

inline double exp(double x) {
  if (!(x > -746.0)) {
    return std::isnan(x) ? x : 0.0;
  }
  if (x > 709.782712893383973096) {
    return std::numeric_limits<double>::infinity();
  }
  const double k = std::floor(x * std::numbers::log2e + 0.5);
  const double high = x - k * 6.93147180369123816490e-01;
  const double low = k * 1.90821492927058770002e-10;
  const double r = high - low;
  const double z = r * r;
  const double c =
      r -
      z * (1.66666666666666019037e-01 +
           z * (-2.77777777770155933842e-03 +
                z * (6.61375632143793436117e-05 + z * (-1.65339022054652515390e-06 + z * 4.13813679705723846039e-08))));
  return std::ldexp(1.0 - ((low - r * c / (2.0 - c)) - high), static_cast<int>(k));
}

inline double log(double x) {
  if (!(x > 0.0) || std::isinf(x)) {
    return x == 0.0 ? -std::numeric_limits<double>::infinity() : x > 0.0 ? x : std::numeric_limits<double>::quiet_NaN();
  }
  int k;
  double m = std::frexp(x, &k);
  if (m < std::numbers::sqrt2 / 2) {
    m *= 2.0;
    --k;
  }
  const double f = m - 1.0;
  const double s = f / (2.0 + f);
  const double z = s * s;
  const double series = z * (6.666666666666735130e-01 +
                             z * (3.999999999940941908e-01 +
                                  z * (2.857142874366239149e-01 +
                                       z * (2.222219843214978396e-01 +
                                            z * (1.818357216161805012e-01 +
                                                 z * (1.531383769920937332e-01 + z * 1.479819860511658591e-01))))));
  const double half = 0.5 * f * f;
  return k * 6.93147180369123816490e-01 - ((half - (s * (half + series) + k * 1.90821492927058770002e-10)) - f);
}

}  // namespace lidarcfg
