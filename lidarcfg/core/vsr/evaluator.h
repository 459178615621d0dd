/// A search's trials: each is drawn around a food source, and kept only if its cost is below an upper bound.
///
/// Of each food source the links of every LiDAR are kept, so that a trial computes only those of the LiDARs that moved.
/// Before that, the subspaces of a few cuboids may refute it, as in branch and bound: certificates, in which the worst
/// subspaces of the food source were, or those that refuted earlier trials of it. A certificate is a cuboid's number +
/// Grid::cuboids() × the number of a case: the LiDARs that are left when others fail.
#pragma once

#include <vector>

#include "vsr/flood.h"
#include "vsr/linker.h"
#include "vsr/worst.h"

namespace lidarcfg::vsr {

/// LiDARs at poses.
struct Placed {
  Tables<const double> cones;   // (n, lidars, 6 + beams), rows of `Cones`
  Tables<const double> limits;  // (n, lidars, 9), see Sight; (n, 0, 9) where everything is seen
  Obstacles obstacles;

  bool limited() const { return limits.rows() > 0; }
  Sight sight(Index n) const { return {limits[n], obstacles}; }
};

/// Trials to evaluate, and what is known of the food sources that they were drawn around.
struct Batch {
  Placed placed;
  View<const double> upper_bound;         // (n,) the cost that a trial has to be below
  Rows<const bool> moved;                 // (n, lidars) the LiDARs whose pose differs from the source's
  View<const std::int64_t> source;        // (n,) a row of `links`
  Rows<const std::int64_t> certificates;  // (n, c) cuboids whose subspaces may refute a trial; −1 for none
  Tables<const Links> links;              // (sources, lidars, rows) not where all LiDARs count as moved
  Rows<const bool> same_position;         // (n, lidars) the LiDARs of which `clear` of the source is true
  Tables<const Word> clear;               // (sources, lidars, rows), see VisibilityCache; or none
  double smoothing = 0.0;                 // see WorstList; 0: none
};

/// What becomes of the trials.
struct BatchResult {
  View<double> cost;                // (n,) or inf where it is not below the bound; NaN where it was not computed
  View<std::int64_t> refuted_by;    // (n,) the certificate whose subspace refuted a trial, or −1
  Rows<std::int64_t> certificates;  // (n, c) in the worst subspaces of a trial that was not refuted
  Rows<Links> links;                // (n, rows) of such a trial the links of the last LiDAR that moved; or none
  Rows<Word> clear;                 // (n, rows) and what is clear of it, see VisibilityCache; or none
};

/// How much was done.
struct Effort {
  Index full_cases = 0;            // cases that were evaluated in full
  Index compared_rows = 0;         // rows that were compared with cones for other trials
  std::int64_t cast_segments = 0;  // from LiDARs to cuboids
};

/// Some food sources, and what is to be computed anew of them.
struct Sources {
  View<const std::int64_t> row;  // (n,) of `links` and `clear`
  Placed placed;
  Rows<const bool> changed;        // (n, lidars) whose links are those of another pose
  Rows<const bool> same_position;  // (n, lidars) whose `clear` is not
  Tables<Links> links;             // (sources, lidars, rows) of which these are written
  Tables<Word> clear;              // (sources, lidars, rows), or none
};

/// Evaluates trials. Each thread has its own.
class TrialEvaluator {
 public:
  /// @param cases         (cases, lidars) the LiDARs of each case; a trial is as bad as its worst case
  /// @param certificates  how many a trial may have
  TrialEvaluator(const Grid& grid, Rows<const bool> cases, Index certificates);

  Index lidars() const { return lidars_; }
  Index cases() const { return std::ssize(left_); }
  Index certificates() const { return std::ssize(worst_.values()); }
  const Grid& grid() const { return grid_; }

  /// Take the next trials of a batch from a counter that threads share, at most so many, and write what becomes of
  /// them.
  ///
  /// First the subspaces of a trial's certificates are flooded, and rows are compared with cones as the flood gets to
  /// them; one whose value is no less than the bound refutes the trial. Only without one are all links computed, once
  /// for all cases, and only if `in_full`.
  Effort evaluate_batch(View<std::int64_t> counter, Index most, const Batch& batch, bool in_full,
                        const BatchResult& result);

  /// Take the next food sources, at most so many, and compute links and clear of LiDARs that have changed.
  void recompute_links(View<std::int64_t> counter, Index most, const Sources& sources);

 private:
  struct Refutation {
    Index certificate = -1;
    Index compared_rows = 0;
    bool linked = false;  // all links were computed, see `lazy`
  };

  Refutation refute(const Batch& batch, Index trial);
  Index evaluate(const Batch& batch, Index trial);
  Index order_cases(View<const std::int64_t> certificates);
  View<const std::int64_t> find_moved(const Batch& batch, Index trial, Index only_case);
  void join_links(const Batch& batch, Index trial, Index only_case, bool with_moved);
  void link_moved(const Batch& batch, Index trial);
  void link(Index lidar, Rows<const double> cones, const Sight& sight, View<Links> links);
  void keep(const Batch& batch, Index trial, const BatchResult& result);

  Grid grid_;
  Index lidars_;
  std::vector<std::vector<std::int64_t>> cases_;  // the LiDARs of each
  Linker linker_;
  Flooder flooder_;
  VisibilityCache visibility_;
  std::vector<Word> seen_;               // (rows,) by a LiDAR
  std::vector<const Links*> joined_;     // the links (rows,) that are joined to these:
  std::vector<Links> links_;             // (rows,) of a case
  std::vector<std::vector<Links>> own_;  // (lidars, rows) of LiDARs that moved
  std::vector<std::vector<Word>> left_;  // (cases, rows) cuboids that no flood from a certificate has reached
  std::vector<Index> order_;             // (cases,) in the order of evaluation
  std::vector<std::int64_t> moved_;      // LiDARs
  WorstList worst_;                      // of all cases, by certificates
};

/// Move what refuted a trial, in the order of trials, to the front of its source's certificates.
///
/// @param certificates  (sources, c)
/// @param source        (n,) of each trial
/// @param refuted_by    (n,) a certificate, or −1
void promote_certificates(Rows<std::int64_t> certificates, View<const std::int64_t> source,
                          View<const std::int64_t> refuted_by);

}  // namespace lidarcfg::vsr
