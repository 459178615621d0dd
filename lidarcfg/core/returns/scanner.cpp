#include "returns/scanner.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "maths.h"

namespace lidarcfg::returns {
namespace {

constexpr double turn = 2 * std::numbers::pi;
constexpr double ahead_m = 1e-9;   // an object's corners are all at least so far ahead of a sensor, or its beams all
                                   // around are traced
constexpr double wider = 1e-9;     // of azimuths and slopes, for rounding
constexpr double fov_rad = 1e-11;  // by which a field of view is wider, for rounding
constexpr double steep_rad = 1.5;
constexpr double band_rad = 0.02;  // of firings whose rays are traced together
constexpr std::int32_t middle_heads = 64;  // of the surest firing, that come first
constexpr double inf = std::numeric_limits<double>::infinity();

double floor_modulo(double value, double divisor) {
  const double rest = std::fmod(value, divisor);
  return rest < 0 ? rest + divisor : rest;
}

/// An angle from 0 to a turn, both included; not to the last digit.
double wrapped(double angle_rad) {
  return std::clamp(angle_rad - turn * std::floor(angle_rad * (1 / turn)), 0.0, turn);
}

}  // namespace

Scanner::Scanner(const ScannerColumns& columns)
    : heads_(std::make_shared<HeadAngles>(HeadAngles{{columns.cos_head.begin(), columns.cos_head.end()},
                                                     {columns.sin_head.begin(), columns.sin_head.end()}})),
      start_rad_(columns.start_rad),
      step_rad_(columns.step_rad),
      phases_(static_cast<int>(columns.phases)),
      range_m_(columns.range_m),
      fov_rad_(columns.fov_rad),
      beside_m_(0) {
  for (Index f = 0; f < std::ssize(columns.lag_rad); ++f) {
    const double elevation = columns.elevation_rad[f];
    Firing one;
    one.lag_rad = stands_still() ? wrapped(columns.lag_rad[f]) : columns.lag_rad[f];
    one.gating_rad = columns.gating_rad[f];
    one.offset_rad = columns.offset_rad[f];
    one.steep = std::abs(elevation) > steep_rad;
    one.rise = lidarcfg::tan(std::clamp(elevation, -1.5707963, 1.5707963));
    one.cos_lag = lidarcfg::cos(one.lag_rad);
    one.sin_lag = lidarcfg::sin(one.lag_rad);
    one.cos_offset = lidarcfg::cos(one.offset_rad);
    one.sin_offset = lidarcfg::sin(one.offset_rad);
    one.cos_elevation = lidarcfg::cos(elevation);
    one.sin_elevation = lidarcfg::sin(elevation);
    one.forward_m = columns.start_m(f, 0);
    one.left_m = columns.start_m(f, 1);
    one.up_m = columns.start_m(f, 2);
    one.phase = stands_still() ? columns.phase[f] : 0;
    one.band = static_cast<std::int32_t>(stands_still() ? std::floor(elevation / band_rad) : f);
    beside_m_ = std::max(beside_m_, std::sqrt(one.forward_m * one.forward_m + one.left_m * one.left_m));
    firings_.push_back(one);
  }
  if (stands_still()) {
    std::ranges::stable_sort(firings_, {}, [](const Firing& one) { return std::pair(one.band, one.lag_rad); });
  }
  for (Index f = 0; f < std::ssize(firings_); ++f) {
    if (f == 0 || !are_alike(f - 1, f)) {
      band_starts_.push_back(f);
    }
  }
  band_starts_.push_back(std::ssize(firings_));
}

View<const Scanner::Firing> Scanner::firings_of(Index band) const {
  return firings().subspan(band_starts_[band], band_starts_[band + 1] - band_starts_[band]);
}

bool Scanner::sees_all_around() const { return fov_rad_[1] >= turn; }

bool Scanner::is_outside(Index firing, Index head) const {
  if (sees_all_around()) {
    return false;
  }
  const double turned = floor_modulo(
      start_rad_ + static_cast<double>(head) * step_rad_ + firings_[firing].gating_rad - fov_rad_[0], turn);
  return fov_rad_[1] + fov_rad < turned && turned < turn - fov_rad;
}

/// Where a box is seen from the sensor's axis: azimuths, clockwise, distances and heights.
struct AimedBeams::Window {
  double first_rad;
  double last_rad;
  double near_m;  // 0: it may be all around, at any azimuth
  double far_m;
  double low_m;
  double high_m;

