/// A subspace by flooding links, a row of bits at a time; its faces are counted by counting bits.
#pragma once

#include <vector>

#include "vsr/cones.h"
#include "vsr/grid.h"
#include "vsr/visibility.h"

namespace lidarcfg::vsr {

/// What separates cuboids: missing links, and the cones of LiDARs whose links are not computed.
struct Barriers {
  View<const Links> links;         // (rows,) of all LiDARs but `moved`
  Rows<const double> cones;        // (lidars, 6 + beams), rows of `Cones`
  View<const std::int64_t> moved;  // the LiDARs whose beam gap is computed row by row, as a flood gets there
  Sight sight;                     // of the LiDARs
};

/// What a flood found.
struct Subspace {
  Index cuboids = 0;
  std::array<Index, 3> internal{};  // faces inside, across x, y and z

  /// Volume to surface in metres (paper, eq. 7), of cuboids with these edges; metric.vsr_m, term by term.
  double vsr(const Vec3& edge) const;
};

/// Floods one subspace after another of a grid. Not for several threads at once.
class Flooder {
 public:
  /// A step of a flood: cuboids of a row.
  struct Step {
    Index row;
    Word bits;
  };

  /// Nothing is flooded yet.
  explicit Flooder(const Grid& grid);

  /// The cuboids (rows,) that no flood has reached. Others may be written to it, of Grid::included.
  std::vector<Word>& left() { return left_; }
  const std::vector<Word>& left() const { return left_; }

  /// Remove from what is left the subspace of a cuboid that is left, by the links (rows,) of all LiDARs.
  const Subspace& flood(View<const Links> links, Index cuboid);

  /// The same where the beam gaps of some LiDARs are compared row by row; their links must be some of Grid::links.
  const Subspace& flood(const Barriers& barriers, VisibilityCache& cache, Index cuboid);

  /// Of how many rows the last flood by barriers has compared beam gaps.
  Index compared_rows() const { return compared_rows_; }

  /// The last flood, step by step.
  View<const Step> steps() const { return {steps_.data(), step_count_}; }

  /// A cuboid of the last flood, halfway along its fullest row.
  Index inner_cuboid() const;

  /// The greatest weight of the last flood's cuboids; 1 where cuboids have none.
  double weight() const;

 private:
  class Gaps;

  /// @param inside  which cuboids of a row are not separated from the flood's first by what links do not say
  template <bool lazily, class Inside>
  const Subspace& run(View<const Links> links, Index cuboid, Inside inside);

  Grid grid_;
  std::vector<Word> left_;
  std::vector<Step> waiting_;  // from where to go on; grows
  std::vector<Step> steps_;    // grows
  std::size_t step_count_ = 0;
  std::size_t fullest_ = 0;  // of the steps
  Subspace found_;

  // Of floods by barriers:
  std::vector<Index> known_;  // (rows,) the stamp of the flood that `inside_` belongs to
  std::vector<Word> inside_;  // (rows,) the cuboids in the flood's beam gaps
  Index stamp_ = 0;           // another one for every flood
  Index compared_rows_ = 0;
};

}  // namespace lidarcfg::vsr
