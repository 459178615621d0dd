#include <algorithm>
#include <cmath>

#include "bind/arguments.h"
#include "bind/modules.h"
#include "bind/world.h"
#include "maths.h"
#include "returns/clusters.h"
#include "returns/known_returns.h"

namespace lidarcfg::bind {
namespace {

using returns::KnownReturns;
using returns::Place;
using returns::RigAt;
using returns::Scanner;
using returns::ScannerColumns;
using returns::SensorPose;
using returns::Standing;
using returns::TargetShape;
using world::Obstacles;
using Scanners = std::vector<const Scanner*>;
using Places = View<const std::array<double, 4>>;
using Rotations = Shaped<Tables<const double>, -1, 3, 3>;
using Positions = View<const Vec3>;

void require_finite(View<const double> values, const char* message) {
  require(std::all_of(values.begin(), values.end(), [](double one) { return std::isfinite(one); }), message);
}

Scanner make_scanner(View<const double> cos_head, View<const double> sin_head, double start_rad, double step_rad,
                     std::int64_t phases, View<const double> lag_rad, View<const double> gating_rad,
                     View<const double> offset_rad, View<const double> elevation_rad,
                     Shaped<Rows<const double>, -1, 3> start_m, View<const std::int32_t> phase,
                     std::array<double, 2> range_m, std::array<double, 2> fov_rad) {
  const auto firings = lag_rad.size();
  require(cos_head.size() == sin_head.size(), "sin_head: one for each cos_head");
  require(step_rad == 0 || (step_rad >= 1e-8 && step_rad <= 10), "step_rad: not 0, nor from 1e-8 to 10");
  require(cos_head.size() < (std::size_t{1} << 31), "cos_head: too many heads");
  require(firings < (std::size_t{1} << 31), "lag_rad: too many firings");
  require(1 <= phases && phases <= 1 << 20, "phases: not from 1 to 2^20");
  require(gating_rad.size() == firings, "gating_rad: one for each firing");
  require(offset_rad.size() == firings, "offset_rad: one for each firing");
  require(elevation_rad.size() == firings, "elevation_rad: one for each firing");
  require(start_m.rows() == std::ssize(lag_rad), "start_m: one for each firing");
  if (step_rad == 0) {
    require(std::ssize(cos_head) == phases, "cos_head: one for each phase, where heads stand still");
    require(phase.size() == firings, "phase: one for each firing, where heads stand still");
    require(std::all_of(phase.begin(), phase.end(), [&](std::int32_t one) { return 0 <= one && one < phases; }),
            "phase: not below phases");
  } else {
    require(phase.empty(), "phase: only where heads stand still");
  }
  require_finite(lag_rad, "lag_rad: not finite");
  require_finite(gating_rad, "gating_rad: not finite");
  require_finite(offset_rad, "offset_rad: not finite");
  require_finite(elevation_rad, "elevation_rad: not finite");
  require_finite({start_m.data(), static_cast<std::size_t>(start_m.size())}, "start_m: not finite");
  require_finite(fov_rad, "fov_rad: not finite");
  require(std::isfinite(start_rad), "start_rad: not finite");
  return Scanner(ScannerColumns{cos_head, sin_head, start_rad, step_rad, phases, lag_rad, gating_rad, offset_rad,
                                elevation_rad, start_m, phase, range_m, fov_rad});
}

std::vector<Place> places_of(Places places) {
  std::vector<Place> out;
  for (const auto& [x, y, z, heading] : places) {
    out.push_back({{x, y, z}, lidarcfg::cos(heading), lidarcfg::sin(heading)});
  }
  return out;
}

std::vector<SensorPose> poses_of(Index sensors, Rotations R, Positions t) {
  require(R.tables() == sensors, "R: a matrix for each sensor");
  require(std::ssize(t) == sensors, "t: one for each sensor");
  std::vector<SensorPose> out(sensors);
  for (Index s = 0; s < sensors; ++s) {
    for (Index k = 0; k < 3; ++k) {
      out[s].R[k] = {R(s, k, 0), R(s, k, 1), R(s, k, 2)};
      out[s].t[k] = t[s][k];
    }
  }
  return out;
}

/// The rig of a call, whose arguments are checked.
class CheckedRig {
 public:
  CheckedRig(const KnownReturns& known, View<const std::int64_t> scanners, Rotations R, Positions t)
      : scanners_(scanners), poses_(poses_of(std::ssize(scanners), R, t)) {
    for (const std::int64_t one : scanners) {
      require(0 <= one && one < known.scanners(), "scanners: no number of a scanner");
    }
  }

