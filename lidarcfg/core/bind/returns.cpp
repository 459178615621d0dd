#include <algorithm>
#include <cmath>

#include "bind/arguments.h"
#include "bind/modules.h"
#include "bind/sight.h"
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

void require_finite(View<const double> values, const char* message) {
  require(std::all_of(values.begin(), values.end(), [](double one) { return std::isfinite(one); }), message);
}

Scanner make_scanner(View<const double> cos_head, View<const double> sin_head, double start_rad, double step_rad,
                     std::int64_t phases, View<const double> lag_rad, View<const double> gating_rad,
                     View<const double> offset_rad, View<const double> elevation_rad, Rows<const double> start_m,
                     View<const std::int32_t> phase, std::array<double, 2> range_m, std::array<double, 2> fov_rad) {
  const auto firings = lag_rad.size();
  require(cos_head.size() == sin_head.size(), "sin_head: one for each cos_head");
  require(step_rad == 0 || (step_rad >= 1e-8 && step_rad <= 10), "step_rad: not 0, nor from 1e-8 to 10");
  require(cos_head.size() < (std::size_t{1} << 31), "cos_head: too many heads");
  require(firings < (std::size_t{1} << 31), "lag_rad: too many firings");
  require(1 <= phases && phases <= 1 << 20, "phases: not from 1 to 2^20");
  require(gating_rad.size() == firings, "gating_rad: one for each firing");
  require(offset_rad.size() == firings, "offset_rad: one for each firing");
  require(elevation_rad.size() == firings, "elevation_rad: one for each firing");
  require(start_m.rows() == std::ssize(lag_rad) && start_m.columns() == 3, "start_m: three numbers for each firing");
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

std::vector<Place> places_of(Rows<const double> places) {
  require(places.columns() == 4, "places: four columns");
  std::vector<Place> out;
  for (Index p = 0; p < places.rows(); ++p) {
    const View<const double> one = places[p];
    out.push_back({{one[0], one[1], one[2]}, lidarcfg::cos(one[3]), lidarcfg::sin(one[3])});
  }
  return out;
}

std::vector<SensorPose> poses_of(Index sensors, Tables<const double> R, Rows<const double> t) {
  require(R.tables() == sensors && R.rows() == 3 && R.columns() == 3, "R: a matrix for each sensor");
  require(t.rows() == sensors && t.columns() == 3, "t: three numbers for each sensor");
  std::vector<SensorPose> out(sensors);
  for (Index s = 0; s < sensors; ++s) {
    for (Index k = 0; k < 3; ++k) {
      out[s].R[k] = {R(s, k, 0), R(s, k, 1), R(s, k, 2)};
      out[s].t[k] = t(s, k);
    }
  }
  return out;
}

/// The rig of a call, whose arguments are checked.
class CheckedRig {
 public:
  CheckedRig(const KnownReturns& known, View<const std::int64_t> scanners, Tables<const double> R, Rows<const double> t)
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

template <class T>
void check_table(Rows<T> table, Index places, const Scanners& scanners, const char* message) {
  require(table.rows() == places && table.columns() == std::ssize(scanners), message);
}

void check_phases(const Scanners& scanners) {
  for (const Scanner* one : scanners) {
    require(one->phases() < 128, "scanners: too many phases");
  }
}

void bind_shapes(nb::module_& module) {
  nb::class_<Scanner> scanner(module, "Scanner", "A sensor's firing pattern, whatever its pose; it does not change.");
  init(scanner, make_scanner, "Heads at the start of cycles of all phases, and the firings of a cycle.", "cos_head",
       "sin_head", "start_rad", "step_rad", "phases", "lag_rad", "gating_rad", "offset_rad", "elevation_rad", "start_m",
       "phase", "range_m", "fov_rad");
  scanner.def_prop_ro("phases", [](const Scanner& self) { return self.phases(); });
  nb::class_<TargetShape> target(module, "TargetShape", "An object in its own frame; it does not change.");
  init(
      target, [](const world::Bvh& bvh, Vec3 low_m, Vec3 high_m) { return TargetShape{bvh, low_m, high_m}; },
      "Its hierarchy and the corners of its bounding box.", "bvh", "low_m", "high_m");
}

KnownReturns make_known(Scanners scanners, std::vector<const TargetShape*> objects, Rows<const double> places,
                        View<const std::int64_t> ends, const Obstacles& obstacles) {
  require(ends.size() == objects.size() && !ends.empty(), "ends: one for each object");
  require(ends.front() >= 0 && std::ranges::is_sorted(ends), "ends: not ascending");
  require(ends.back() == places.rows(), "ends: not up to the last place");
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
  nb::class_<KnownReturns> known(module, "KnownReturns",
                                 "The returns from objects at their places, of sensors at poses, rig after rig.");
  init(known, make_known, "For scanners, and objects whose places end one after the other.", "scanners", "objects",
       "places", "ends", "obstacles");
  def(
      known, "misses",
      [](KnownReturns& self, View<const std::int64_t> scanners, Tables<const double> R, Rows<const double> t,
         View<const double> weights, std::int32_t enough, double most) {
        const CheckedRig rig(self, scanners, R, t);
        require(std::ssize(weights) == self.objects(), "weights: one for each object");
        check_enough(enough);
        return self.misses(rig.at(), weights, enough, most);
      },
      "The weighted mean over objects of the share of places with too few returns.", "scanners", "R", "t", "weights",
      "enough", "most");
  def(
      known, "missed",
      [](KnownReturns& self, View<const std::int64_t> scanners, Tables<const double> R, Rows<const double> t,
         Index object, std::int32_t enough, double most) {
        const CheckedRig rig(self, scanners, R, t);
        check_object(self, object);
        check_enough(enough);
        return self.missed(rig.at(), object, enough, most);
      },
      "In how many places an object is missed.", "scanners", "R", "t", "object", "enough", "most");
  def(
      known, "missed_among",
      [](KnownReturns& self, View<const std::int64_t> scanners, Tables<const double> R, Rows<const double> t,
         Index object, std::int32_t enough, Index count) {
        const CheckedRig rig(self, scanners, R, t);
        check_object(self, object);
        check_enough(enough);
        require(0 <= count, "count: below 0");
        return self.missed_among(rig.at(), object, enough, count);
      },
      "In how many of those places that are the likeliest to be missed an object is.", "scanners", "R", "t", "object",
      "enough", "count");
  def(
      known, "probabilities",
      [](KnownReturns& self, View<const std::int64_t> scanners, Tables<const double> R, Rows<const double> t,
         Index object, View<const std::int64_t> which, std::int32_t enough, View<double> missed) {
        const CheckedRig rig(self, scanners, R, t);
        check_object(self, object);
        check_places(which, self.places(object));
        check_enough(enough);
        require(missed.size() == which.size(), "missed: one for each place");
        self.probabilities(rig.at(), object, which, enough, missed);
      },
      "How likely an object is missed at some of its places.", "scanners", "R", "t", "object", "which", "enough",
      "missed");
  def(
      known, "lowest",
      [](KnownReturns& self, View<const std::int64_t> scanners, Tables<const double> R, Rows<const double> t,
         Index object, View<const std::int64_t> which, std::int32_t cap, std::int64_t wanted, Rows<std::int32_t> counts,
         Rows<std::int8_t> phases) {
        const CheckedRig rig(self, scanners, R, t);
        check_object(self, object);
        check_places(which, self.places(object));
        const auto places = static_cast<Index>(which.size());
        const auto sensors = static_cast<Index>(scanners.size());
        require(counts.rows() == places && counts.columns() == sensors,
                "counts: a row for each place, a column for each sensor");
        require(phases.rows() == places && phases.columns() == sensors,
                "phases: a row for each place, a column for each sensor");
        require(cap >= 1 && cap < 1 << 24, "cap: not from 1 to 2^24");
        self.lowest(rig.at(), object, which, cap, wanted, {counts, phases});
      },
      "Count each sensor's returns in its worst phase, up to a cap.", "scanners", "R", "t", "object", "which", "cap",
      "wanted", "counts", "phases");
  known.def_prop_ro("memory_bytes", &KnownReturns::memory_bytes);
  known.def_prop_ro("traced", &KnownReturns::traced);
}

}  // namespace

void bind_returns(nb::module_& module) {
  bind_shapes(module);
  bind_known(module);
  def(
      module, "count_returns",
      [](Rows<const double> places, View<const std::int64_t> which, Scanners scanners, Tables<const double> R,
         Rows<const double> t, const TargetShape& target, const Obstacles& obstacles, Tables<std::int32_t> counts) {
        const std::vector<SensorPose> poses = poses_of(std::ssize(scanners), R, t);
        require(counts.tables() == places.rows(), "counts: a table for each place");
        require(counts.rows() == std::ssize(scanners), "counts: a row for each scanner");
        for (const Scanner* one : scanners) {
          require(one->phases() <= counts.columns(), "counts: a column for each phase");
        }
        check_places(which, places.rows());
        returns::count_returns(places_of(places), which, scanners, poses, target, obstacles, counts);
      },
      "Count the returns from an object at some of its places.", "places", "which", "scanners", "R", "t", "target",
      "obstacles", "counts");
  def(
      module, "count_clusters",
      [](Rows<const double> places, View<const std::int64_t> which, Scanners scanners, Tables<const double> R,
         Rows<const double> t, const TargetShape& target, const Obstacles& obstacles, double tolerance_m,
         double above_m, std::int64_t lost, std::int64_t sensors, bool joint, std::int32_t cap,
         View<std::int32_t> counts, Rows<std::int8_t> phases) {
        const std::vector<SensorPose> poses = poses_of(std::ssize(scanners), R, t);
        check_places(which, places.rows());
        require(std::ssize(counts) == places.rows(), "counts: one for each place");
        check_table(phases, places.rows(), scanners, "phases: a row for each place, a column for each scanner");
        check_phases(scanners);
        require(tolerance_m > 0, "tolerance_m: not above 0");
        require(0 <= lost && lost < std::ssize(scanners), "lost: not below the number of scanners");
        require(0 <= sensors, "sensors: below 0");
        returns::count_clusters(places_of(places), which, scanners, poses, target, obstacles, {tolerance_m, above_m},
                                {lost, sensors, joint, cap}, counts, phases);
      },
      "The points of the largest cluster of returns, in the worst case.", "places", "which", "scanners", "R", "t",
      "target", "obstacles", "tolerance_m", "above_m", "lost", "sensors", "joint", "cap", "counts", "phases");
  def(
      module, "largest_cluster",
      [](Rows<const double> points, double tolerance_m, double above_m) {
        require(points.columns() == 3, "points: three columns");
        require(tolerance_m > 0, "tolerance_m: not above 0");
        returns::Clusters clusters({tolerance_m, above_m});
        std::vector<Vec3> all;
        for (Index n = 0; n < points.rows(); ++n) {
          all.push_back({points(n, 0), points(n, 1), points(n, 2)});
        }
        clusters.add(all);
        return clusters.largest();
      },
      "The points of the largest cluster with one that is high enough.", "points", "tolerance_m", "above_m");
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
      "The probability of enough returns at each place.", "counts", "phases", "enough");
}

}  // namespace lidarcfg::bind
