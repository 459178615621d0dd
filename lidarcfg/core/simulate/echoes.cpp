#include "simulate/echoes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

namespace lidarcfg::simulate {
namespace {

constexpr int diffuse_max = 100;      // a reflectivity beyond is a retro-reflector's
constexpr double separation_m = 1.0;  // closer echoes merge (VLP-16, VLS-128 manuals: dual returns 1 m apart or more)
constexpr double faintest = 1e-30;    // power from a black or edge-on surface: detected unless there is a limit
constexpr std::int32_t nothing = -1;  // an object
constexpr Index no_ray = -1;
constexpr double inf = std::numeric_limits<double>::infinity();

struct Echo {
  double power = 0;
  double range_m = 0;             // weighted by power
  double reflectivity = 0;        // weighted by the rays' weights
  double best = 0;                // power of its strongest ray
  std::int32_t object = nothing;  // that this ray hit

  void add(double ray_power, double ray_range_m, double ray_reflectivity, std::int32_t hit) {
    power += ray_power;
    range_m += ray_power * ray_range_m;
    reflectivity += ray_reflectivity;
    if (ray_power > best) {
      best = ray_power;
      object = hit;
    }
  }
};

/// Sort the rays of a beam by range; of equal ones, by number. Quick where the order is right already.
void sort_by_range(View<const double> range_m, View<Index> order) {
  for (Index i = 1; i < std::ssize(order); ++i) {
    const Index k = order[i];
    Index at = i;
    for (; at > 0; --at) {
      const Index before = order[at - 1];
      if (!(range_m[before] > range_m[k] || (range_m[before] == range_m[k] && before > k))) {
        break;
      }
      order[at] = before;
    }
    order[at] = k;
  }
}

/// How far apart, along the beam, neighbouring rays hit a surface of such a slant.
double slant_m(double range_m, double cosine, double step_rad) {
  const double slant = range_m * (std::sqrt(std::max(1 - cosine * cosine, 0.0)) / cosine) * step_rad;
  return slant < inf ? slant : 0.0;
}

std::uint8_t to_byte(double value) {
  const double rounded = std::rint(value);
  return rounded > 0 ? static_cast<std::uint8_t>(std::min(rounded, 255.0)) : 0;
}

/// Which of a beam's echoes (in the order of range) each candidate is; returns whether any is seen.
bool rank(View<const Echo> echoes, Index count, double least, std::array<Index, candidates>& echo_of) {
  Index strongest = 0;
  Index second = 0;
  Index last = 0;
  Index first = 0;
  Index seen = 0;
  for (Index c = 0; c < count; ++c) {
    const double power = echoes[c].power;
    if (!(power > 0 && power >= least)) {
      continue;
    }
    first = seen == 0 ? c : first;
    last = c;
    if (seen == 0 || power > echoes[strongest].power) {
      second = seen == 0 ? c : strongest;
      strongest = c;
    } else if (seen == 1 || power > echoes[second].power) {
      second = c;
    }
    ++seen;
  }
  echo_of = {strongest, strongest == last ? second : strongest,  last,
             first,     strongest == first ? second : strongest, second};
  return seen > 0;
}

/// Merges the echoes of one beam after another.
class Merger {
 public:
  Merger(const SubRays& rays, View<const double> weights, const Receiver& receiver, const Droplets& droplets)
      : rays_(rays),
        weights_(weights),
        receiver_(receiver),
        droplets_(droplets),
        echoes_(weights.size() + 1),
        weight_(block * weights.size()),
        power_(block * weights.size()) {
    for (std::size_t n = 0; n < weight_.size(); ++n) {
      weight_[n] = weights[n % weights.size()];
    }
  }

  /// Find the echoes of a firing's rays, whose order in range is `order`; returns how many there are. Firings come one
  /// after another.
  Index merge(Index firing, View<const Index> order);

  View<const Echo> echoes() const { return echoes_; }

 private:
  static constexpr Index block = 64;  // firings whose rays' powers are found at once

  void find_power(Index first, Index count);