  /// Whether a firing may be at the box's height at its distance.
  bool meets(const Scanner::Firing& firing) const {
    const double low = low_m - firing.up_m;
    const double high = high_m - firing.up_m;
    if (firing.steep) {  // the object stays away from the axis, or is around it
      return firing.rise > 0 ? firing.rise * near_m <= high : firing.rise * near_m >= low;
    }
    const double least = low / (low < 0 ? near_m : far_m);
    const double most = high / (high <= 0 ? far_m : near_m);
    return least - wider * (1 + std::abs(least)) <= firing.rise && firing.rise <= most + wider * (1 + std::abs(most));
  }
};

void AimedBeams::aim(const Scanner& scanner, const SensorPose& pose, const TargetShape& target, const Place& place) {
  scanner_ = &scanner;
  target_ = &target;
  place_ = place;
  const double c = place.cos_heading;
  const double s = place.sin_heading;
  const double x = pose.t[0] - place.position_m[0];
  const double y = pose.t[1] - place.position_m[1];
  origin_ = {c * x + s * y, c * y - s * x, pose.t[2] - place.position_m[2]};
  for (int k = 0; k < 3; ++k) {
    M_[0][k] = c * pose.R[0][k] + s * pose.R[1][k];
    M_[1][k] = c * pose.R[1][k] - s * pose.R[0][k];
    M_[2][k] = pose.R[2][k];
  }
  heads_.clear();
  const Window seen = window();
  if (seen.near_m > scanner.most_m() * (1 + wider) + wider) {
    return;
  }
  if (scanner.stands_still()) {
    const double begin = wrapped(seen.first_rad);
    const double end = begin + (seen.last_rad - seen.first_rad);
    for (Index band = 0; band < scanner.bands(); ++band) {
      add_still(seen, band, begin, std::min(end, turn));
      add_still(seen, band, 0, std::min(end - turn, std::nextafter(begin, -1.0)));
    }
  }
  for (Index f = 0; !scanner.stands_still() && f < std::ssize(scanner.firings()); ++f) {
    if (seen.meets(scanner.firings()[f])) {
      add(seen, f);
    }
  }
  put_middle_first(seen);
}

/// Have the beams come first that are the surest to hit: those of the firing nearest to the middle of the window.
void AimedBeams::put_middle_first(const Window& seen) {
  if (heads_.empty() || seen.near_m == 0) {
    return;
  }
  const double middle = (seen.low_m + seen.high_m) / (seen.near_m + seen.far_m);
  const auto off = [&](const Heads& some) {
    const Scanner::Firing& one = scanner_->firings()[some.firing];
    return std::abs(one.rise - middle);
  };
  const auto nearest = std::min_element(heads_.begin(), heads_.end(),
                                        [&](const Heads& one, const Heads& other) { return off(one) < off(other); });
  std::swap(heads_.front(), *nearest);
  const Heads first = heads_.front();
  const std::int32_t before = (first.end - first.first - middle_heads) / 2;
  if (before > 0) {
    heads_.front() = {first.firing, first.first + before, first.first + before + middle_heads};
    heads_.push_back({first.firing, first.first, first.first + before});
    heads_.push_back({first.firing, first.first + before + middle_heads, first.end});
  }
}

AimedBeams::Window AimedBeams::window() const {
  double x[8];
  double y[8];
  double z[8];
  double u = 0;
  double v = 0;
  for (int corner = 0; corner < 8; ++corner) {
    Vec3 p;
    for (int k = 0; k < 3; ++k) {
      p[k] = (corner >> k & 1 ? target_->high_m[k] : target_->low_m[k]) - origin_[k];
    }
    x[corner] = M_[0][0] * p[0] + M_[1][0] * p[1] + M_[2][0] * p[2];
    y[corner] = M_[0][1] * p[0] + M_[1][1] * p[1] + M_[2][1] * p[2];
    z[corner] = M_[0][2] * p[0] + M_[1][2] * p[1] + M_[2][2] * p[2];
    u += x[corner];
    v += y[corner];
  }
  const auto [low, high] = std::minmax_element(z, z + 8);
  const double beside_m = scanner_->beside_m();
  double far_squared = 0;
  for (int corner = 0; corner < 8; ++corner) {
    far_squared = std::max(far_squared, x[corner] * x[corner] + y[corner] * y[corner]);
  }
  const double far_m = std::sqrt(far_squared) + beside_m;
  const Window everywhere{0.0, turn, 0.0, far_m, *low, *high};
  const double length = std::sqrt(u * u + v * v);
  if (!(length > 0)) {
    return everywhere;
  }
  u /= length;
  v /= length;
  double near = inf;
  double left = 0;  // tangents of angles from the middle of the box
  double right = 0;
  for (int corner = 0; corner < 8; ++corner) {
    const double ahead = x[corner] * u + y[corner] * v;
    const double aside = (y[corner] * u - x[corner] * v) / ahead;
    near = std::min(near, ahead);
    left = std::max(left, aside);
    right = std::min(right, aside);
  }
  if (!(near > beside_m + ahead_m)) {
    return everywhere;
  }
  const double centre = -lidarcfg::atan2(v, u);
  const double more = lidarcfg::asin(beside_m / near) + wider;
  return {centre - lidarcfg::atan(left) - more,
          centre - lidarcfg::atan(right) + more,
          near - beside_m,
          far_m,
          *low,
          *high};
}

/// Add the heads at which a firing points at a window and may be in the field of view.
void AimedBeams::add(const Window& window, Index firing) {
  const Scanner::Firing& one = scanner_->firings()[firing];
  double begin = wrapped(window.first_rad - one.offset_rad - one.lag_rad - scanner_->start_rad());
  double end = begin + (window.last_rad - window.first_rad);
  if (end - begin >= turn) {
    begin = 0;
    end = turn;
  }
  const double width = scanner_->fov_width_rad() + 2 * wider;
  if (width >= turn - wider) {
    add_heads(firing, begin, end);
    return;
  }
  const double from = wrapped(scanner_->fov_from_rad() - scanner_->start_rad() - one.gating_rad - wider);
  for (const double turned : {from - turn, from, from + turn}) {
    const double first = std::max(begin, turned);
    const double last = std::min(end, turned + width);
    if (first <= last) {
      add_heads(firing, first, last);
    }
  }
}

/// Add those firings of a band, of heads that stand still, that point at a window and lag from one angle to another.
void AimedBeams::add_still(const Window& window, Index band, double begin_rad, double end_rad) {
  const View<const Scanner::Firing> all = scanner_->firings_of(band);
  const auto first = static_cast<std::int32_t>(all.data() - scanner_->firings().data());
  auto at = std::ranges::lower_bound(all, begin_rad, {}, &Scanner::Firing::lag_rad);
  for (; at != all.end() && at->lag_rad <= end_rad; ++at) {
    if (window.meets(*at)) {
      heads_.push_back({first + static_cast<std::int32_t>(at - all.begin()), at->phase, at->phase + 1});
    }
  }
}

/// Add the heads from an angle to another, which may be beyond a turn.
void AimedBeams::add_heads(Index firing, double begin_rad, double end_rad) {
  const double step = scanner_->step_rad();
  const Index count = scanner_->heads();
  const auto first = static_cast<Index>(std::ceil(begin_rad / step));
  const auto end = std::min(static_cast<Index>(std::floor(end_rad / step)) + 1, count);
  const auto add = [&](Index from, Index to) {
    if (from < to) {
      heads_.push_back(
          {static_cast<std::int32_t>(firing), static_cast<std::int32_t>(from), static_cast<std::int32_t>(to)});
    }
  };
  add(first, end);
  if (end_rad > turn) {
    const auto again = static_cast<Index>(std::ceil((begin_rad - turn) / step));
    const auto last = static_cast<Index>(std::floor((end_rad - turn) / step)) + 1;
    add(std::max(again, Index{0}), std::min({last, first, count}));
  }
}

std::int32_t AimedBeams::most_of_a_phase() {
  by_phase_.assign(scanner_->phases(), 0);
  for (const Heads& heads : heads_) {
    add_by_phase(heads, 1, by_phase_);
  }
  return *std::max_element(by_phase_.begin(), by_phase_.end());
}

void add_by_phase(const AimedBeams::Heads& heads, std::int32_t times, View<std::int32_t> counts) {
  const auto phases = static_cast<std::int32_t>(counts.size());
  const std::int32_t of_each = (heads.end - heads.first) / phases;
  for (std::int32_t& count : counts) {
    count += times * of_each;
  }
  for (std::int32_t head = heads.first + of_each * phases; head < heads.end; ++head) {
    counts[head % phases] += times;
  }
}

void AimedBeams::rays(const Heads& heads, double* origins, double* directions, int stride) const {
  const Scanner::Firing& one = scanner_->firings()[heads.firing];
  const double* const cos_head = scanner_->cos_head() + heads.first;
  const double* const sin_head = scanner_->sin_head() + heads.first;
  const int count = heads.end - heads.first;
  for (int k = 0; k < 3; ++k) {
    const auto [u, v, w] = M_[k];
    const double up = w * one.up_m + origin_[k];
    const double rise = w * one.sin_elevation;
    double* const origin = origins + k * stride;
    double* const direction = directions + k * stride;
    for (int n = 0; n < count; ++n) {
      const double cos_e = cos_head[n] * one.cos_lag - sin_head[n] * one.sin_lag;
      const double sin_e = sin_head[n] * one.cos_lag + cos_head[n] * one.sin_lag;
      const double c = cos_e * one.cos_offset - sin_e * one.sin_offset;
      const double s = sin_e * one.cos_offset + cos_e * one.sin_offset;
      direction[n] = u * (one.cos_elevation * c) - v * (one.cos_elevation * s) + rise;
      origin[n] = u * (one.left_m * s + one.forward_m * cos_e) + v * (one.left_m * c - one.forward_m * sin_e) + up;
    }
  }
}

Vec3 AimedBeams::point_in_vehicle(const Vec3& point, const Vec3& origin) const {
  const Vec3 turned = direction_in_vehicle(point);
  const Vec3& at = place_.position_m;
  return {turned[0] + (at[0] - origin[0]), turned[1] + (at[1] - origin[1]), turned[2] + (at[2] - origin[2])};
}

Vec3 AimedBeams::direction_in_vehicle(const Vec3& direction) const {
  const double c = place_.cos_heading;
  const double s = place_.sin_heading;
  return {c * direction[0] + -s * direction[1], s * direction[0] + c * direction[1], direction[2]};
}

}  // namespace lidarcfg::returns