  RigAt at() const { return {scanners_, poses_}; }

 private:
  View<const std::int64_t> scanners_;
  std::vector<SensorPose> poses_;
};

void check_object(const KnownReturns& known, Index object) {
  require(0 <= object && object < known.objects(), "object: no number of an object");
}

void check_enough(std::int32_t enough) { require(enough >= 0 && enough < 1 << 24, "enough: not from 0 to 2^24"); }

void check_places(View<const std::int64_t> which, Index places) {
  for (const std::int64_t place : which) {
    require(0 <= place && place < places, "which: no number of a place");
  }
}

void check_phases(const Scanners& scanners) {
  for (const Scanner* one : scanners) {
    require(one->phases() < 128, "scanners: too many phases");
  }
}

void bind_shapes(nb::module_& module) {
  nb::class_<Scanner> scanner(
      module, "Scanner",
      "A sensor's firing pattern, whatever its pose: H heads of all phases, F firings a cycle; it does not change.");
  init(scanner, make_scanner,
       R"(Heads (H,) when cycles start; angles and start_m (F, 3) of firings; ranges; field of view.

With a step of 0 heads stand still: there is one a phase, and `phase` (F,) says which each firing is of.)",
       "cos_head", "sin_head", "start_rad", "step_rad", "phases", "lag_rad", "gating_rad", "offset_rad",
       "elevation_rad", "start_m", "phase", "range_m", "fov_rad");
  scanner.def_prop_ro("phases", [](const Scanner& self) { return self.phases(); }, "Head n is of phase n % phases.");
  nb::class_<TargetShape> target(module, "TargetShape", "An object in its own frame; it does not change.");
  init(
      target, [](const world::Bvh& bvh, Vec3 low_m, Vec3 high_m) { return TargetShape{bvh, low_m, high_m}; },
      "Its hierarchy and the corners (3,) of its bounding box.", "bvh", "low_m", "high_m");
}

KnownReturns make_known(Scanners scanners, std::vector<const TargetShape*> objects, Places places,
                        View<const std::int64_t> ends, const Obstacles& obstacles) {
  require(ends.size() == objects.size() && !ends.empty(), "ends: one for each object");
  require(ends.front() >= 0 && std::ranges::is_sorted(ends), "ends: not ascending");
  require(ends.back() == std::ssize(places), "ends: not up to the last place");
  const std::vector<Place> all = places_of(places);
  std::vector<Standing> standing;
  std::int64_t first = 0;
  for (std::size_t n = 0; n < objects.size(); ++n) {
    standing.push_back({*objects[n], {all.begin() + first, all.begin() + ends[n]}});
    first = ends[n];
  }
  std::vector<Scanner> copies;
  for (const Scanner* one : scanners) {
    require(one->phases() < 128, "scanners: too many phases");
    copies.push_back(*one);
  }
  return KnownReturns(std::move(copies), std::move(standing), obstacles);
}

void bind_known(nb::module_& module) {
  nb::class_<KnownReturns> known(
      module, "KnownReturns",
      R"(The returns from objects at their places, of sensors at poses, rig after rig; threads share what each has found.

A rig is S sensors, each of a scanner by number, at R (S, 3, 3), t (S, 3).)");
  init(known, make_known,
       "Objects at places (P, 4), those of one after those of the other, which end at ends (objects,).", "scanners",
       "objects", "places", "ends", "obstacles");
  def(
      known, "misses",
      [](KnownReturns& self, View<const std::int64_t> scanners, Rotations R, Positions t, View<const double> weights,
         std::int32_t enough, double most) {
        const CheckedRig rig(self, scanners, R, t);
        require(std::ssize(weights) == self.objects(), "weights: one for each object");
        check_enough(enough);
        return self.misses(rig.at(), weights, enough, most);
      },
      R"(The weighted mean over objects of the share of places with fewer than `enough` returns.

By the mean over phases; or, as soon as it is known to be at least `most`, any number that is.)",
      "scanners", "R", "t", "weights", "enough", "most");
  def(
      known, "missed",
      [](KnownReturns& self, View<const std::int64_t> scanners, Rotations R, Positions t, Index object,
         std::int32_t enough, double most) {
        const CheckedRig rig(self, scanners, R, t);
        check_object(self, object);
        check_enough(enough);
        return self.missed(rig.at(), object, enough, most);
      },
      "In how many of its places an object is missed, by the mean over phases; or any number from `most` on.",
      "scanners", "R", "t", "object", "enough", "most");
  def(
      known, "missed_among",
      [](KnownReturns& self, View<const std::int64_t> scanners, Rotations R, Positions t, Index object,
         std::int32_t enough, Index count) {
        const CheckedRig rig(self, scanners, R, t);
        check_object(self, object);
        check_enough(enough);
        require(0 <= count, "count: below 0");
        return self.missed_among(rig.at(), object, enough, count);
      },
      "The same among so many of these places, the likeliest to be missed: no more than `missed`.", "scanners", "R",
      "t", "object", "enough", "count");
  def(
      known, "probabilities",
      [](KnownReturns& self, View<const std::int64_t> scanners, Rotations R, Positions t, Index object,
         View<const std::int64_t> which, std::int32_t enough, View<double> missed) {
        const CheckedRig rig(self, scanners, R, t);
        check_object(self, object);
        check_places(which, self.places(object));
        check_enough(enough);
        require(missed.size() == which.size(), "missed: one for each place");
        self.probabilities(rig.at(), object, which, enough, missed);
      },
      "Write to missed (N,) how likely an object is missed at some, which (N,), of its places.", "scanners", "R", "t",
      "object", "which", "enough", "missed");
  def(
      known, "lowest",
      [](KnownReturns& self, View<const std::int64_t> scanners, Rotations R, Positions t, Index object,
         View<const std::int64_t> which, std::int32_t cap, std::int64_t wanted, Rows<std::int32_t> counts,
         Rows<std::int8_t> phases) {
        const CheckedRig rig(self, scanners, R, t);
        check_object(self, object);
        check_places(which, self.places(object));
        const auto places = static_cast<Index>(which.size());
        const auto sensors = static_cast<Index>(scanners.size());
        require(has_shape(counts, places, sensors), "counts: a row for each place, a column for each sensor");
        require(has_shape(phases, places, sensors), "phases: a row for each place, a column for each sensor");
        require(cap >= 1 && cap < 1 << 24, "cap: not from 1 to 2^24");
        self.lowest(rig.at(), object, which, cap, wanted, {counts, phases});
      },
      R"(Write the returns (N, S) in each sensor's worst phase at some places, at most `cap`, and that phase.

At each place the nearest sensors come first; once `wanted` of them have `cap` the others are unknown: -1.)",
      "scanners", "R", "t", "object", "which", "cap", "wanted", "counts", "phases");
  known.def_prop_ro("memory_bytes", &KnownReturns::memory_bytes,
                    "What is known of sensors at poses takes no more memory.");
  known.def_prop_ro("traced", &KnownReturns::traced, "How many pairs of sensor and place were traced so far.");
}

}  // namespace

