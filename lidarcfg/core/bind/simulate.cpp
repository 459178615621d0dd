#include <algorithm>
#include <limits>

#include "bind/arguments.h"
#include "bind/modules.h"
#include "simulate/echoes.h"
#include "simulate/trace.h"

namespace lidarcfg::bind {

using namespace simulate;

template <>
struct Fields<SubRays> {
  static constexpr auto members =
      fields(field("range_m", &SubRays::range_m), field("reflectivity", &SubRays::reflectivity),
             field("object", &SubRays::object), field("cosine", &SubRays::cosine), field("laser", &SubRays::laser));
};

template <>
struct Fields<Candidates> {
  static constexpr auto members =
      fields(field("range_m", &Candidates::range_m), field("reflectivity", &Candidates::reflectivity),
             field("object", &Candidates::object));
};

template <>
struct Fields<Lasers> {
  static constexpr auto members =
      fields(field("cos_elevation", &Lasers::cos_elevation), field("sin_elevation", &Lasers::sin_elevation),
             field("cos_offset", &Lasers::cos_offset), field("sin_offset", &Lasers::sin_offset),
             field("forward_m", &Lasers::forward_m), field("left_m", &Lasers::left_m), field("up_m", &Lasers::up_m),
             field("across", &Lasers::across), field("above", &Lasers::above));
};

template <>
struct Fields<Mounting> {
  static constexpr auto members =
      fields(field("T_world_start", &Mounting::T_world_start), field("path", &Mounting::path),
             field("zero_ns", &Mounting::zero_ns), field("T_vehicle_sensor", &Mounting::T_vehicle_sensor));
};

template <>
struct Fields<Surfaces> {
  static constexpr auto members =
      fields(field("object", &Surfaces::object), field("reflectivity", &Surfaces::reflectivity));
};

template <>
struct Fields<Firings> {
  static constexpr auto members = fields(
      field("time_ns", &Firings::time_ns), field("laser", &Firings::laser), field("encoder_rad", &Firings::encoder_rad),
      field("elevation_rad", &Firings::elevation_rad), field("start_m", &Firings::start_m));
};

template <>
struct Fields<Hits> {
  static constexpr auto members = fields(field("range_m", &Hits::range_m), field("reflectivity", &Hits::reflectivity),
                                         field("object", &Hits::object), field("cosine", &Hits::cosine));
};

template <>
struct From<world::Pose> {  // from a homogeneous matrix (4, 4)
  using Matrix = From<Shaped<Rows<const double>, 4, 4>>;
  static constexpr auto type = Matrix::type;

