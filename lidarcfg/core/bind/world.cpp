#include "bind/world.h"

#include <algorithm>
#include <cstring>
#include <tuple>

#include "bind/arguments.h"
#include "bind/modules.h"
#include "world/solids.h"
#include "world/tracer.h"

namespace lidarcfg::bind {
namespace {

using world::Bvh;
using world::Kind;
using world::Path;
using world::World;

using Points = Shaped<Rows<const double>, 3, -1>;  // of rays: x, y and z
using Triangles = Shaped<Rows<const std::int64_t>, -1, 3>;

/// A read-only array that looks at what an object of a class holds.
template <class T>
using Column = nb::ndarray<nb::numpy, const T, nb::ndim<1>>;

template <class T>
Column<T> column(View<const T> values, nb::handle owner) {
  return Column<T>(values.data(), {values.size()}, owner);
}

void require_rays(Points origins, Points directions) {
  require(directions.columns() == origins.columns(), "directions: one for each origin");
}

Bvh build(View<const world::Shape> shapes, View<const std::uint8_t> kind, View<const std::int32_t> number,
          View<const std::int32_t> object) {
  require(kind.size() == shapes.size(), "kind: one for each shape");
  require(number.size() == shapes.size(), "number: one for each shape");
  require(object.size() == shapes.size(), "object: one for each shape");
  for (const std::uint8_t one : kind) {
    require(one <= static_cast<std::uint8_t>(Kind::instance), "kind: unknown");
  }
  return world::build(shapes, {reinterpret_cast<const Kind*>(kind.data()), kind.size()}, number, object);
}

/// For pickles, which other processes of this machine read.
template <class T>
nb::bytes bytes_of(View<const T> values) {
  return nb::bytes(values.data(), values.size_bytes());
}

template <class T>
std::vector<T> values_of(nb::handle bytes) {
  require(nb::isinstance<nb::bytes>(bytes), "state: not bytes");
  const auto raw = nb::borrow<nb::bytes>(bytes);
  require(raw.size() % sizeof(T) == 0, "state: bytes of no column");
  std::vector<T> out(raw.size() / sizeof(T));
  if (!out.empty()) {
    std::memcpy(out.data(), raw.data(), out.size() * sizeof(T));
  }
  return out;
}

using State = nb::typed<nb::tuple, nb::bytes, nb::ellipsis>;

State state_of(const Bvh& self) {
  return State(nb::make_tuple(bytes_of(self.nodes), bytes_of(self.leaves), bytes_of(self.kind), bytes_of(self.number),
                              bytes_of(self.object)));
}

void restore(Bvh& self, const State& state) {
  require(state.size() == 5, "state: five columns");
  const auto nodes = values_of<world::Node>(state[0]);
  const auto leaves = values_of<world::Leaf>(state[1]);
  const auto kind = values_of<Kind>(state[2]);
  const auto number = values_of<std::int32_t>(state[3]);
  const auto object = values_of<std::int32_t>(state[4]);
  new (&self) Bvh(world::copy_of({nodes, leaves, kind, number, object, 0, nullptr}));
}

void bind_bvh(nb::module_& module) {
  nb::class_<Bvh> bvh(
      module, "Bvh",
      "An immutable bounding volume hierarchy over S shapes, in the order of its leaves: a slot is a place there.");
  init(bvh, &build, "Build it over shapes (S, 9) of kinds (S,) with numbers (S,), which belong to objects (S,).",
       "shapes", "kind", "number", "object");
  bvh.def("__len__", [](const Bvh& self) { return self.size(); });
  bvh.def("__getstate__", &state_of);
  bvh.def("__setstate__", &restore);
  bvh.def_prop_ro("number", [](nb::handle self) { return column(nb::cast<const Bvh&>(self).number, self); });
  bvh.def_prop_ro("object", [](nb::handle self) { return column(nb::cast<const Bvh&>(self).object, self); });
  bvh.def_prop_ro("kind", [](nb::handle self) {
    const View<const Kind> kind = nb::cast<const Bvh&>(self).kind;
    return column(View<const std::uint8_t>(reinterpret_cast<const std::uint8_t*>(kind.data()), kind.size()), self);
  });
  bvh.def_prop_ro("shapes", [](nb::handle self) {
    const View<const world::Leaf> leaves = nb::cast<const Bvh&>(self).leaves;
    const double* const first = leaves.empty() ? nullptr : leaves[0].shape.data();
    return nb::ndarray<nb::numpy, const double, nb::shape<-1, 9>>(first, {leaves.size(), 9}, self,
                                                                  {sizeof(world::Leaf) / sizeof(double), 1});
  });
  def(
      module, "first_hits",
      [](const Bvh& bvh, Points origins, Points directions, double limit_m, View<double> range_m,
         View<std::int32_t> slot) {
        require_rays(origins, directions);
        require(std::ssize(range_m) == origins.columns(), "range_m: one for each ray");
        require(std::ssize(slot) == origins.columns(), "slot: one for each ray");
        world::first_hits(bvh, origins, directions, limit_m, range_m, slot);
      },
      "Write ranges and slots (N,) of what rays (3, N) along unit vectors hit first: inf and -2 if nothing.", "bvh",
      "origins", "directions", "limit_m", "range_m", "slot");
  def(
      module, "any_hits",
      [](const Bvh& bvh, Points origins, Points directions, View<bool> hit) {
        require_rays(origins, directions);
        require(std::ssize(hit) == origins.columns(), "hit: one for each ray");
        world::any_hits(bvh, origins, directions, hit);
      },
      "Write which (N,) of the open segments (3, N) from origins along directions, to their ends, a hierarchy blocks.",
      "bvh", "origins", "directions", "hit");
}

Path timed_path(View<const double> times_s, View<const Vec3> positions_m,
                Shaped<Tables<const double>, -1, 3, 3> rotations, View<const Vec3> rotation_vectors_rad) {
  const Index count = std::ssize(times_s);
  require(count >= 2, "times_s: two or more");
  require(std::ssize(positions_m) == count, "positions_m: one for each of times_s");
  require(rotations.tables() == count, "rotations: one for each of times_s");
  require(std::ssize(rotation_vectors_rad) == count, "rotation_vectors_rad: one for each of times_s");
  std::vector<Path::Timed> poses(count);
  for (Index k = 0; k < count; ++k) {
    require(k == 0 || times_s[k] > times_s[k - 1], "times_s: ascending");
    poses[k].time_s = times_s[k];
    std::copy_n(rotations[k].data(), 9, poses[k].pose.R.begin());
    poses[k].pose.t = positions_m[k];
    poses[k].rotation_vector_rad = rotation_vectors_rad[k];
  }
  return Path::timed(std::move(poses));
}

void bind_path(nb::module_& module) {
  nb::class_<Path> path(module, "Path", "An immutable motion, in the frame at its time 0.");
  def(
      module, "path_of_velocity", [](Vec3 velocity_m_s) { return Path::velocity(velocity_m_s); },
      "Along a line, from the origin at time 0.", "velocity_m_s");
  def(module, "path_of_arc", &Path::arc, "Along a circle, from the origin at time 0, where it heads that far from x.",
      "speed_m_s", "yaw_rate_rad_s", "heading_rad");
  def(module, "path_of_poses", &timed_path,
      "Through poses (K, 3) and (K, 3, 3) at ascending times (K,); vectors (K, 3) turn each into the next.", "times_s",
      "positions_m", "rotations", "rotation_vectors_rad");
  def(
      path, "at",
      [](const Path& self, View<const double> seconds) {
        const std::size_t count = seconds.size();
        Array<double, 3> rotations{std::vector<double>(9 * count), {count, 3, 3}};
        Array<double, 2> positions_m{std::vector<double>(3 * count), {count, 3}};
        for (std::size_t n = 0; n < count; ++n) {
          const world::Pose pose = self.at(seconds[n]);
          std::copy(pose.R.begin(), pose.R.end(), rotations.values.begin() + 9 * n);
          std::copy(pose.t.begin(), pose.t.end(), positions_m.values.begin() + 3 * n);
        }
        return std::tuple(std::move(rotations), std::move(positions_m));
      },
      "Rotations (N, 3, 3) and positions (N, 3) at times (N,).", "seconds");
}

World make_world(double ground_m, const Bvh& fixed, std::vector<Bvh> moving, View<const Vec3> places_m,
                 View<const double> speeds_m_s, std::vector<Path> paths) {
  require(std::ssize(places_m) == std::ssize(moving), "places_m: one for each of moving");
  require(std::ssize(speeds_m_s) == std::ssize(moving), "speeds_m_s: one for each of moving");
  require(std::ssize(paths) == std::ssize(moving), "paths: one for each of moving");
  std::vector<world::Moving> objects(moving.size());
  for (std::size_t p = 0; p < moving.size(); ++p) {
    objects[p].bvh = moving[p];
    objects[p].place_m = places_m[p];
    objects[p].path = paths[p];
    objects[p].speed_m_s = speeds_m_s[p];
  }
  return World(ground_m, fixed, std::move(objects));
}

void bind_whole(nb::module_& module) {
  nb::class_<World> whole(
      module, "World",
      "All that rays may hit, immutable. Slots count through the static hierarchy, then through the moving ones.");
  init(whole, &make_world,
       "Of P moving objects: places (P, 3), greatest speeds (P,), paths. No ground: its height is inf.", "ground_m",
       "fixed", "moving", "places_m", "speeds_m_s", "paths");
  whole.def("__len__", [](const World& self) { return self.slots(); });
  whole.def_prop_ro("fixed", [](const World& self) { return self.fixed(); });
  def(
      whole, "along",
      [](const World& self, View<const double> speeds_m_s, std::vector<Path> paths) {
        require(speeds_m_s.size() == self.moving().size(), "speeds_m_s: one for each moving object");
        require(paths.size() == self.moving().size(), "paths: one for each moving object");
        return self.along(speeds_m_s, std::move(paths));
      },
      "This world where its P moving objects have other greatest speeds (P,) and paths; hierarchies are shared.",
      "speeds_m_s", "paths");
  def(
      whole, "cast",
      [](const World& self, Points origins, Points directions, View<const double> seconds, double limit_m,
         const world::Found& found) {
        require_rays(origins, directions);
        require(std::ssize(seconds) == origins.columns(), "seconds: one for each ray");
        require_rows(found, origins.columns());
        world::cast(self, origins, directions, seconds, limit_m, found);
      },
      "Write what rays (3, N) along unit vectors at times (N,) hit first within a limit.", "origins", "directions",
      "seconds", "limit_m", "found");
  def(
      whole, "resolve",
      [](const World& self, View<const std::int32_t> slot) {
        std::vector<std::int32_t> objects(slot.size());
        std::vector<std::int32_t> triangles(slot.size());
        for (std::size_t n = 0; n < slot.size(); ++n) {
          require(world::no_slot <= slot[n] && slot[n] < self.slots(), "slot: not of this world");
          objects[n] = self.object(slot[n]);
          triangles[n] = self.triangle(slot[n]);
        }
        return std::tuple(std::move(objects), std::move(triangles));
      },
      "The objects and the triangles (N,) of slots (N,); -1: none.", "slot");
}

/// Raises ValueError unless triangles are of vertices.
void require_mesh(View<const Vec3> vertices, Triangles triangles) {
  const std::span<const std::int64_t> corners(triangles.data(), triangles.size());
  require(std::all_of(corners.begin(), corners.end(),
                      [&](std::int64_t one) { return 0 <= one && one < std::ssize(vertices); }),
          "triangles: of vertices only");
}

void bind_solids(nb::module_& module) {
  def(
      module, "toggle_points",
      [](View<const Vec3> vertices, Triangles triangles, View<const Vec3> points, View<bool> odd) {
        require_mesh(vertices, triangles);
        require(std::ssize(odd) == std::ssize(points), "odd: one for each of points");
        world::toggle_points(vertices, triangles, points, odd);
      },
      "Toggle odd (N,) for each of the triangles (T, 3) of vertices (V, 3) that is before a point (N, 3), along x.",
      "vertices", "triangles", "points", "odd");
  def(
      module, "toggle_lines",
      [](View<const Vec3> vertices, Triangles triangles, Shaped<Rows<const std::int64_t>, -1, 4> lines,
         View<const double> x, View<const double> y, View<const double> z, Tables<bool> odd) {
        require_mesh(vertices, triangles);
        require(lines.rows() == triangles.rows(), "lines: one for each of triangles");
        for (Index t = 0; t < lines.rows(); ++t) {
          require(0 <= lines(t, 0) && lines(t, 1) <= std::ssize(y), "lines: indices of y first");
          require(0 <= lines(t, 2) && lines(t, 3) <= std::ssize(z), "lines: indices of z last");
        }
        require(has_shape(odd, std::ssize(y), std::ssize(z), std::ssize(x) + 1), "odd: of another size");
        world::toggle_lines(vertices, triangles, lines, x, y, z, odd);
      },
      "Toggle odd (ny, nz, nx + 1) at the first point beyond each triangle on lines (T, 4) along x that cross it.",
      "vertices", "triangles", "lines", "x", "y", "z", "odd");
}

}  // namespace

void bind_world(nb::module_& module) {
  bind_bvh(module);
  record<world::Obstacles>(module, "Obstacles", "What blocks beams, relative to a point.");
  record<world::Found>(module, "Found",
                       "What N rays hit first, to be written; columns that are not asked for have no rows.");
  def(
      module, "boxes_of",
      [](const Bvh& bvh) {
        std::vector<double> boxes = world::boxes_of(bvh);
        const std::size_t columns = boxes.size() / 6;
        return Array<double, 2>{std::move(boxes), {6, columns}};
      },
      "(6, 16) low and high corners of boxes that together hold a hierarchy's shapes; (6, 0) if there are none.",
      "bvh");
  bind_path(module);
  bind_whole(module);
  bind_solids(module);
}

}  // namespace lidarcfg::bind
