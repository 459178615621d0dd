/// Firings of a sensor's lasers, and the batches in which they are traced.
#pragma once

#include <vector>

#include "times.h"
#include "views.h"

namespace lidarcfg::simulate {

/// N firings.
struct Firings {
  View<const std::int64_t> time_ns;  // (N,)
  View<const std::uint8_t> laser;    // (N,)
  View<const double> encoder_rad;    // (N,) clockwise
  View<const double> elevation_rad;  // (N,) of the beams; empty: those of the lasers
  Rows<const double> start_m;        // (N, 3) of the beams, in the sensor's frame; none: where the lasers say
};

/// Firings in an order in which neighbours point in nearly the same direction: by block of time, and then by laser.
struct Batches {
  std::vector<Index> order;         // (N,) numbers of firings
  std::vector<Index> first;         // where in this order each batch begins; then N
  std::vector<std::int64_t> block;  // of each batch
  std::int64_t zero_ns = 0;         // when the first block begins
  std::int64_t block_ns = 0;        // how long each is

  Index count() const { return std::ssize(block); }

  /// When the block of a batch begins.
  std::int64_t begin_ns(Index batch) const {
    const std::uint64_t after_ns = static_cast<std::uint64_t>(block[batch]) * static_cast<std::uint64_t>(block_ns);
    return later(zero_ns, static_cast<std::int64_t>(after_ns));
  }

  View<const Index> operator[](Index batch) const {
    return View<const Index>(order).subspan(first[batch], first[batch + 1] - first[batch]);
  }
};

/// Divide firings into batches of at most `most`, each of one laser and one block of time.
///
/// Blocks last at least `block_ns`, and longer where there would be thousands; 0: there is one.
Batches divide(const Firings& firings, Index most, std::int64_t block_ns);

}  // namespace lidarcfg::simulate
