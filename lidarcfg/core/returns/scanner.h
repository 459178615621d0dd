/// The revolutions of a sensor, and which of their beams point at an object.
///
/// Only rays that point at the object's bounding box are traced: their numbers follow from the box's azimuths and
/// slopes. They are traced in the object's frame, where its hierarchy is built once for all places.
#pragma once

#include <memory>
#include <vector>

#include "views.h"
#include "world/bvh.h"

namespace lidarcfg::returns {

using Matrix3 = std::array<Vec3, 3>;  // rows

/// A sensor's firing pattern, whatever its pose. `phases` revolutions that start at evenly shifted phases are woven
/// into one: H heads, F firings a head. Where heads stand still, there is one a phase, and each firing is of one.
struct ScannerColumns {
  View<const double> cos_head;  // (H,) of where heads are at the start of cycles, of all phases, ascending
  View<const double> sin_head;
  double start_rad;                  // of the first head
  double step_rad;                   // from one head to the next; 0: they stand still
  std::int64_t phases;               // head n is of phase n % phases
  View<const double> lag_rad;        // (F,) from the head's start to the encoder's angle at each firing
  View<const double> gating_rad;     // (F,) and to the angle that decides whether it is in the field of view
  View<const double> offset_rad;     // (F,) from the encoder's angle to the beam's azimuth
  View<const double> elevation_rad;  // (F,)
  Rows<const double> start_m;        // (F, 3) where the beam starts: forward, left, up
  View<const std::int32_t> phase;    // (F,) of each firing, if heads stand still
  std::array<double, 2> range_m;     // least, greatest
  std::array<double, 2> fov_rad;     // from, width
};

/// A sensor whose firing pattern is known; it does not change. Copies share the memory of heads, and of those that
/// stand still that of firings.
class Scanner {
 public:
  explicit Scanner(const ScannerColumns& columns);

  /// What is the same for all beams of a firing.
  struct Firing {
    double lag_rad;
    double gating_rad;
    double offset_rad;
    double rise;  // tangent of the elevation
    double cos_lag, sin_lag;
    double cos_offset, sin_offset;
    double cos_elevation, sin_elevation;
    double forward_m, left_m, up_m;
    bool steep;  // nearly along the axis
  };

  /// Those of heads that turn.
  View<const Firing> firings() const { return firings_; }

  /// Some of the firings of heads that stand still: those from one elevation to another.
  struct Band {
    Index first;
    Index end;
    bool steep;
    double least_rise, most_rise;
    double least_up_m, most_up_m;
  };

  /// The firings of heads that stand still, within the field of view: by columns, band after band upwards, and in each
  /// by ascending azimuth. Beams are forward, right and up.
  struct StillFirings {
    std::vector<Band> bands;
    std::vector<double> azimuth_rad;  // from 0 to a turn
    std::vector<double> rise;
    std::vector<double> way[3];
    std::vector<double> start_m[3];  // forward, left, up
    std::vector<std::int32_t> phase;
  };

  const StillFirings& still() const { return *still_; }

  Index heads() const { return std::ssize(heads_->cos); }
  const double* cos_head() const { return heads_->cos.data(); }
  const double* sin_head() const { return heads_->sin.data(); }
  double start_rad() const { return start_rad_; }
  double step_rad() const { return step_rad_; }
  int phases() const { return phases_; }
  double least_m() const { return range_m_[0]; }
  double most_m() const { return range_m_[1]; }
  double beside_m() const { return beside_m_; }  // the farthest that a beam starts from the axis
  double fov_from_rad() const { return fov_rad_[0]; }
  double fov_width_rad() const { return fov_rad_[1]; }
  bool sees_all_around() const;
  bool stands_still() const { return step_rad_ == 0; }

  /// Whether a firing at one of its heads is outside the field of view.
  bool is_outside(Index firing, Index head) const { return !stands_still() && is_outside(firings_[firing], head); }

 private:
  struct HeadAngles {
    std::vector<double> cos;
    std::vector<double> sin;
  };

  bool is_outside(const Firing& firing, Index head) const;
  std::shared_ptr<const StillFirings> still_of(const ScannerColumns& columns, View<const Firing> firings) const;

  std::shared_ptr<const HeadAngles> heads_;
  std::vector<Firing> firings_;
  std::shared_ptr<const StillFirings> still_;
  double start_rad_;
  double step_rad_;
  int phases_;
  std::array<double, 2> range_m_;
  std::array<double, 2> fov_rad_;
  double beside_m_;
};

/// Where a sensor is in the vehicle frame.
struct SensorPose {
  Matrix3 R;
  Vec3 t;

  bool operator==(const SensorPose&) const = default;
};

/// Where an object stands: on its lowest point, turned about it.
struct Place {
  Vec3 position_m;
  double cos_heading, sin_heading;
};

/// An object in its own frame, over its place; it does not change.
struct TargetShape {
  world::Bvh bvh;
  Vec3 low_m;  // corners of its bounding box
  Vec3 high_m;
};

/// The beams of a scanner at a pose that may hit an object at a place: all that point at its bounding box.
class AimedBeams {
 public:
  /// The heads from `first` to `end` at which a firing points at the box.
  struct Heads {
    std::int32_t firing;
    std::int32_t first;
    std::int32_t end;
  };

  void aim(const Scanner& scanner, const SensorPose& pose, const TargetShape& target, const Place& place);

  const Scanner& scanner() const { return *scanner_; }
  const TargetShape& target() const { return *target_; }
  View<const Heads> heads() const { return heads_; }

  /// At most so many of them are of one phase.
  std::int32_t most_of_a_phase();

  /// Write the rays of some heads, (3, `stride`) each, in the object's frame.
  void rays(const Heads& heads, double* origins, double* directions, int stride) const;

  struct Ray {
    Vec3 origin;
    Vec3 direction;
  };

  /// The ray of a firing of a head that stands still, in the object's frame.
  Ray still_ray(Index firing) const;

  /// A point of the object's frame in the vehicle's, relative to `origin`.
  Vec3 point_in_vehicle(const Vec3& point, const Vec3& origin) const;
  Vec3 direction_in_vehicle(const Vec3& direction) const;

 private:
  struct Window;

  Window window() const;
  void add(const Window& window, Index firing);
  void add_still(const Window& window);
  void add_still(const Window& window, const Scanner::Band& band, double begin_rad, double end_rad);
  void put_middle_first(const Window& seen);
  void add_heads(Index firing, double begin_rad, double end_rad);

  const Scanner* scanner_ = nullptr;
  const TargetShape* target_ = nullptr;
  Matrix3 M_;    // from the sensor's frame into the object's
  Vec3 origin_;  // where the sensor is in the object's frame
  Place place_;
  std::vector<Heads> heads_;
  std::vector<std::int32_t> by_phase_;
};

/// Add `times` how many of some heads are of each phase to counts (phases,).
void add_by_phase(const AimedBeams::Heads& heads, std::int32_t times, View<std::int32_t> counts);

}  // namespace lidarcfg::returns
