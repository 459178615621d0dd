#include "packets/block_points.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <stdexcept>

#include "maths.h"
#include "packets/velodyne.h"
#include "times.h"

namespace lidarcfg::packets {
namespace {

constexpr Index width = slots_per_column;

/// Rows for one column, where the caller's end.
struct SpareRows {
  Column<Vec3> xyz_m;
  Column<double> range_m, azimuth_rad;
  Column<std::int64_t> time_ns;
  Column<std::uint8_t> laser, ring, intensity, return_type;

  Returns columns(bool polar) {
    const std::size_t few = polar ? width : 0;
    return {xyz_m, {range_m.data(), few}, {azimuth_rad.data(), few}, time_ns, laser, ring, intensity, return_type};
  }
};

void copy(const Returns& from, Index count, const Returns& to, Index row) {
  std::copy_n(from.xyz_m.begin(), count, to.xyz_m.begin() + row);
  std::copy_n(from.time_ns.begin(), count, to.time_ns.begin() + row);
  std::copy_n(from.laser.begin(), count, to.laser.begin() + row);
  std::copy_n(from.ring.begin(), count, to.ring.begin() + row);
  std::copy_n(from.intensity.begin(), count, to.intensity.begin() + row);
  std::copy_n(from.return_type.begin(), count, to.return_type.begin() + row);
  if (to.polar()) {
    std::copy_n(from.range_m.begin(), count, to.range_m.begin() + row);
    std::copy_n(from.azimuth_rad.begin(), count, to.azimuth_rad.begin() + row);
  }
}

/// Write one of four bytes of each value.
void spread(const Column<std::uint32_t>& values, int shift, std::uint8_t* to) {
  Column<std::uint8_t> bytes;
  for (Index n = 0; n < width; ++n) {
    bytes[n] = values[n] >> shift & 255;
  }
  std::copy_n(bytes.data(), width, to);
}

}  // namespace

BlockPoints::BlockPoints(const Slots& slots, const Lasers& lasers, double unit_m)
    : beams_((slots.laser.size() + width - 1) / width),
      unit_m_(unit_m),
      paired_(!slots.other.empty()),
      forward_(false),
      near_(lasers.near_offset.rows() > 0),
      focal_(lasers.focal.rows() > 0) {
  for (Index slot = 0; slot < std::ssize(slots.laser); ++slot) {
    Beams& beams = beams_[slot / width];
    const Index i = slot % width;
    const Index k = slots.laser[slot];
    beams.laser_ring[i] = static_cast<int>(k) | lasers.ring[k] << 8;
    beams.kind[i] = slots.kind[slot];
    beams.other[i] = paired_ ? static_cast<int>(slots.other[slot]) : 0;
    beams.cos_w[i] = lidarcfg::cos(lasers.elevation[k]);
    beams.sin_w[i] = lidarcfg::sin(lasers.elevation[k]);
    beams.azimuth_offset[i] = lasers.azimuth_offset[k];
    beams.cos_o[i] = lidarcfg::cos(lasers.azimuth_offset[k]);
    beams.sin_o[i] = lidarcfg::sin(lasers.azimuth_offset[k]);
    beams.forward[i] = lasers.forward[k];
    beams.left[i] = lasers.left[k];
    beams.up[i] = lasers.up[k];
    beams.offset[i] = lasers.distance_offset[k];
    beams.near_x[i] = near_ ? lasers.near_offset(k, 0) : 0;
    beams.near_y[i] = near_ ? lasers.near_offset(k, 1) : 0;
    for (Index n = 0; n < 4; ++n) {
      beams.focal[i][n] = focal_ ? lasers.focal(k, n) : 0;
    }
    forward_ = forward_ || lasers.forward[k] != 0;
  }
}

Index BlockPoints::write(const Group& group, const Returns& out, Index row) const {
  Index found = 0;
  for (Index column = 0; column < columns(); ++column) {
    Points points;
    locate(group, column, points);
    if (paired_) {
      pair(group, column, points);
    }
    if (row + found + width <= out.size()) {
      found += store(group, column, points, out, row + found);
      continue;
    }
    SpareRows spare;
    const Returns rows = spare.columns(out.polar());
    const Index count = store(group, column, points, rows, 0);
    if (row + found + count > out.size()) {
      throw std::invalid_argument("out: fewer rows than returns");
    }
    copy(rows, count, out, row + found);
    found += count;
  }
  return found;
}

void BlockPoints::locate(const Group& group, Index column, Points& points) const {
  const Beams& beams = beams_[column];
  const int* distance = &group.distance[column * width];
  const int* intensity = &group.intensity[column * width];
  const Turned& turned = group.turned[column];
  const double cos_g = group.cos_azimuth;
  const double sin_g = group.sin_azimuth;
  Column<double> cos_h, sin_h;  // of the head's direction
  Column<double> c, s;          // of the beam's
  Column<double> ahead, side;   // the distance, by which x and y are corrected apart
  for (Index k = 0; k < width; ++k) {
    cos_h[k] = cos_g * turned.cos[k] - sin_g * turned.sin[k];
    sin_h[k] = sin_g * turned.cos[k] + cos_g * turned.sin[k];
    c[k] = cos_h[k] * beams.cos_o[k] - sin_h[k] * beams.sin_o[k];
    s[k] = sin_h[k] * beams.cos_o[k] + cos_h[k] * beams.sin_o[k];
    ahead[k] = distance[k] * unit_m_ + beams.offset[k];
    side[k] = ahead[k];
  }
  if (near_) {
    correct_near(beams, distance, c, s, ahead, side);
  }
  for (Index k = 0; k < width; ++k) {
    points.x[k] = ahead[k] * beams.cos_w[k] * c[k];
    points.y[k] = beams.left[k] * c[k] - side[k] * beams.cos_w[k] * s[k];
    points.z[k] = (ahead[k] + side[k]) / 2 * beams.sin_w[k] + beams.up[k];
  }
  if (forward_) {
    for (Index k = 0; k < width; ++k) {
      points.x[k] += beams.forward[k] * cos_h[k];
      points.y[k] -= beams.forward[k] * sin_h[k];
    }
  }
  for (Index k = 0; k < width; ++k) {
    points.x[k] += beams.left[k] * s[k];
    points.kept[k] = distance[k] != 0;
    points.intensity[k] = intensity[k];
    points.kind[k] = group.kind;
  }
  if (focal_) {
    for (Index k = 0; k < width; ++k) {
      points.intensity[k] = Focus(beams.focal[k]).correct(intensity[k], distance[k]);
    }
  }
}

/// Correct the distances near by; z gets the mean of both.
void BlockPoints::correct_near(const Beams& beams, const int* distance, const Column<double>& c,
                               const Column<double>& s, Column<double>& ahead, Column<double>& side) const {
  for (Index k = 0; k < width; ++k) {
    if (distance[k] * unit_m_ < far_m) {
      const double range_m = ahead[k];
      const double flat_m = range_m * beams.cos_w[k];
      const double to_x = std::abs(flat_m * s[k] - beams.left[k] * c[k]);
      const double to_y = std::abs(flat_m * c[k] + beams.left[k] * s[k]);
      side[k] = range_m + (beams.near_x[k] - beams.offset[k]) * (far_m - to_x) / (far_m - near_x_m);
      ahead[k] = range_m + (beams.near_y[k] - beams.offset[k]) * (far_m - to_y) / (far_m - near_y_m);
    }
  }
}

/// Tell which of a column's dual returns are returns of their own, and of which kind.
void BlockPoints::pair(const Group& group, Index column, Points& points) const {
  const Beams& beams = beams_[column];
  const int* distance = &group.distance[column * width];
  const int* intensity = &group.intensity[column * width];
  Column<int> other_distance, other_intensity;
  for (Index k = 0; k < width; ++k) {
    other_distance[k] = group.distance[beams.other[k]];
    other_intensity[k] = group.intensity[beams.other[k]];
  }
  for (Index k = 0; k < width; ++k) {
    const bool differs = (distance[k] != other_distance[k]) | (intensity[k] != other_intensity[k]);
    const bool weaker = (other_distance[k] != 0) & (intensity[k] < other_intensity[k]);
    const bool is_strongest = beams.kind[k] == strongest;
    points.kept[k] &= is_strongest | differs;
    points.kind[k] = is_strongest & differs & weaker ? second_strongest : beams.kind[k];
  }
}

/// Write what is kept of a column from a row on, after which there are enough for all slots; returns how many.
Index BlockPoints::store(const Group& group, Index column, const Points& points, const Returns& out, Index row) const {
  const Beams& beams = beams_[column];
  const std::int64_t* offset_ns = &group.offset_ns[column * width];
  const std::int64_t began_ns = group.began_ns;
  Vec3* const xyz_m = &out.xyz_m[row];
  std::int64_t* const time_ns = &out.time_ns[row];
  Column<std::uint32_t> marks;  // laser, ring, intensity and kind, a byte each
  for (Index k = 0; k < width; ++k) {
    marks[k] = beams.laser_ring[k] | points.intensity[k] << 16 | points.kind[k] << 24;
  }
  Index found = 0;
  for (Index k = 0; k < width; ++k) {  // what is not kept is written over: no branch
    xyz_m[found] = {points.x[k], points.y[k], points.z[k]};
    time_ns[found] = later(began_ns, offset_ns[k]);
    marks[found] = marks[k];
    found += points.kept[k];
  }
  spread(marks, 0, &out.laser[row]);
  spread(marks, 8, &out.ring[row]);
  spread(marks, 16, &out.intensity[row]);
  spread(marks, 24, &out.return_type[row]);
  if (!out.polar()) {
    return found;
  }
  Index at = row;
  for (Index k = 0; k < width; ++k) {
    if (points.kept[k] != 0) {
      constexpr double turn = 2 * std::numbers::pi;
      const double angle = group.azimuth_rad + group.turned[column].angle_rad[k] + beams.azimuth_offset[k];
      out.range_m[at] = group.distance[column * width + k] * unit_m_ + beams.offset[k];
      out.azimuth_rad[at] = angle - turn * std::floor(angle / turn);
      ++at;
    }
  }
  return found;
}

}  // namespace lidarcfg::packets
