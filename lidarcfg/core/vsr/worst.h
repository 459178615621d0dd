/// The worst subspaces: those of the largest volume to surface, without flooding those that cannot be among them.
#pragma once

#include <vector>

#include "vsr/flood.h"

namespace lidarcfg::vsr {

/// Some subspaces of the largest values, descending, each by a cuboid in it. A subspace's value is its volume to
/// surface in metres, times its weight where cuboids have weights.
class WorstList {
 public:
  explicit WorstList(Index size) : values_(size), cuboids_(size) { clear(); }

  void clear();

  /// Insert a subspace if it belongs there; returns whether it does.
  bool insert(double value, Index cuboid);

  /// −1 where there are fewer subspaces.
  View<const double> values() const { return values_; }
  View<const std::int64_t> cuboids() const { return cuboids_; }

  /// The p-norm of the values above 0, p = 1 / smoothing: at least the greatest, which it is without smoothing.
  double norm(double smoothing) const;

  /// Whether the norm is surely at least so much, whatever values may be added.
  bool reaches(double bound, double smoothing) const;

 private:
  std::vector<double> values_;
  std::vector<std::int64_t> cuboids_;
};

/// Insert the worst of the subspaces that a flooder has left into a list.
///
/// Skips cuboids that cannot be in any of them. Ends as soon as the list's norm reaches a bound.
///
/// @param links  (rows,) of all LiDARs
/// @param first  is added to the numbers of cuboids
/// @return       whether the norm has reached the bound
bool find_worst(const Grid& grid, View<const Links> links, double bound, double smoothing, Index first,
                Flooder& flooder, WorstList& worst);

}  // namespace lidarcfg::vsr
