#include "placement/scanner.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "simd.h"

namespace lidarcfg::placement {
namespace {

constexpr double turn = 2 * std::numbers::pi;
constexpr double ahead_m = 1e-9;   // an object's corners are all at least so far ahead of a sensor, or its beams all
                                   // around are traced
constexpr double wider = 1e-9;     // of azimuths and slopes, for rounding
constexpr double fov_rad = 1e-11;  // by which a field of view is wider, for rounding
constexpr double steep_rad = 1.5;
constexpr int most_slabs = 8;
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
    one.lag_rad = columns.lag_rad[f];
    one.gating_rad = columns.gating_rad[f];
    one.offset_rad = columns.offset_rad[f];
    one.steep = std::abs(elevation) > steep_rad;
    one.rise = std::tan(std::clamp(elevation, -1.5707963, 1.5707963));
    one.cos_lag = std::cos(one.lag_rad);
    one.sin_lag = std::sin(one.lag_rad);
    one.cos_offset = std::cos(one.offset_rad);
    one.sin_offset = std::sin(one.offset_rad);
    one.cos_elevation = std::cos(elevation);
    one.sin_elevation = std::sin(elevation);
    one.forward_m = columns.start_m(f, 0);
    one.left_m = columns.start_m(f, 1);
    one.up_m = columns.start_m(f, 2);
    beside_m_ = std::max(beside_m_, std::sqrt(one.forward_m * one.forward_m + one.left_m * one.left_m));
    firings_.push_back(one);
  }
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

namespace {

/// What holds the parts of shapes between two heights, seen from above: its support in eight directions.
class Octagon {
 public:
  void add(double x, double y, double z) {
    for (int k = 0; k < 8; ++k) {
      reach_[k] = std::max(reach_[k], x * directions[k][0] + y * directions[k][1]);
    }
    low_ = std::min(low_, z);
    high_ = std::max(high_, z);
  }

  bool empty() const { return low_ > high_; }

  Hull hull() const {
    Hull out;
    for (int k = 0; k < 8; ++k) {  // where two neighbouring sides meet
      const auto& [ax, ay] = directions[k];
      const auto& [bx, by] = directions[(k + 1) % 8];
      const double a = reach_[k] + wider;
      const double b = reach_[(k + 1) % 8] + wider;
      const double area = ax * by - ay * bx;
      out.x[k] = out.x[8 + k] = (a * by - b * ay) / area;
      out.y[k] = out.y[8 + k] = (b * ax - a * bx) / area;
      out.z[k] = low_ - wider;
      out.z[8 + k] = high_ + wider;
    }
    return out;
  }

 private:
  static constexpr double half = std::numbers::sqrt2 / 2;
  static constexpr double directions[8][2] = {{1, 0},  {half, half},   {0, 1},  {-half, half},
                                              {-1, 0}, {-half, -half}, {0, -1}, {half, -half}};

  double reach_[8] = {-inf, -inf, -inf, -inf, -inf, -inf, -inf, -inf};
  double low_ = inf;
  double high_ = -inf;
};

/// Add the part of a polygon's edge between two heights.
void add_edge(const Vec3& from, const Vec3& to, double low_m, double high_m, Octagon& out) {
  for (const double height : {low_m, high_m}) {
    const double share = (height - from[2]) / (to[2] - from[2]);
    if (0 < share && share < 1) {
      out.add(from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1]), height);
    }
  }
  if (low_m <= from[2] && from[2] <= high_m) {
    out.add(from[0], from[1], from[2]);
  }
}

/// Add the part of a shape between two heights.
void add_shape(const world::Leaf& leaf, world::Kind kind, double low_m, double high_m, Octagon& out) {
  if (kind == world::Kind::triangle) {
    const world::Shape& shape = leaf.shape;
    const Vec3 corners[3] = {
        {shape[0], shape[1], shape[2]}, {shape[3], shape[4], shape[5]}, {shape[6], shape[7], shape[8]}};
    for (int n = 0; n < 3; ++n) {
      add_edge(corners[n], corners[(n + 1) % 3], low_m, high_m, out);
    }
  } else if (leaf.box.low[2] <= high_m && low_m <= leaf.box.high[2]) {
    for (const float x : {leaf.box.low[0], leaf.box.high[0]}) {
      for (const float y : {leaf.box.low[1], leaf.box.high[1]}) {
        out.add(x, y, std::max<double>(leaf.box.low[2], low_m));
        out.add(x, y, std::min<double>(leaf.box.high[2], high_m));
      }
    }
  }
}

std::vector<Hull> slabs_of(const world::Bvh& bvh, double low_m, double high_m) {
  std::vector<Hull> out;
  for (int n = 0; n < most_slabs; ++n) {
    Octagon octagon;
    const double low = low_m + (high_m - low_m) * n / most_slabs;
    const double high = n + 1 < most_slabs ? low_m + (high_m - low_m) * (n + 1) / most_slabs : inf;
    for (Index s = 0; s < bvh.size(); ++s) {
      add_shape(bvh.leaves[s], bvh.kind[s], n ? low : -inf, high, octagon);
    }
    if (!octagon.empty()) {
      out.push_back(octagon.hull());
    }
  }
  return out;
}

}  // namespace

TargetShape::TargetShape(const world::Bvh& bvh, const Vec3& low_m, const Vec3& high_m)
    : bvh(bvh), slabs(slabs_of(bvh, low_m[2], high_m[2])) {
  for (int corner = 0; corner < Hull::size; ++corner) {
    box.x[corner] = corner & 1 ? high_m[0] : low_m[0];
    box.y[corner] = corner & 2 ? high_m[1] : low_m[1];
    box.z[corner] = corner & 4 ? high_m[2] : low_m[2];
  }
}

