#include "simulate/echoes.h"

#include <algorithm>
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

/// Write the candidates (6,) of a beam's echoes, in the order of range.
void pick(View<const Echo> echoes, Index count, double least, View<double> range_m, View<std::uint8_t> reflectivity,
          View<std::int32_t> object) {
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
  const Index with_last = strongest == last ? second : strongest;
  const Index with_first = strongest == first ? second : strongest;
  const Index which[candidates] = {strongest, with_last, last, first, with_first, second};
  for (Index i = 0; i < candidates; ++i) {
    const Index same = std::find(which, which + i, which[i]) - which;
    if (same < i) {
      range_m[i] = range_m[same];
      reflectivity[i] = reflectivity[same];
      object[i] = object[same];
      continue;
    }
    const Echo& echo = echoes[which[i]];
    range_m[i] = seen ? echo.range_m / echo.power : inf;
    reflectivity[i] = to_byte(echo.reflectivity);
    object[i] = echo.object;
  }
}

/// Merges the echoes of one beam after another.
class Merger {
 public:
  Merger(const SubRays& rays, View<const double> weights, const Receiver& receiver, const Droplets& droplets)
      : rays_(rays),
        weights_(weights),
        receiver_(receiver),
        droplets_(droplets),
        power_(weights.size()),
        echoes_(weights.size() + 1) {}

  /// Find the echoes of a firing's rays, whose order in range is `order`; returns how many there are.
  Index merge(Index firing, View<const Index> order);

  View<const Echo> echoes() const { return echoes_; }

 private:
  void find_power(Index firing);

  SubRays rays_;
  View<const double> weights_;
  Receiver receiver_;
  Droplets droplets_;
  std::vector<double> power_;  // of each ray
  std::vector<Echo> echoes_;
};

/// Find the power that each ray of a firing sends back: the LiDAR equation for Lambertian targets and retro-reflectors.
void Merger::find_power(Index firing) {
  const double* const range_m = rays_.range_m[firing].data();
  const std::uint8_t* const reflectivity = rays_.reflectivity[firing].data();
  const double* const cosine = rays_.cosine[firing].data();
  const Index width = std::ssize(weights_);
  for (Index k = 0; k < width; ++k) {
    const double albedo = reflectivity[k] / 100.0;
    power_[k] = weights_[k] * (reflectivity[k] > diffuse_max ? albedo : albedo * cosine[k]);
  }
  if (droplets_.fade.rows()) {
    for (Index k = 0; k < width; ++k) {
      power_[k] *= droplets_.fade(firing, k);
    }
  }
  for (Index k = 0; k < width; ++k) {
    power_[k] = std::max(power_[k] / (range_m[k] * range_m[k]), faintest);
  }
}

Index Merger::merge(Index firing, View<const Index> order) {
  const double* const range_m = rays_.range_m[firing].data();
  const std::uint8_t* const reflectivity = rays_.reflectivity[firing].data();
  const std::int32_t* const object = rays_.object[firing].data();
  const double* const cosine = rays_.cosine[firing].data();
  const bool weather = droplets_.fade.rows() > 0;
  find_power(firing);
  Echo echo;
  Index found = 0;
  Index before = no_ray;
  double before_m = 0;
  if (weather) {
    const double drop_m = droplets_.strongest(firing, 0);
    const double nearest_m = range_m[order[0]];
    if (drop_m < (nearest_m <= receiver_.most_m ? nearest_m : inf)) {
      const double albedo = droplets_.strongest(firing, 1);
      const double power = std::max(albedo * droplets_.fade(firing, std::ssize(order)) / (drop_m * drop_m), faintest);
      echo = {power, power * drop_m, 100 * albedo, power, nothing};
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
    echo.add(power_[ray], far_m, weights_[ray] * reflectivity[ray], object[ray]);
    before = ray;
    before_m = far_m;
  }
  echoes_[std::max<Index>(found - 1, 0)] = echo;
  return found;
}

}  // namespace

void merge_echoes(const SubRays& rays, View<const double> weights, const Receiver& receiver, const Droplets& droplets,
                  const Candidates& out) {
  const Index width = std::ssize(weights);
  std::vector<Index> orders(256 *
                            width);  // that of the beam which each laser fired before: the next one's is much alike
  for (Index n = 0; n < std::ssize(orders); ++n) {
    orders[n] = n % width;
  }
  Merger merger(rays, weights, receiver, droplets);
  for (Index n = 0; n < rays.range_m.rows(); ++n) {
    const View<Index> order(orders.data() + rays.laser[n] * width, width);
    sort_by_range(rays.range_m[n], order);
    const Index found = merger.merge(n, order);
    pick(merger.echoes(), found, receiver.least, out.range_m[n], out.reflectivity[n], out.object[n]);
  }
}

}  // namespace lidarcfg::simulate
