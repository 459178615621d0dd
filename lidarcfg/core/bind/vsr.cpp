#include "bind/arguments.h"
#include "bind/modules.h"
#include "bind/world.h"
#include "vsr/components.h"
#include "vsr/cones.h"
#include "vsr/evaluator.h"
#include "vsr/grid.h"
#include "vsr/linker.h"
#include "vsr/seen.h"

namespace lidarcfg::bind {

template <>
struct Columns<vsr::Links> {
  using Element = vsr::Word;
  static constexpr Index count = 3;
};
template <>
struct Columns<const vsr::Links> {
  using Element = const vsr::Word;
  static constexpr Index count = 3;
};

template <>
struct Fields<vsr::Sight> {
  using S = vsr::Sight;
  static constexpr auto members =
      fields(field<Shaped<Rows<const double>, -1, vsr::limit_columns>>("limits", &S::limits),
             field("obstacles", &S::obstacles));
};

template <>
struct Fields<vsr::Placed> {
  using P = vsr::Placed;
  static constexpr auto members = fields(
      field("cones", &P::cones), field<Shaped<Tables<const double>, -1, -1, vsr::limit_columns>>("limits", &P::limits),
      field("obstacles", &P::obstacles));
};

template <>
struct Fields<vsr::Batch> {
  using B = vsr::Batch;
  static constexpr auto members =
      fields(field("placed", &B::placed), field("upper_bound", &B::upper_bound), field("moved", &B::moved),
             field("source", &B::source), field("certificates", &B::certificates), field("links", &B::links),
             field("same_position", &B::same_position), field("clear", &B::clear), field("smoothing", &B::smoothing));
};

template <>
struct Fields<vsr::BatchResult> {
  using R = vsr::BatchResult;
  static constexpr auto members =
      fields(field("cost", &R::cost), field("refuted_by", &R::refuted_by), field("certificates", &R::certificates),
             field("links", &R::links), field("clear", &R::clear));
};

template <>
struct Fields<vsr::Sources> {
  using S = vsr::Sources;
  static constexpr auto members =
      fields(field("row", &S::row), field("placed", &S::placed), field("changed", &S::changed),
             field("same_position", &S::same_position), field("links", &S::links), field("clear", &S::clear));
};

namespace {

using namespace vsr;

using Counter = Shaped<View<std::int64_t>, 1>;

void check_cones(Rows<const double> cones) {
  require(cones.columns() >= Cones::first_beam, "cones: at least six columns");
}

void check_placed(const Placed& placed, Index count, Index lidars) {
  require(placed.cones.tables() == count, "placed.cones: a table for each");
  require(placed.cones.rows() == lidars, "placed.cones: a row for each LiDAR");
  require(placed.cones.columns() >= Cones::first_beam, "placed.cones: at least six columns");
  require(placed.limits.tables() == count, "placed.limits: a table for each");
  require(placed.limits.rows() == 0 || placed.limits.rows() == lidars, "placed.limits: a row for each LiDAR, or none");
  check_obstacles(placed.obstacles);
}

void check_batch(const TrialEvaluator& evaluator, const Batch& batch, const BatchResult& result) {
  const Index count = std::ssize(batch.source);
  const Index lidars = evaluator.lidars();
  const Index rows = evaluator.grid().rows();
  check_placed(batch.placed, count, lidars);
  require(std::ssize(batch.upper_bound) == count, "upper_bound: one for each trial");
  require_columns(batch, "batch", "a flag for each LiDAR of each trial",
                  std::tuple(&Batch::moved, &Batch::same_position), count, lidars);
  require(batch.certificates.rows() == count, "certificates: a row for each trial");
  require(batch.links.tables() == 0 || has_shape(batch.links, batch.links.tables(), lidars, rows),
          "links: of each LiDAR, a row for each of the grid's");
  require(batch.clear.tables() == 0 || has_shape(batch.clear, batch.clear.tables(), lidars, rows),
          "clear: of each LiDAR, a word for each row of the grid");
  for (Index trial = 0; trial < count; ++trial) {
    const Index source = batch.source[trial];
    for (Index lidar = 0; lidar < lidars; ++lidar) {
      require(batch.moved(trial, lidar) || (0 <= source && source < batch.links.tables()),
              "source: not a row of links");
      require(!batch.same_position(trial, lidar) || (0 <= source && source < batch.clear.tables()),
              "source: not a row of clear");
    }
    for (const std::int64_t certificate : batch.certificates[trial]) {
      require(-1 <= certificate && certificate < evaluator.cases() * evaluator.grid().cuboids(),
              "certificates: not a cuboid of a case");
    }
  }
  using R = BatchResult;
  require_columns(result, "result", "one for each trial", std::tuple(&R::cost, &R::refuted_by), count);
  require_columns(result, "result", "as many for each trial as the evaluator finds", std::tuple(&R::certificates),
                  count, evaluator.certificates());
  require(result.links.rows() == 0 || has_shape(result.links, count, rows),
          "result.links: for each trial a row for each of the grid's, or none");
  require(result.clear.rows() == 0 || has_shape(result.clear, count, rows),
          "result.clear: for each trial a word for each row of the grid, or none");
  require(result.clear.rows() == 0 || batch.placed.limited(), "result.clear: none where everything is seen");
}

void check_sources(const TrialEvaluator& evaluator, const Sources& sources) {
  const Index count = std::ssize(sources.row);
  const Index lidars = evaluator.lidars();
  const Index rows = evaluator.grid().rows();
  const bool limited = sources.placed.limited();
  check_placed(sources.placed, count, lidars);
  require_columns(sources, "sources", "a flag for each LiDAR of each source",
                  std::tuple(&Sources::changed, &Sources::same_position), count, lidars);
  require(sources.links.rows() == lidars && sources.links.columns() == rows,
          "links: of each LiDAR, a row for each of the grid's");
  require(!limited || (sources.clear.rows() == lidars && sources.clear.columns() == rows),
          "clear: of each LiDAR, a word for each row of the grid");
  for (const Index row : sources.row) {
    require(0 <= row && row < sources.links.tables(), "row: not a row of links");
    require(!limited || row < sources.clear.tables(), "row: not a row of clear");
  }
}

Array<std::int64_t, 2> bound_beam_gaps(View<const Vec3> points, Rows<const double> cones) {
  check_cones(cones);
  const std::size_t count = points.size();
  const auto lidars = static_cast<std::size_t>(cones.rows());
  Array<std::int64_t, 2> out{std::vector<std::int64_t>(count * lidars), {count, lidars}};
  beam_gaps(points, cones, {out.values.data(), std::ssize(points), cones.rows()});
  return out;
}

Array<Word, 2> bound_seen(const Grid& grid, Rows<const double> cones, const Sight& sight) {
  check_cones(cones);
  require(sight.limits.rows() >= cones.rows(), "sight.limits: a row for each LiDAR");
  check_obstacles(sight.obstacles);
  const auto lidars = static_cast<std::size_t>(cones.rows());
  const auto rows = static_cast<std::size_t>(grid.rows());
  Array<Word, 2> out{std::vector<Word>(lidars * rows), {lidars, rows}};
  VisibilityCache cache(cones.rows(), grid.rows());
  for (Index lidar = 0; lidar < cones.rows(); ++lidar) {
    find_seen(grid, lidar, cones, sight, cache, {out.values.data() + lidar * grid.rows(), rows});
  }
  return out;
}

void bound_links(const Grid& grid, Rows<const double> cones, Rows<const Word> seen, View<Links> out) {
  check_cones(cones);
  require(seen.rows() == 0 || seen.rows() == cones.rows(), "seen: a row for each LiDAR, or none");
  require(seen.rows() == 0 || seen.columns() == grid.rows(), "seen: a word for each row of the grid");
  require(std::ssize(out) == grid.rows(), "out: links for each row of the grid");
  std::ranges::copy(grid.links, out.begin());
  Linker linker(grid);
  for (Index lidar = 0; lidar < cones.rows(); ++lidar) {
    linker.cut(Cones(cones[lidar]), seen.rows() ? seen[lidar] : View<const Word>(), out);
  }
}

std::tuple<std::vector<std::int64_t>, Array<std::int64_t, 2>, std::vector<std::int64_t>> bound_components(
    const Grid& grid, View<const Links> links, Tables<std::int32_t> label) {
  const auto [nx, ny, nz] = grid.shape();
  require(std::ssize(links) == grid.rows(), "links: for each row of the grid");
  for (Index row = 0; row < grid.rows(); ++row) {
    require((links[row] & grid.links[row]) == links[row], "links: not of neighbours in the grid");
  }
  require(has_shape(label, nx, ny, nz), "label: of the grid's shape");
  require(label.size() < std::numeric_limits<std::int32_t>::max(), "label: fewer than 2^31 cuboids");
  Components found = label_components(grid, links, label);
  const std::size_t count = found.cuboids.size();
  return std::tuple(std::move(found.cuboids), Array<std::int64_t, 2>{std::move(found.internal), {count, 3}},
                    std::move(found.first));
}

}  // namespace

void bind_vsr(nb::module_& module) {
  record<Sight>(module, "Sight", "What LiDARs at known poses may see.");
  record<Placed>(module, "Placed", "LiDARs at poses.");
  record<Batch>(module, "Batch", "Trials to evaluate, and what is known of their food sources.");
  record<BatchResult>(module, "BatchResult", "What becomes of trials, to be written.");
  record<Sources>(module, "Sources", "Food sources whose links are to be recomputed.");
  nb::class_<Grid> grid(module, "Grid",
                        "A region as rows of bits, 64 cuboids along x, with a margin; it does not change.");
  init(
      grid,
      [](View<const double> x, View<const double> y, View<const double> z, View<const Word> included, Vec3 edge,
         View<const double> weight,
         Rows<const Word> weighted) { return Grid(x, y, z, included, edge, weight, weighted); },
      "Centres (nx,), (ny,), (nz,); included (rows,); edge (3,); weight (levels,); weighted (levels, rows).", "x", "y",
      "z", "included", "edge", "weight", "weighted");
  grid.def_prop_ro("rows", &Grid::rows, "How many rows of bits it has, those of the margin too.");
  grid.def_prop_ro("chunks", &Grid::step_y, "How many rows there are along x.");
  grid.def_prop_ro(
      "shape",
      [](const Grid& self) {
        const auto [nx, ny, nz] = self.shape();
        return nb::typed<nb::tuple, Index, Index, Index>(nb::make_tuple(nx, ny, nz));
      },
      "The cuboids along each axis.");

  def(module, "beam_gaps", bound_beam_gaps,
      "(N, lidars) the beam gap index of points (N, 3) for each LiDAR of cones (lidars, 6 + beams).", "points",
      "cones");
  def(module, "seen", bound_seen, "(lidars, rows) which cuboids each LiDAR sees.", "grid", "cones", "sight");
  def(module, "links", bound_links,
      "Write to out (rows, 3) the links by LiDARs that see seen (lidars, rows), or everything: (0, rows).", "grid",
      "cones", "seen", "out");
  def(module, "label_components", bound_components,
      R"(Write the number of each cuboid's subspace under links (rows, 3) to label (nx, ny, nz), −1 where excluded.

Returns cuboids (n,) in each, internal faces (n, 3) of each across x, y and z, and the first cuboid (n,) of
each.)",
      "grid", "links", "label");