  SubRays rays_;
  View<const double> weights_;
  Receiver receiver_;
  Droplets droplets_;
  std::vector<Echo> echoes_;
  std::vector<double> weight_;  // of the rays of a block
  std::vector<double> power_;
};

/// Find the powers that rays send back: the LiDAR equation for Lambertian targets and retro-reflectors.
void Merger::find_power(Index first, Index count) {
  const Index width = std::ssize(weights_);
  const Index all = count * width;
  const double* const range_m = rays_.range_m.data() + first * width;
  const double* const cosine = rays_.cosine.data() + first * width;
  const std::uint8_t* const reflectivity = rays_.reflectivity.data() + first * width;
  const double* const weight = weight_.data();
  double* const power = power_.data();
  for (Index n = 0; n < all; ++n) {
    const double albedo = reflectivity[n] / 100.0;
    power[n] = weight[n] * (reflectivity[n] > diffuse_max ? albedo : albedo * cosine[n]);
  }
  if (droplets_.fade.rows()) {
    for (Index n = 0; n < count; ++n) {
      for (Index k = 0; k < width; ++k) {
        power[n * width + k] *= droplets_.fade(first + n, k);
      }
    }
  }
  for (Index n = 0; n < all; ++n) {
    power[n] = std::max(power[n] / (range_m[n] * range_m[n]), faintest);
  }
}

Index Merger::merge(Index firing, View<const Index> order) {
  const double* const range_m = rays_.range_m[firing].data();
  const std::uint8_t* const reflectivity = rays_.reflectivity[firing].data();
  const std::int32_t* const object = rays_.object[firing].data();
  const double* const cosine = rays_.cosine[firing].data();
  const bool weather = droplets_.fade.rows() > 0;
  if (firing % block == 0) {
    find_power(firing, std::min(block, rays_.range_m.rows() - firing));
  }
  const double* const power = power_.data() + firing % block * std::ssize(weights_);
  Echo echo;
  Index found = 0;
  Index before = no_ray;
  double before_m = 0;
  if (weather) {
    const double drop_m = droplets_.strongest(firing, 0);
    const double nearest_m = range_m[order[0]];
    if (drop_m < (nearest_m <= receiver_.most_m ? nearest_m : inf)) {
      const double albedo = droplets_.strongest(firing, 1);
      const double light = std::max(albedo * droplets_.fade(firing, std::ssize(order)) / (drop_m * drop_m), faintest);
      echo = {light, light * drop_m, 100 * albedo, light, nothing};
      before_m = drop_m;
      found = 1;
    }
  }
  for (const Index ray : order) {
    const double far_m = range_m[ray];
    if (!(far_m <= receiver_.most_m)) {
      break;
    }
    bool apart = found == 0;
    if (found && !(far_m - before_m <= separation_m)) {
      apart = before == no_ray || object[ray] != object[before] ||
              !(far_m - before_m <= separation_m + std::max(slant_m(far_m, cosine[ray], receiver_.step_rad),
                                                            slant_m(before_m, cosine[before], receiver_.step_rad)));
    }
    if (apart) {
      echoes_[std::max<Index>(found - 1, 0)] = echo;
      echo = {};
      ++found;
    }
    echo.add(power[ray], far_m, weights_[ray] * reflectivity[ray], object[ray]);
    before = ray;
    before_m = far_m;
  }
  echoes_[std::max<Index>(found - 1, 0)] = echo;
  return found;
}

}  // namespace

void merge_echoes(const SubRays& rays, View<const double> weights, const Receiver& receiver, const Droplets& droplets,
                  View<const Candidate> which, const Candidates& out) {
  const Index width = std::ssize(weights);
  std::vector<Index> orders(256 *
                            width);  // of the beam that each laser fired before: that of its next is much the same
  for (Index n = 0; n < std::ssize(orders); ++n) {
    orders[n] = n % width;
  }
  Merger merger(rays, weights, receiver, droplets);
  const View<const Echo> echoes = merger.echoes();
  std::array<Index, candidates> echo_of;
  for (Index n = 0; n < rays.range_m.rows(); ++n) {
    const View<Index> order(orders.data() + rays.laser[n] * width, width);
    sort_by_range(rays.range_m[n], order);
    const Index found = merger.merge(n, order);
    const bool seen = rank(echoes, found, receiver.least, echo_of);
    for (Index c = 0; c < std::ssize(which); ++c) {
      const Echo& echo = echoes[echo_of[static_cast<int>(which[c])]];
      out.range_m(n, c) = seen ? echo.range_m / echo.power : inf;
      out.reflectivity(n, c) = to_byte(echo.reflectivity);
      out.object(n, c) = echo.object;
    }
  }
}

}  // namespace lidarcfg::simulate
