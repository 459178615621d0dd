#include "placement/analytic.h"

#include <algorithm>
#include <cmath>

#include "placement/cones.h"

namespace lidarcfg::placement {
namespace {

constexpr double plane = 1e-9;       // a flatter cone, by the sine, is a plane
constexpr std::int64_t unseen = -1;  // the digit of a LiDAR that does not see a piece

/// `beam_gap` of a point, whose gap is likely to be `guess` or next to it.
std::int64_t beam_gap_near(std::int64_t guess, const Vec3& point, const Cones& lidar) {
  const SignedSquares squares = signed_squares(point[0] - lidar.position[0], point[1] - lidar.position[1],
                                               point[2] - lidar.position[2], lidar.axis);
  std::int64_t beam = guess;
  while (beam < std::ssize(lidar.beams) && squares.is_at_or_above(lidar.beams[beam])) {
    ++beam;
  }
  while (beam > 0 && !squares.is_at_or_above(lidar.beams[beam - 1])) {
    --beam;
  }
  return beam;
}

/// Cuts lines into pieces, and hands these to their subspaces.
class LineSweep {
 public:
  LineSweep(const Sheaf& sheaf, Rows<const std::int64_t> gap, Rows<const double> rows, const Flips& flips,
            const Sums& sums)
      : sheaf_(sheaf),
        lattice_(sheaf.lattice()),
        gap_(gap),
        flips_(flips),
        sums_(sums),
        area_(sheaf.edge[1] * sheaf.edge[2] / (lines_per_edge * lines_per_edge)),
        gaps_(rows.rows()),
        digits_(rows.rows()) {
    for (Index m = 0; m < rows.rows(); ++m) {
      lidars_.emplace_back(rows[m]);
    }
  }

  /// Pieces do not cross cuboids that do not count.
  void sweep(Index line) {
    const Lattice::Across across = lattice_.in_edges(line);
    const Index j = static_cast<Index>(across.u);
    const Index k = static_cast<Index>(across.v);
    const Lattice::Across place{sheaf_.low[1] + across.u * sheaf_.edge[1], sheaf_.low[2] + across.v * sheaf_.edge[2]};
    const Index count = lattice_.shape[0];
    for (Index start = 0; start < count; ++start) {
      Index end = start;
      while (end < count && sheaf_.within(end, j, k)) {
        ++end;
      }
      if (end > start) {
        sweep_run({line, j, k, start, end, place});
      }
      start = end;
    }
  }

 private:
  /// Cuboids of a line that count, from start to before end.
  struct Run {
    Index line, j, k;
    Index start, end;
    Lattice::Across place;
  };

  double wall(Index cuboid) const { return sheaf_.low[0] + static_cast<double>(cuboid) * sheaf_.edge[0]; }

  void sweep_run(const Run& run) {
    double here = wall(run.start);
    double face = 1.0;
    const double end = wall(run.end);
    cut(run.line, run.place, here, end);
    for (Index c = 0; c <= cuts_.size(); ++c) {
      const Crossing next = c < cuts_.size() ? cuts_[c] : Crossing{end, 1.0};
      if (next.at - here > sliver * sheaf_.edge[0]) {
        const double middle = 0.5 * (here + next.at);
        if (state(std::ssize(lidars_), run.line, middle)) {
          find_digits(run.line, lattice_.point(middle, run.place));
          const Index first = std::max(cuboid(here), run.start);
          const Index last = std::min(cuboid(next.at), run.end - 1);
          const Index owner = find_owner(first, last, run.j, run.k);
          if (owner >= 0) {
            sums_.volume[owner] += (next.at - here) * area_;
            sums_.shadow[owner] += area_;
            sums_.surface[owner] += (face + next.weight) * area_;
          }
        }
      }
      here = next.at;
      face = next.weight;
    }
  }

  Index cuboid(double at) const { return static_cast<Index>((at - sheaf_.low[0]) / sheaf_.edge[0]); }

  Index state_row(Index state, Index line) const { return state * flips_.start.columns() + line; }

  /// Find where anything cuts a line between low and high. A LiDAR's cones cut what it sees.
  void cut(Index line, const Lattice::Across& place, double low, double high) {
    cuts_.clear();
    for (Index m = 0; m < flips_.start.rows(); ++m) {
      const Index row = state_row(m, line);
      bool on = flips_.start(m, line);
      double here = low;
      for (Index f = flips_.first[row]; f <= flips_.first[row + 1]; ++f) {
        const double there = f == flips_.first[row + 1] ? high : std::min(flips_.at[f], high);
        if (there > low) {
          if (on && there > here && m < sheaf_.cones.rows()) {
            cross_cones(place, sheaf_.cones[m], here, there, cuts_);
          }
          here = there;
          if (there < high) {
            cuts_.insert({there, flips_.weight[f]});
          }
        }
        on = !on;
      }
    }
  }

