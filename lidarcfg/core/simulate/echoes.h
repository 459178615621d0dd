/// The echoes of wide beams: what their rays hit, merged where the sensor cannot tell it apart.
#pragma once

#include "views.h"

namespace lidarcfg::simulate {

/// What the K rays of the beams of N firings hit.
struct SubRays {
  Rows<const double> range_m;             // (N, K) inf: nothing
  Rows<const std::uint8_t> reflectivity;  // (N, K)
  Rows<const std::int32_t> object;        // (N, K)
  Rows<const double> cosine;              // (N, K) of the angle between ray and normal
  View<const std::uint8_t> laser;         // (N,) that fired
};

/// What a receiver detects.
struct Receiver {
  double most_m;    // the greatest range
  double step_rad;  // the angle between neighbouring rays
  double least;     // the least power
};

/// What rain and fog send back of N firings, and leave of the light of K rays. Both are empty in clear weather.
struct Droplets {
  Rows<const double> strongest;  // (N, 2) range and albedo of their strongest echo
  Rows<const double> fade;       // (N, K + 1) what is left of the light of each ray, and of that echo
};

/// The six candidates of N firings that return modes report: see `Echoes` of lidarcfg.simulate.echoes.
struct Candidates {
  Rows<double> range_m;             // (N, 6) inf: none
  Rows<std::uint8_t> reflectivity;  // (N, 6)
  Rows<std::int32_t> object;        // (N, 6)
};

constexpr Index candidates = 6;

/// Write the candidates of N beams of K rays with weights (K,).
///
/// Neighbours in range merge into an echo; on one object also if its slant explains the distance between them: a
/// surface hit at a grazing angle is one echo, though its few rays are far apart.
void merge_echoes(const SubRays& rays, View<const double> weights, const Receiver& receiver, const Droplets& droplets,
                  const Candidates& out);

}  // namespace lidarcfg::simulate
