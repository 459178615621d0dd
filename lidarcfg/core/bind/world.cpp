#include "bind/arguments.h"
#include "bind/modules.h"
#include "world/bvh.h"
#include "world/tracer.h"

namespace lidarcfg::bind {
namespace {

using world::Bvh;
using world::Kind;

/// A read-only array that looks at what an object of a class holds.
template <class T>
nb::object column(View<const T> values, nb::handle owner) {
  return nb::cast(nb::ndarray<nb::numpy, const T>(values.data(), {values.size()}, owner));
}

void bind_bvh(nb::module_& module) {
  nb::class_<Bvh> bvh(module, "Bvh", "An immutable bounding volume hierarchy over shapes, in the order of its leaves.");
  init(
      bvh,
      [](Rows<const double> shapes, View<const std::uint8_t> kind, View<const std::int32_t> number,
         View<const std::int32_t> object) {
        require(shapes.columns() == 9, "shapes: nine numbers each");
        require(std::ssize(kind) == shapes.rows(), "kind: one for each shape");
        require(std::ssize(number) == shapes.rows(), "number: one for each shape");
        require(std::ssize(object) == shapes.rows(), "object: one for each shape");
        for (const std::uint8_t one : kind) {
          require(one <= static_cast<std::uint8_t>(Kind::instance),
                  "kind: triangle, sphere, cylinder and instance only");
        }
        return world::build(
            {reinterpret_cast<const world::Shape*>(shapes.data()), static_cast<std::size_t>(shapes.rows())},
            {reinterpret_cast<const Kind*>(kind.data()), kind.size()}, number, object);
      },
      "Build it over shapes.", "shapes", "kind", "number", "object");
  bvh.def_prop_ro("number", [](nb::handle self) { return column(nb::cast<const Bvh&>(self).number, self); });
  bvh.def_prop_ro("object", [](nb::handle self) { return column(nb::cast<const Bvh&>(self).object, self); });
  bvh.def_prop_ro("kind", [](nb::handle self) {
    const Bvh& one = nb::cast<const Bvh&>(self);
    return column(View<const std::uint8_t>(reinterpret_cast<const std::uint8_t*>(one.kind.data()), one.kind.size()),
                  self);
  });
  bvh.def_prop_ro("shapes", [](nb::handle self) {
    const Bvh& one = nb::cast<const Bvh&>(self);
    const double* const first = one.leaves.empty() ? nullptr : one.leaves[0].shape.data();
    return nb::cast(nb::ndarray<nb::numpy, const double>(first, {one.leaves.size(), 9}, self,
                                                         {sizeof(world::Leaf) / sizeof(double), 1}));
  });
  bvh.def("__len__", [](const Bvh& self) { return self.leaves.size(); });
}

}  // namespace

void bind_world(nb::module_& module) {
  bind_bvh(module);
  def(
      module, "first_hits",
      [](const Bvh& bvh, Rows<const double> origins, Rows<const double> directions, double limit_m,
         View<double> range_m, View<std::int32_t> slot) {
        require(origins.rows() == 3, "origins: three rows");
        require(directions.rows() == 3 && directions.columns() == origins.columns(), "directions: one for each origin");
        require(std::ssize(range_m) == origins.columns(), "range_m: one for each origin");
        require(std::ssize(slot) == origins.columns(), "slot: one for each origin");
        world::first_hits(bvh, origins, directions, limit_m, range_m, slot);
      },
      "What rays hit first.", "bvh", "origins", "directions", "limit_m", "range_m", "slot");
  def(
      module, "any_hits",
      [](const Bvh& bvh, Rows<const double> origins, Rows<const double> directions, View<bool> hit) {
        require(origins.rows() == 3, "origins: three rows");
        require(directions.rows() == 3 && directions.columns() == origins.columns(), "directions: one for each origin");
        require(std::ssize(hit) == origins.columns(), "hit: one for each origin");
        world::any_hits(bvh, origins, directions, hit);
      },
      "Which of the open segments from origins along directions a hierarchy blocks.", "bvh", "origins", "directions",
      "hit");
}

}  // namespace lidarcfg::bind