  /// What a state is at a place of a line that is no flip of it.
  bool state(Index number, Index line, double here) const {
    const Index row = state_row(number, line);
    bool on = flips_.start(number, line);
    for (Index f = flips_.first[row]; f < flips_.first[row + 1] && flips_.at[f] <= here; ++f) {
      on = !on;
    }
    return on;
  }

  void find_digits(Index line, const Vec3& point) {
    for (Index m = 0; m < std::ssize(lidars_); ++m) {
      digits_[m] = unseen;
      if (state(m, line, point[sheaf_.axis])) {
        gaps_[m] = beam_gap_near(gaps_[m], point, lidars_[m]);
        digits_[m] = gaps_[m];
      }
    }
  }

  /// The subspace of a piece in the cuboids first … last of a line; −1: none has its digits.
  ///
  /// It is among those cuboids' or, where the piece is too thin to hold a centre, among those of the cuboids around. If
  /// several are, they are one.
  Index find_owner(Index first, Index last, Index j, Index k) {
    const Tables<const std::int32_t>& label = sheaf_.label;
    Index owner = -1;
    for (Index i = first; i <= last; ++i) {
      owner = join(owner, label(i, j, k));
    }
    if (owner >= 0) {
      return owner;
    }
    for (Index i = std::max<Index>(first - 1, 0); i < std::min(last + 2, label.tables()); ++i) {
      for (Index b = std::max<Index>(j - 1, 0); b < std::min(j + 2, label.rows()); ++b) {
        for (Index c = std::max<Index>(k - 1, 0); c < std::min(k + 2, label.columns()); ++c) {
          owner = join(owner, label(i, b, c));
        }
      }
    }
    return owner;
  }

  /// The owner of a piece that touches subspace `one`; both are one from now on if both have its digits.
  Index join(Index owner, Index one) {
    if (one < 0 || one == owner || !std::equal(digits_.begin(), digits_.end(), gap_[one].begin())) {
      return owner;
    }
    if (owner < 0) {
      return one;
    }
    const Index a = root(owner);
    const Index b = root(one);
    sums_.parent[std::max(a, b)] = std::min(a, b);
    return owner;
  }

  Index root(Index subspace) const {
    while (sums_.parent[subspace] != subspace) {
      subspace = sums_.parent[subspace];
    }
    return subspace;
  }

  Sheaf sheaf_;
  Lattice lattice_;
  Rows<const std::int64_t> gap_;
  Flips flips_;
  Sums sums_;
  double area_;  // of a line
  std::vector<Cones> lidars_;
  Crossings cuts_;                    // of a run
  std::vector<std::int64_t> gaps_;    // of the last piece that each LiDAR saw
  std::vector<std::int64_t> digits_;  // of a piece
};

}  // namespace

void cross_cones(const Lattice::Across& across, View<const double> cone, double low, double high, Crossings& out) {
  const double du = across.u - cone[1];
  const double dv = across.v - cone[2];
  const double slope = cone[3];
  const double height = du * cone[4] + dv * cone[5];  // at the LiDAR's foot on the line
  const double distance2 = du * du + dv * dv;
  for (const double given : cone.subspan(Cones::first_beam)) {
    const double sine = std::abs(given) < plane ? 0.0 : given;
    if (!(std::abs(sine) < 1.0)) {  // a cone closed to its axis
      continue;
    }
    const double root = std::sqrt(height * height + distance2 * (slope * slope - sine * sine));
    for (const double signed_root : {root, -root}) {
      double s = (slope * distance2 * sine - height * signed_root) / (height * sine + slope * signed_root);
      if (distance2 == 0.0) {
        s = 0.0;
      }
      const double here = cone[0] + s;
      if (low < here && here < high && !((slope * s + height) * sine < 0.0)) {  // not NaN, nor the mirrored cone
        double weight = 0.0;
        if (distance2 > 0.0) {
          weight = std::abs(slope - sine * s / std::sqrt(s * s + distance2)) / std::sqrt(1.0 - sine * sine);
        }
        out.insert({here, weight});
      }
      if (sine == 0.0) {
        break;
      }
    }
  }
}

void sweep_lines(const Sheaf& sheaf, Rows<const std::int64_t> gap, Rows<const double> rows, const Flips& flips,
                 const Sums& sums) {
  LineSweep sweep(sheaf, gap, rows, flips, sums);
  for (Index line = 0; line < sheaf.lattice().count(); ++line) {
    sweep.sweep(line);
  }
}

}  // namespace lidarcfg::placement