  nb::class_<TrialEvaluator> evaluator(module, "TrialEvaluator", "Evaluates trials. Not for several threads at once.");
  init(
      evaluator,
      [](const Grid& grid, Rows<const bool> cases, Index certificates) {
        require(cases.rows() > 0, "cases: none");
        require(1 <= certificates && certificates <= 1 << 20, "certificates: not from 1 to 2^20");
        return TrialEvaluator(grid, cases, certificates);
      },
      "For rigs in a grid, with the LiDARs of each of the cases (cases, lidars).", "grid", "cases", "certificates");
  def(
      evaluator, "evaluate_batch",
      [](TrialEvaluator& self, Counter counter, Index most, const Batch& batch, bool in_full,
         const BatchResult& result) {
        check_batch(self, batch, result);
        const Effort effort = self.evaluate_batch(counter, most, batch, in_full, result);
        return std::tuple(effort.full_cases, effort.compared_rows, effort.cast_segments);
      },
      R"(Evaluate the next trials, at most so many, that a counter (1,) has, and write what becomes of them.

Returns how many cases were evaluated in full, how many rows were compared with cones for other trials, and
how many segments were cast.)",
      "counter", "most", "batch", "in_full", "result");
  def(
      evaluator, "recompute_links",
      [](TrialEvaluator& self, Counter counter, Index most, const Sources& sources) {
        check_sources(self, sources);
        self.recompute_links(counter, most, sources);
      },
      "Compute the links of changed LiDARs of the next food sources of a counter (1,), at most so many.", "counter",
      "most", "sources");

  def(
      module, "promote_certificates",
      [](Rows<std::int64_t> certificates, View<const std::int64_t> source, View<const std::int64_t> refuted_by) {
        require(source.size() == refuted_by.size(), "refuted_by: one for each trial");
        require(certificates.columns() > 0, "certificates: no columns");
        for (std::size_t trial = 0; trial < source.size(); ++trial) {
          require(refuted_by[trial] < 0 || (0 <= source[trial] && source[trial] < certificates.rows()),
                  "source: not a row of certificates");
        }
        promote_certificates(certificates, source, refuted_by);
      },
      R"(Move what refuted trials (n,), in their order, to the front of their sources' certificates (sources, c).

Where refuted_by is −1, no certificate has, and source does not matter.)",
      "certificates", "source", "refuted_by");
  bind_vsr_columns(module);
  bind_vsr_detection(module);
}

}  // namespace lidarcfg::bind
