#include "bind/arguments.h"
#include "bind/modules.h"
#include "simulate/echoes.h"

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

namespace {

template <class T>
bool is_shape(const Rows<T>& table, Index rows, Index columns) {
  return table.rows() == rows && table.columns() == columns;
}

void bind_echoes(nb::module_& module) {
  def(
      module, "merge_echoes",
      [](const SubRays& rays, View<const double> weights, double range_max_m, double step_rad, double least,
         Rows<const double> droplets, Rows<const double> fade, const Candidates& out) {
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
        require(is_shape(out.range_m, count, candidates), "out.range_m: six for each firing");
        require(is_shape(out.reflectivity, count, candidates), "out.reflectivity: six for each firing");
        require(is_shape(out.object, count, candidates), "out.object: six for each firing");
        merge_echoes(rays, weights, {range_max_m, step_rad, least}, {droplets, fade}, out);
      },
      "Write the six candidates of beams.", "rays", "weights", "range_max_m", "step_rad", "least", "droplets", "fade",
      "out");
}

}  // namespace

void bind_simulate(nb::module_& module) { bind_echoes(module); }

}  // namespace lidarcfg::bind
