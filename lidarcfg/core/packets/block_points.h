/// The points of blocks, in columns of 32 returns, for all makers whose packets have such.
#pragma once

#include <limits>
#include <vector>

#include "packets/blocks.h"
#include "packets/returns.h"

namespace lidarcfg::packets {

/// What is known of the W slots of each of a packet's G groups of blocks, which are fired together.
struct Slots {
  View<const std::int64_t> laser;      // (W,)
  Rows<const double> fraction;         // (G, W) of the step from the group's azimuth to the next one's
  Rows<const std::int64_t> offset_ns;  // (G, W) after the packet's stamp
  View<const std::uint8_t> kind;       // (W,) with dual returns: 0 strongest, 1 last
  View<const std::int64_t> other;      // (W,) where in the group the pair's other return is; empty with single returns
};

/// The L lasers: angles in radians, lengths in metres.
struct Lasers {
  View<const double> elevation;
  View<const double> azimuth_offset;
  View<const double> forward;  // where the beam begins, along the head's direction
  View<const double> left;     // the same, across the beam's direction
  View<const double> up;
  View<const double> distance_offset;
  View<const std::uint8_t> ring;
  Rows<const double> near_offset;  // (L, 2), or (0, 2) if distances near by are as those far off
  Rows<const double> focal;        // (L, 4) as `Focus` has it, or (0, 4) if intensities are right as they come
};

/// A value for each slot of a column.
template <class T>
using Column = std::array<T, slots_per_column>;

/// How far the head has turned at each slot of a column since the group's azimuth.
struct Turned {
  double step = std::numeric_limits<double>::quiet_NaN();  // for which this was computed
  Column<double> angle_rad;
  Column<double> cos;
  Column<double> sin;
};

/// A group of blocks of one packet.
struct Group {
  View<const int> distance;            // (whole columns,) in units of the packet; 0 is no return
  View<const int> intensity;           // (whole columns,)
  View<const Turned> turned;           // (columns,)
  View<const std::int64_t> offset_ns;  // (whole columns,)
  double azimuth_rad;
  double cos_azimuth;
  double sin_azimuth;
  std::int64_t began_ns;
  std::uint8_t kind;  // of single returns
};

/// Computes points by the tables of a sensor, which it owns.
class BlockPoints {
 public:
  BlockPoints(const Slots& slots, const Lasers& lasers, double unit_m);

  /// The number of columns in a group.
  Index columns() const { return std::ssize(beams_); }

  /// Write an entry for each of a group's returns, from a row on; returns how many. Of an identical pair, only the
  /// first is a return, the strongest. Throws std::invalid_argument if there are not enough rows.
  Index write(const Group& group, const Returns& out, Index row) const;

 private:
  /// The lasers of a column's slots.
  struct Beams {
    Column<int> laser_ring;  // laser, and 256 times the ring
    Column<int> kind;
    Column<int> other;
    Column<double> cos_w, sin_w;  // of the elevation
    Column<double> azimuth_offset, cos_o, sin_o;
    Column<double> forward, left, up;
    Column<double> offset, near_x, near_y;  // of the distance
    Column<std::array<double, 4>> focal;
  };

  /// A column's points, of slots with a return and of those without.
  struct Points {
    Column<double> x, y, z;
    Column<int> kept;
    Column<int> intensity, kind;
  };

  void locate(const Group& group, Index column, Points& points) const;
  void correct_near(const Beams& beams, const int* distance, const Column<double>& c, const Column<double>& s,
                    Column<double>& ahead, Column<double>& side) const;
  void pair(const Group& group, Index column, Points& points) const;
  Index store(const Group& group, Index column, const Points& points, const Returns& out, Index row) const;

  std::vector<Beams> beams_;  // (columns,)
  double unit_m_;
  bool paired_;
  bool forward_;
  bool near_;
  bool focal_;
};

}  // namespace lidarcfg::packets
