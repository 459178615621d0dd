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

/// What a return mode may report of a firing; see `Echoes` of lidarcfg.simulate.echoes.
enum class Candidate : std::uint8_t { strongest, strongest_but_last, last, first, strongest_but_first, second };
constexpr int candidates = 6;

/// Some candidates of N firings, to be written.
struct Candidates {
  Rows<double> range_m;             // (N, C) inf: none
  Rows<std::uint8_t> reflectivity;  // (N, C)
  Rows<std::int32_t> object;        // (N, C)
};

/// Write the candidates `which` (C,) of N beams of K rays with weights (K,).
///
/// Neighbours in range merge into an echo; on one object also if its slant explains the distance between them: a
/// surface hit at a grazing angle is one echo, though its few rays are far apart.
void merge_echoes(const SubRays& rays, View<const double> weights, const Receiver& receiver, const Droplets& droplets,
                  View<const Candidate> which, const Candidates& out);

}  // namespace lidarcfg::simulate