/// Whether a firing may be at the hull's height at its distance.
bool AimedBeams::Window::meets(const Scanner::Firing& firing) const {
  if (near_m == 0) {
    return true;
  }
  const double low = low_m - firing.up_m;
  const double high = high_m - firing.up_m;
  if (firing.steep) {  // the object stays away from the axis
    return firing.rise > 0 ? firing.rise * near_m <= high : firing.rise * near_m >= low;
  }
  const double least = low / (low < 0 ? near_m : far_m);
  const double most = high / (high < 0 ? far_m : near_m);
  return least - wider * (1 + std::abs(least)) <= firing.rise && firing.rise <= most + wider * (1 + std::abs(most));
}

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
  const Hull& box = target.box;
  Vec3 middle;  // as seen from the sensor
  for (int k = 0; k < 3; ++k) {
    middle[k] = M_[0][k] * ((box.x[0] + box.x[7]) / 2 - origin_[0]) +
                M_[1][k] * ((box.y[0] + box.y[7]) / 2 - origin_[1]) +
                M_[2][k] * ((box.z[0] + box.z[7]) / 2 - origin_[2]);
  }
  const double length = std::sqrt(middle[0] * middle[0] + middle[1] * middle[1]);
  to_x_ = length > 0 ? middle[0] / length : 1;
  to_y_ = length > 0 ? middle[1] / length : 0;
  centre_rad_ = -std::atan2(to_y_, to_x_);
  heads_.clear();
  box_ = window(box);
  if (box_.near_m > scanner.most_m() * (1 + wider) + wider) {
    return;
  }
  for (Index f = 0; f < std::ssize(scanner.firings()); ++f) {
    if (box_.meets(scanner.firings()[f])) {
      add(box_.first_rad, box_.last_rad, f);
    }
  }
}

void AimedBeams::tighten() {
  windows_.clear();
  for (const Hull& slab : target_->slabs) {
    windows_.push_back(window(slab));
    if (windows_.back().near_m == 0) {
      return;
    }
  }
  heads_.clear();
  for (Index f = 0; f < std::ssize(scanner_->firings()); ++f) {
    double first = inf;
    double last = -inf;
    for (const Window& one : windows_) {
      if (one.meets(scanner_->firings()[f])) {
        first = std::min(first, one.first_rad);
        last = std::max(last, one.last_rad);
      }
    }
    if (first <= last) {
      add(first, last, f);
    }
  }
  put_middle_first();
}

/// Have the beams come first that are the surest to hit: those of the firing nearest to the middle of the box.
void AimedBeams::put_middle_first() {
  if (heads_.empty()) {
    return;
  }
  const double middle = (box_.low_m + box_.high_m) / (box_.near_m + box_.far_m);
  const auto off = [&](const Heads& some) { return std::abs(scanner_->firings()[some.firing].rise - middle); };
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

AimedBeams::Window AimedBeams::window(const Hull& hull) const {
  using simd::Doubles;
  Doubles near = Doubles{} + inf;
  Doubles far{};
  Doubles left = Doubles{} - inf;  // tangents of angles from the middle of the box
  Doubles right = Doubles{} + inf;
  Doubles low = Doubles{} + inf;
  Doubles high = Doubles{} - inf;
  for (int n = 0; n < Hull::size; n += simd::lanes<double>) {
    const Doubles px = simd::load<Doubles>(&hull.x[n]) - origin_[0];
    const Doubles py = simd::load<Doubles>(&hull.y[n]) - origin_[1];
    const Doubles pz = simd::load<Doubles>(&hull.z[n]) - origin_[2];
    const Doubles x = M_[0][0] * px + M_[1][0] * py + M_[2][0] * pz;
    const Doubles y = M_[0][1] * px + M_[1][1] * py + M_[2][1] * pz;
    const Doubles z = M_[0][2] * px + M_[1][2] * py + M_[2][2] * pz;
    const Doubles ahead = x * to_x_ + y * to_y_;
    const Doubles aside = (y * to_x_ - x * to_y_) / ahead;
    near = simd::min(near, ahead);
    far = simd::max(far, x * x + y * y);
    left = simd::max(left, aside);
    right = simd::min(right, aside);
    low = simd::min(low, z);
    high = simd::max(high, z);
  }
  const double near_m = -simd::highest(-near);
  const double low_m = -simd::highest(-low);
  const double high_m = simd::highest(high);
  const double beside_m = scanner_->beside_m();
  if (!(near_m > beside_m + ahead_m)) {
    return {0.0, turn, 0.0, inf, low_m, high_m};
  }
  const double more = std::asin(beside_m / near_m) + wider;
  return {centre_rad_ - std::atan(simd::highest(left)) - more,
          centre_rad_ - std::atan(-simd::highest(-right)) + more,
          near_m - beside_m,
          std::sqrt(simd::highest(far)) + beside_m,
          low_m,
          high_m};
}

/// Add the heads at which a firing points from one azimuth to another and may be in the field of view.
void AimedBeams::add(double first_rad, double last_rad, Index firing) {
  const Scanner::Firing& one = scanner_->firings()[firing];
  double begin = wrapped(first_rad - one.offset_rad - one.lag_rad - scanner_->start_rad());
  double end = begin + (last_rad - first_rad);
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

}  // namespace lidarcfg::placement
