#include <algorithm>
#include <limits>

#include "angles.h"
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
  static constexpr auto members = fields(field("time_ns", &Firings::time_ns), field("laser", &Firings::laser),
                                         field("encoder_rad", &Firings::encoder_rad),
                                         field("elevation_rad", &Firings::elevation_rad));
};

template <>
struct Fields<Hits> {
  static constexpr auto members = fields(field("range_m", &Hits::range_m), field("reflectivity", &Hits::reflectivity),
                                         field("object", &Hits::object), field("cosine", &Hits::cosine));
};

template <>
struct Fields<Axes> {
  static constexpr auto members = fields(field("origins_m", &Axes::origins_m), field("directions", &Axes::directions));
};

template <>
struct From<world::Pose> {  // from a homogeneous matrix (4, 4)
  static world::Pose python(nb::handle object, Held& held, const Name& name) {
    const auto T = From<Rows<const double>>::python(object, held, name);
    if (T.rows() != 4 || T.columns() != 4) {
      name.refuse("not of shape (4, 4)");
    }
    return {{T(0, 0), T(0, 1), T(0, 2), T(1, 0), T(1, 1), T(1, 2), T(2, 0), T(2, 1), T(2, 2)},
            {T(0, 3), T(1, 3), T(2, 3)}};
  }
};

namespace {

template <class T>
bool is_shape(const Rows<T>& table, Index rows, Index columns) {
  return table.rows() == rows && table.columns() == columns;
}

void bind_echoes(nb::module_& module) {
  def(
      module, "merge_echoes",
      [](const SubRays& rays, View<const double> weights, double range_max_m, double step_rad, double least,
         Rows<const double> droplets, Rows<const double> fade, View<const std::uint8_t> which, const Candidates& out) {
        const Index count = rays.range_m.rows();
        const Index width = std::ssize(weights);
        require(width > 0, "weights: at least one");
        require(rays.range_m.columns() == width, "rays.range_m: a column for each weight");
        require(is_shape(rays.reflectivity, count, width), "rays.reflectivity: one for each range");
        require(is_shape(rays.object, count, width), "rays.object: one for each range");
        require(is_shape(rays.cosine, count, width), "rays.cosine: one for each range");
        require(std::ssize(rays.laser) == count, "rays.laser: one for each row of ranges");
        require(is_shape(droplets, fade.rows() ? count : 0, 2), "droplets: two for each firing, or none without fade");
        require(!fade.rows() || is_shape(fade, count, width + 1), "fade: one for each ray and one more, or none");
        const Index columns = std::ssize(which);
        require(std::all_of(which.begin(), which.end(), [](std::uint8_t one) { return one < candidates; }),
                "which: below six");
        require(is_shape(out.range_m, count, columns), "out.range_m: one for each firing and of which");
        require(is_shape(out.reflectivity, count, columns), "out.reflectivity: one for each firing and of which");
        require(is_shape(out.object, count, columns), "out.object: one for each firing and of which");
        merge_echoes(rays, weights, {range_max_m, step_rad, least}, {droplets, fade},
                     {reinterpret_cast<const Candidate*>(which.data()), which.size()}, out);
      },
      "Write candidates of beams.", "rays", "weights", "range_max_m", "step_rad", "least", "droplets", "fade", "which",
      "out");
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
  require(lasers.sin_elevation.size() == count, "lasers.sin_elevation: one for each laser");
  require(lasers.cos_offset.size() == count, "lasers.cos_offset: one for each laser");
  require(lasers.sin_offset.size() == count, "lasers.sin_offset: one for each laser");
  require(lasers.forward_m.size() == count, "lasers.forward_m: one for each laser");
  require(lasers.left_m.size() == count, "lasers.left_m: one for each laser");
  require(lasers.up_m.size() == count, "lasers.up_m: one for each laser");
  require(lasers.across.size() == thin || lasers.across.size() == wide, "lasers.across: one or nine");
  require(lasers.above.size() == lasers.across.size(), "lasers.above: one for each of lasers.across");
}

void require_firings(const Firings& firings, const Lasers& lasers) {
  require(firings.laser.size() == firings.time_ns.size(), "firings.laser: one for each time");
  require(firings.encoder_rad.size() == firings.time_ns.size(), "firings.encoder_rad: one for each time");
  require(firings.elevation_rad.empty() || firings.elevation_rad.size() == firings.time_ns.size(),
          "firings.elevation_rad: one for each time, or none");
  require(std::all_of(firings.laser.begin(), firings.laser.end(),
                      [&](std::uint8_t one) { return one < lasers.cos_elevation.size(); }),
          "firings.laser: one of the lasers");
}

void bind_trace(nb::module_& module) {
  def(
      module, "aim_firings",
      [](const Lasers& lasers, const Mounting& mounting, const Firings& firings, const Axes& axes) {
        require_lasers(lasers);
        require(lasers.across.size() == thin, "lasers.across: one");
        require_firings(firings, lasers);
        const Index count = std::ssize(firings.time_ns);
        require(is_shape(axes.origins_m, count, 3), "axes.origins_m: three for each firing");
        require(is_shape(axes.directions, count, 3), "axes.directions: three for each firing");
        aim_firings(lasers, mounting, firings, axes);
      },
      "Write where the beams of firings start and point.", "lasers", "mounting", "firings", "axes");
  def(
      module, "trace_firings",
      [](const world::World& world, const world::Bvh& bodies, const Surfaces& surfaces, const Lasers& lasers,
         const Mounting& mounting, const Firings& firings, std::int64_t zero_ns, double limit_m, const Hits& hits) {
        require_surfaces(surfaces, 2 + world.slots() + bodies.size());
        require_lasers(lasers);
        require_firings(firings, lasers);
        const Index count = std::ssize(firings.time_ns);
        const Index width = std::ssize(lasers.across);
        require(is_shape(hits.range_m, count, width), "hits.range_m: one for each ray");
        require(is_shape(hits.reflectivity, count, width), "hits.reflectivity: one for each ray");
        require(is_shape(hits.object, count, width), "hits.object: one for each ray");
        require(!hits.cosine.rows() || is_shape(hits.cosine, count, width), "hits.cosine: one for each ray, or none");
        trace_firings({world, bodies, surfaces, lasers, mounting, zero_ns, limit_m}, firings, hits);
      },
      "Write what the rays of firings hit.", "world", "bodies", "surfaces", "lasers", "mounting", "firings", "zero_ns",
      "limit_m", "hits");
}

}  // namespace

void bind_simulate(nb::module_& module) {
  bind_echoes(module);
  bind_trace(module);
  def(
      module, "cos_sin",
      [](double angle_rad) {
        const auto [cos, sin] = cos_sin(angle_rad);
        return std::tuple(cos, sin);
      },
      "The core's own cosine and sine.", "angle_rad");
}

}  // namespace lidarcfg::bind
