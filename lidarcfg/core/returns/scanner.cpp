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
constexpr double around_m = 1e-6;  // that a box is wider, for rounding
constexpr double fov_rad = 1e-11;  // by which a field of view is wider, for rounding
constexpr double steep_rad = 1.5;
constexpr double band_rad = 1e-3;          // that firings of heads that stand still have of elevation, at least
constexpr std::int32_t middle_heads = 64;  // of the surest firing, that come first
constexpr double inf = std::numeric_limits<double>::infinity();

double floor_modulo(double value, double divisor) {
  const double rest = std::fmod(value, divisor);
  return rest < 0 ? rest + divisor : rest;
}

/// How high bands are: about as high as four of a band's rays that follow each other are wide.
double band_height(View<const double> elevation_rad) {
  if (elevation_rad.empty()) {
    return band_rad;
  }
  const auto [low, high] = std::ranges::minmax(elevation_rad);
  return std::max(band_rad, std::sqrt(4.0 * turn * (high - low) / elevation_rad.size()));
}

/// A beam of a firing, in the sensor's frame.
struct Beam {
  Vec3 way;      // forward, right, up
  Vec3 start_m;  // forward, left, up

  Beam(const Scanner::Firing& one, double cos_head, double sin_head) {
    const double cos_e = cos_head * one.cos_lag - sin_head * one.sin_lag;
    const double sin_e = sin_head * one.cos_lag + cos_head * one.sin_lag;
    const double c = cos_e * one.cos_offset - sin_e * one.sin_offset;
    const double s = sin_e * one.cos_offset + cos_e * one.sin_offset;
    way = {one.cos_elevation * c, one.cos_elevation * s, one.sin_elevation};
    start_m = {one.left_m * s + one.forward_m * cos_e, one.left_m * c - one.forward_m * sin_e, one.up_m};
  }
};

/// Whether a ray may be in an object's bounding box somewhere.
bool passes_box(const AimedBeams::Ray& ray, const TargetShape& target) {
  double enters = 0;
  double leaves = inf;
  for (int k = 0; k < 3; ++k) {
    const double low = (target.low_m[k] - around_m - ray.origin[k]) / ray.direction[k];
    const double high = (target.high_m[k] + around_m - ray.origin[k]) / ray.direction[k];
    const bool down = std::signbit(ray.direction[k]);
    enters = std::max(enters, down ? high : low);  // the first, if the second is no number
    leaves = std::min(leaves, down ? low : high);
  }
  return enters <= leaves;
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
    beside_m_ = std::max(beside_m_, std::sqrt(one.forward_m * one.forward_m + one.left_m * one.left_m));
    firings_.push_back(one);
  }
  if (stands_still()) {
    still_ = still_of(columns, firings_);
    firings_ = {};
  }
}

std::shared_ptr<const Scanner::StillFirings> Scanner::still_of(const ScannerColumns& columns,
                                                               View<const Firing> firings) const {
  struct One {
    Index firing;
    double band;
  };
  std::vector<One> order;
  const double height = band_height(columns.elevation_rad);
  for (Index f = 0; f < std::ssize(firings); ++f) {
    if (!is_outside(firings[f], columns.phase[f])) {
      const double band = std::floor(columns.elevation_rad[f] / height);
      order.push_back({f, firings[f].steep ? std::copysign(inf, firings[f].rise) : band});
    }
  }
  std::ranges::stable_sort(order, {}, [&](const One& one) { return std::pair(one.band, firings[one.firing].lag_rad); });
  auto out = std::make_shared<StillFirings>();
  for (std::size_t n = 0; n < order.size(); ++n) {
    const Firing& one = firings[order[n].firing];
    const std::int32_t phase = columns.phase[order[n].firing];
    const Beam beam(one, heads_->cos[phase], heads_->sin[phase]);
    if (n == 0 || order[n - 1].band != order[n].band) {
      const auto first = static_cast<Index>(n);
      out->bands.push_back({first, first, one.steep, one.rise, one.rise, one.up_m, one.up_m});
    }
    Band& band = out->bands.back();
    ++band.end;
    band.least_rise = std::min(band.least_rise, one.rise);
    band.most_rise = std::max(band.most_rise, one.rise);
    band.least_up_m = std::min(band.least_up_m, one.up_m);
    band.most_up_m = std::max(band.most_up_m, one.up_m);
    out->azimuth_rad.push_back(one.lag_rad);
    out->rise.push_back(one.rise);
    out->phase.push_back(phase);
    for (int k = 0; k < 3; ++k) {
      out->way[k].push_back(beam.way[k]);
      out->start_m[k].push_back(beam.start_m[k]);
    }
  }
  return out;
}