void bind_returns(nb::module_& module) {
  bind_shapes(module);
  bind_known(module);
  def(
      module, "count_returns",
      [](Places places, View<const std::int64_t> which, Scanners scanners, Rotations R, Positions t,
         const TargetShape& target, const Obstacles& obstacles, Tables<std::int32_t> counts) {
        const std::vector<SensorPose> poses = poses_of(std::ssize(scanners), R, t);
        require(counts.tables() == std::ssize(places), "counts: a table for each place");
        require(counts.rows() == std::ssize(scanners), "counts: a row for each scanner");
        for (const Scanner* one : scanners) {
          require(one->phases() <= counts.columns(), "counts: a column for each phase");
        }
        check_places(which, std::ssize(places));
        returns::count_returns(places_of(places), which, scanners, poses, target, obstacles, counts);
      },
      "Write to counts (P, S, phases) the returns from an object at some, which (N,), of places (P, 4).", "places",
      "which", "scanners", "R", "t", "target", "obstacles", "counts");
  def(
      module, "count_clusters",
      [](Places places, View<const std::int64_t> which, Scanners scanners, Rotations R, Positions t,
         const TargetShape& target, const Obstacles& obstacles, double tolerance_m, double above_m, std::int64_t lost,
         std::int64_t sensors, bool joint, std::int32_t cap, View<std::int32_t> counts, Rows<std::int8_t> phases) {
        const std::vector<SensorPose> poses = poses_of(std::ssize(scanners), R, t);
        check_places(which, std::ssize(places));
        require(std::ssize(counts) == std::ssize(places), "counts: one for each place");
        require(has_shape(phases, std::ssize(places), std::ssize(scanners)),
                "phases: a row for each place, a column for each scanner");
        check_phases(scanners);
        require(tolerance_m > 0, "tolerance_m: not above 0");
        require(0 <= lost && lost < std::ssize(scanners), "lost: not below the number of scanners");
        require(0 <= sensors, "sensors: below 0");
        returns::count_clusters(places_of(places), which, scanners, poses, target, obstacles, {tolerance_m, above_m},
                                {lost, sensors, joint, cap}, counts, phases);
      },
      R"(Write the points (P,) of the largest cluster in the worst case, and the phases (P, S) there; -1: lost.

Neighbours in a cluster are within a tolerance, and one of its points is at least at the height `above_m`.
With `lost` sensors gone; of all others together, or if `sensors` is not 0 of each of so many alone. Of all
combinations of phases where `joint`, else with each sensor in that of its fewest returns. Values of `cap` or
more are bounds.)",
      "places", "which", "scanners", "R", "t", "target", "obstacles", "tolerance_m", "above_m", "lost", "sensors",
      "joint", "cap", "counts", "phases");
  def(
      module, "largest_cluster",
      [](View<const Vec3> points, double tolerance_m, double above_m) {
        require(tolerance_m > 0, "tolerance_m: not above 0");
        returns::Clusters clusters({tolerance_m, above_m});
        clusters.add(points);
        return clusters.largest();
      },
      R"(The number of points of the largest cluster of points (N, 3) that has one at least at a height.

Neighbours are within a tolerance: single linkage.)",
      "points", "tolerance_m", "above_m");
  def(
      module, "detection_probabilities",
      [](Tables<const std::int32_t> counts, View<const std::int64_t> phases, Index enough) {
        require(std::ssize(phases) == counts.rows(), "phases: one for each row of counts");
        require(enough >= 0 && enough < 1 << 24, "enough: not from 0 to 2^24");
        for (const std::int64_t one : phases) {
          require(1 <= one && one <= counts.columns(), "phases: not the columns of counts");
        }
        for (Index n = 0; n < counts.size(); ++n) {
          require(counts.data()[n] >= 0, "counts: below 0");
        }
        return returns::detection_probabilities(counts, phases, enough);
      },
      "(P,) the probability of at least so many returns of counts (P, S, phases), each sensor in any of its phases.",
      "counts", "phases", "enough");
}

}  // namespace lidarcfg::bind
