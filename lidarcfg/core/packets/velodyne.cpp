#include "packets/velodyne.h"

#include <algorithm>
#include <cmath>

namespace lidarcfg::packets {
namespace {

constexpr double focal_far_m = 131.0;
constexpr double distance_max = 65535;
constexpr int steps_max = 40;  // to a correction near by; of a real unit's, each leaves a hundredth of what is wrong
constexpr double settled_m = 1e-9;

std::uint8_t to_byte(double value) { return value > 0 ? static_cast<std::uint8_t>(std::min(value, 255.0)) : 0; }

double square(double value) { return value * value; }

/// Where one laser's beam points, and its offsets.
struct NearBeam {
  double cos_w, sin_w;  // of the elevation
  double c, s;          // of the azimuth
  double left_m, offset_m, near_x_m, near_y_m;

  /// Whole units up to `most`, where x and y are corrected apart: those whose point is nearest along the beam.
  ///
  /// Beyond `most` nothing is corrected, with a jump: one more where that point is nearer.
  double units(double range_m, double unit_m, double most) const {
    const double side =
        (near_x_m - offset_m) / (far_m - packets::near_x_m) * (cos_w * cos_w * s * s + sin_w * sin_w / 2);
    const double ahead =
        (near_y_m - offset_m) / (far_m - packets::near_y_m) * (cos_w * cos_w * c * c + sin_w * sin_w / 2);
    const double last_m = most * unit_m + offset_m;
    double added_m = 0;
    for (int n = 0; n < steps_max; ++n) {
      const double before_m = added_m;
      const double flat_m = std::min(range_m - added_m, last_m) * cos_w;
      const double to_x = std::abs(flat_m * s - left_m * c);
      const double to_y = std::abs(flat_m * c + left_m * s);
      added_m = side * (far_m - to_x) + ahead * (far_m - to_y);
      if (std::abs(added_m - before_m) < settled_m) {
        break;
      }
    }
    if (range_m > last_m + (unit_m + added_m) / 2) {
      return most + 1;
    }
    return std::min(std::nearbyint((range_m - added_m - offset_m) / unit_m), most);
  }
};

}  // namespace

double Focus::offset(int distance) const {
  const double away = 256 * square(1 - distance_m / focal_far_m) - 256 * square(1 - distance / distance_max);
  return slope * std::abs(away);
}

std::uint8_t Focus::correct(std::uint8_t intensity, int distance) const {
  return to_byte(std::nearbyint(std::min(std::max(intensity + offset(distance), least), most)));
}

void write_near_returns(Rows<const double> range_m, Rows<const std::uint8_t> reflectivity, Rows<const double> azimuth,
                        View<const std::int64_t> number, View<const std::int64_t> laser, const NearLasers& lasers,
                        const Limits& limits, Rows<std::uint8_t> packets) {
  const Index each = azimuth.columns() == range_m.columns() ? 1 : 2;
  double most = std::floor(far_m / limits.unit_m) - 1;  // units of the last distance that is corrected so
  while ((most + 1) * limits.unit_m < far_m) {
    ++most;
  }
  for (Index p = 0; p < packets.rows(); ++p) {
    for (Index slot = 0; slot < std::ssize(number); ++slot) {
      const Index n = number[slot];
      const Index k = laser[slot];
      const double hit_m = range_m(p, n);
      const double offset_m = lasers.distance_offset[k];
      if (!(limits.least_m <= hit_m && hit_m <= limits.most_m) ||
          !(std::nearbyint((hit_m - offset_m) / limits.unit_m) <= most)) {
        continue;
      }
      const double angle = azimuth(p, n / each) + lasers.azimuth_offset[k];
      const NearBeam beam{std::cos(lasers.elevation[k]),
                          std::sin(lasers.elevation[k]),
                          std::cos(angle),
                          std::sin(angle),
                          lasers.left[k],
                          offset_m,
                          lasers.near_offset(k, 0),
                          lasers.near_offset(k, 1)};
      const double units = beam.units(hit_m, limits.unit_m, most);
      const bool sent = 0 < units && units <= limits.units_max;
      std::uint8_t* at = return_at<Velodyne>(packets[p], slot);
      set_word<Velodyne>(at, sent ? static_cast<std::uint16_t>(units) : 0);
      at[2] = sent ? reflectivity(p, n) : 0;
    }
  }
}

void uncorrect_intensities(View<const std::int64_t> laser, Rows<const double> focal, Rows<std::uint8_t> packets) {
  for (Index p = 0; p < packets.rows(); ++p) {
    for (Index slot = 0; slot < std::ssize(laser); ++slot) {
      std::uint8_t* at = return_at<Velodyne>(packets[p], slot);
      const int distance = word<Velodyne>(at);
      if (distance > 0) {
        at[2] = to_byte(std::nearbyint(at[2] - Focus(focal[laser[slot]]).offset(distance)));
      }
    }
  }
}

}  // namespace lidarcfg::packets