bool Scanner::sees_all_around() const { return fov_rad_[1] >= turn; }

bool Scanner::is_outside(const Firing& firing, Index head) const {
  if (sees_all_around()) {
    return false;
  }
  const double turned =
      floor_modulo(start_rad_ + static_cast<double>(head) * step_rad_ + firing.gating_rad - fov_rad_[0], turn);
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

  /// Between which rises beams that start so high may be at the box's height at its distance.
  struct Rises {
    double least;
    double most;
  };

  Rises rises(double up_m) const {
    const double low = low_m - up_m;
    const double high = high_m - up_m;
    const double least = low / (low < 0 ? near_m : far_m);
    const double most = high / (high <= 0 ? far_m : near_m);
    return {least - wider * (1 + std::abs(least)), most + wider * (1 + std::abs(most))};
  }

  /// Whether a firing may be at the box's height at its distance.
  bool meets(double rise, double up_m, bool steep) const {
    if (steep) {  // the object stays away from the axis, or is around it
      return rise > 0 ? rise * near_m <= high_m - up_m : rise * near_m >= low_m - up_m;
    }
    const auto [least, most] = rises(up_m);
    return least <= rise && rise <= most;
  }

  /// The rise to the middle of the box.
  double middle() const { return (low_m + high_m) / (near_m + far_m); }
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
    add_still(seen);
    return;
  }
  for (Index f = 0; f < std::ssize(scanner.firings()); ++f) {
    const Scanner::Firing& one = scanner.firings()[f];
    if (seen.meets(one.rise, one.up_m, one.steep)) {
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
  const double middle = seen.middle();
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
  return {
      centre - lidarcfg::atan(left) - more, centre - lidarcfg::atan(right) + more, near - beside_m, far_m, *low, *high};
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

/// Add the firings, of heads that stand still, that point at a window: first those at its middle.
void AimedBeams::add_still(const Window& window) {
  const double begin = wrapped(window.first_rad);
  const double end = begin + (window.last_rad - window.first_rad);
  Index first = 0;
  for (const Scanner::Band& band : scanner_->still().bands) {
    const Index before = std::ssize(heads_);
    add_still(window, band, begin, std::min(end, turn));
    add_still(window, band, 0, std::min(end - turn, std::nextafter(begin, -1.0)));
    const Index added = std::ssize(heads_) - before;
    if (added > 0 && window.near_m > 0 && band.least_rise <= window.middle()) {
      first = before + added / 2;
    }
  }
  std::rotate(heads_.begin(), heads_.begin() + first, heads_.end());
}

/// Add those firings of a band that point at a window, from one azimuth to another.
void AimedBeams::add_still(const Window& window, const Scanner::Band& band, double begin_rad, double end_rad) {
  const bool level = band.least_up_m == band.most_up_m;
  const double least = window.rises(band.most_up_m).least;
  const double most = window.rises(band.least_up_m).most;
  if (!band.steep && !(band.most_rise >= least && band.least_rise <= most)) {
    return;
  }
  const Scanner::StillFirings& still = scanner_->still();
  const double* const azimuth = still.azimuth_rad.data();
  Index f = std::lower_bound(azimuth + band.first, azimuth + band.end, begin_rad) - azimuth;
  for (; f < band.end && azimuth[f] <= end_rad; ++f) {
    const double rise = still.rise[f];
    const bool meets =
        level && !band.steep ? least <= rise && rise <= most : window.meets(rise, still.start_m[2][f], band.steep);
    if (meets && passes_box(still_ray(f), *target_)) {
      heads_.push_back({static_cast<std::int32_t>(f), still.phase[f], still.phase[f] + 1});
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

AimedBeams::Ray AimedBeams::still_ray(Index f) const {
  const auto& [way_x, way_y, way_z] = scanner_->still().way;
  const auto& [start_x, start_y, start_z] = scanner_->still().start_m;
  Ray ray;
  for (int k = 0; k < 3; ++k) {
    const auto [u, v, w] = M_[k];
    ray.direction[k] = u * way_x[f] - v * way_y[f] + w * way_z[f];
    ray.origin[k] = u * start_x[f] + v * start_y[f] + (w * start_z[f] + origin_[k]);
  }
  return ray;
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