  static world::Pose python(nb::handle object, Held& held, const Name& name) {
    const auto T = Matrix::python(object, held, name);
    return {{T(0, 0), T(0, 1), T(0, 2), T(1, 0), T(1, 1), T(1, 2), T(2, 0), T(2, 1), T(2, 2)},
            {T(0, 3), T(1, 3), T(2, 3)}};
  }
};

namespace {

void bind_echoes(nb::module_& module) {
  def(
      module, "merge_echoes",
      [](const SubRays& rays, View<const double> weights, double range_max_m, double step_rad, double least,
         Shaped<Rows<const double>, -1, 2> droplets, Rows<const double> fade, View<const std::uint8_t> which,
         const Candidates& out) {
        const Index count = rays.range_m.rows();
        const Index width = std::ssize(weights);
        require(width > 0, "weights: at least one");
        require(rays.range_m.columns() == width, "rays.range_m: a column for each weight");
        require_columns(rays, "rays", "one for each range",
                        std::tuple(&SubRays::reflectivity, &SubRays::object, &SubRays::cosine), count, width);
        require(std::ssize(rays.laser) == count, "rays.laser: one for each row of ranges");
        require(droplets.rows() == (fade.rows() ? count : 0), "droplets: one for each firing, or none without fade");
        require(!fade.rows() || has_shape(fade, count, width + 1), "fade: one for each ray and one more, or none");
        const Index columns = std::ssize(which);
        require(std::all_of(which.begin(), which.end(), [](std::uint8_t one) { return one < candidates; }),
                "which: below six");
        require_columns(out, "out", "one for each firing and of which",
                        std::tuple(&Candidates::range_m, &Candidates::reflectivity, &Candidates::object), count,
                        columns);
        merge_echoes(rays, weights, {range_max_m, step_rad, least}, {droplets, fade},
                     {reinterpret_cast<const Candidate*>(which.data()), which.size()}, out);
      },
      R"(Write candidates `which` (C,) of beams of K rays (N, K) with weights: ranges, reflectivities, objects (N, C).

Echoes beyond a range, or with less than the least power, do not count; `step_rad` is the angle between
neighbouring rays. In bad weather droplets (N, 2) are range and albedo of what the weather echoes, and fade
(N, K + 1) is what is left of the light; else both are empty.)",
      "rays", "weights", "range_max_m", "step_rad", "least", "droplets", "fade", "which", "out");
}

void require_surfaces(const Surfaces& surfaces, Index slots) {
  require(slots <= std::numeric_limits<std::int32_t>::max(), "bodies: too many shapes");
  require(std::ssize(surfaces.object) == slots, "surfaces.object: of nothing, the ground, and each shape");
  const auto [least, most] = std::minmax_element(surfaces.object.begin(), surfaces.object.end());
  require(*least >= world::no_object && *most < std::ssize(surfaces.reflectivity) + world::no_object,
          "surfaces.object: those of surfaces.reflectivity only");
}

void require_lasers(const Lasers& lasers) {
  const std::size_t count = lasers.cos_elevation.size();
  require_columns(lasers, "lasers", "one for each laser",
                  std::tuple(&Lasers::sin_elevation, &Lasers::cos_offset, &Lasers::sin_offset, &Lasers::forward_m,
                             &Lasers::left_m, &Lasers::up_m),
                  count);
  require(lasers.across.size() == thin || lasers.across.size() == wide, "lasers.across: one or nine");
  require(lasers.above.size() == lasers.across.size(), "lasers.above: one for each of lasers.across");
}

void require_firings(const Firings& firings, const Lasers& lasers) {
  require_columns(firings, "firings", "one for each time", std::tuple(&Firings::laser, &Firings::encoder_rad),
                  firings.time_ns.size());
  require(firings.elevation_rad.empty() || firings.elevation_rad.size() == firings.time_ns.size(),
          "firings.elevation_rad: one for each time, or none");
  require(!firings.start_m.rows() || has_shape(firings.start_m, std::ssize(firings.time_ns), 3),
          "firings.start_m: three for each time, or none");
  require(std::all_of(firings.laser.begin(), firings.laser.end(),
                      [&](std::uint8_t one) { return one < lasers.cos_elevation.size(); }),
          "firings.laser: one of the lasers");
}

void bind_trace(nb::module_& module) {
  def(
      module, "aim_firings",
      [](const Lasers& lasers, const Mounting& mounting, const Firings& firings, Shaped<Rows<double>, -1, 3> origins_m,
         Shaped<Rows<double>, -1, 3> directions) {
        require_lasers(lasers);
        require(lasers.across.size() == thin, "lasers.across: one");
        require_firings(firings, lasers);
        require(origins_m.rows() == std::ssize(firings.time_ns), "origins_m: one for each firing");
        require(directions.rows() == std::ssize(firings.time_ns), "directions: one for each firing");
        aim_firings(lasers, mounting, firings, origins_m, directions);
      },
      "Write where the beams of firings start in the world, and their unit vectors; a beam has one ray.", "lasers",
      "mounting", "firings", "origins_m", "directions");
  def(
      module, "trace_firings",
      [](const world::World& world, const world::Bvh& bodies, const Surfaces& surfaces, const Lasers& lasers,
         const Mounting& mounting, const Firings& firings, std::int64_t zero_ns, double limit_m, const Hits& hits) {
        require_surfaces(surfaces, 2 + world.slots() + bodies.size());
        require_lasers(lasers);
        require_firings(firings, lasers);
        const Index count = std::ssize(firings.time_ns);
        const Index width = std::ssize(lasers.across);
        require_columns(hits, "hits", "one for each ray",
                        std::tuple(&Hits::range_m, &Hits::reflectivity, &Hits::object), count, width);
        require(!hits.cosine.rows() || has_shape(hits.cosine, count, width), "hits.cosine: one for each ray, or none");
        trace_firings({world, bodies, surfaces, lasers, mounting, zero_ns, limit_m}, firings, hits);
      },
      R"(Write what the K rays (N, K) of N firings hit within a limit, K being 1 or 9; `cosine` may be without rows.

The bodies are in the vehicle's frame. Moving objects have their time 0 at `zero_ns`.)",
      "world", "bodies", "surfaces", "lasers", "mounting", "firings", "zero_ns", "limit_m", "hits");
}

}  // namespace

void bind_simulate(nb::module_& module) {
  record<Firings>(module, "Firings", "Firings of one sensor.");
  record<Surfaces>(module, "Surfaces", "Which objects are hit, and how they reflect.");
  record<Lasers>(module, "Lasers", "The lasers of a sensor, and the rays of a beam of each.");
  record<Mounting>(module, "Mounting", "Where a sensor is.");
  record<Hits>(module, "Hits", "What the K rays of N firings hit, to be written; `cosine` may be without rows.");
  record<SubRays>(module, "SubRays", "What the rays of beams hit, and which lasers fired.");
  record<Candidates>(module, "Candidates", "Candidates of N firings, to be written.");
  bind_echoes(module);
  bind_trace(module);
}

}  // namespace lidarcfg::bind
