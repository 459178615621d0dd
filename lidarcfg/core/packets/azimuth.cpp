#include "packets/azimuth.h"

#include <algorithm>
#include <limits>

namespace lidarcfg::packets {
namespace {

constexpr double period_tolerance = 0.1;  // successive packets are this near to the period, as a fraction of it
constexpr double jump = 50;               // a step half as large again as the packet's least one, and this, is a jump
constexpr std::int64_t second_ns = 1'000'000'000;

/// Hundredths clockwise.
int clockwise(int from, int to) { return ((to - from) % revolution + revolution) % revolution; }

/// The same of a step the shorter way round.
double clockwise(double step) { return step < 0 ? step + revolution : step; }

/// Hundredths the shorter way round, from -18000.
int shortest(int from, int to) { return clockwise(from, to + revolution / 2) - revolution / 2; }

std::int64_t rounded(double value) { return static_cast<std::int64_t>(std::nearbyint(value)); }

}  // namespace

Turning::Turning(Index groups, std::int64_t period_ns, std::int64_t group_ns)
    : groups_(groups), period_ns_(period_ns), group_ns_(group_ns), step_(groups), late_ns_(groups) {}

bool Turning::follows(std::int64_t gap_ns) const {
  const double period_ns = static_cast<double>(period_ns_);
  return std::abs(static_cast<double>(gap_ns) - period_ns) <= period_tolerance * period_ns;
}

VelodyneTurning::VelodyneTurning(Index groups, std::int64_t period_ns, std::int64_t group_ns)
    : Turning(groups, period_ns, group_ns), ahead_(groups), jump_(groups) {}

void VelodyneTurning::advance(View<const std::uint16_t> azimuth, std::uint16_t next_azimuth, std::int64_t gap_ns) {
  for (Index g = 0; g < groups_; ++g) {
    ahead_[g] = shortest(azimuth[g], g + 1 < groups_ ? azimuth[g + 1] : next_azimuth);
  }
  const bool cut = find_jumps(gap_ns);
  double usual = groups_ == 1 ? before_ : 0;  // the last step that is no jump
  for (Index g = groups_ - 1; g >= 0; --g) {
    usual = jump_[g] ? usual : ahead_[g];
  }
  for (Index g = 0; g < groups_; ++g) {
    usual = jump_[g] ? usual : ahead_[g];
    step_[g] = usual;
  }
  before_ = step_[0];
  std::fill(late_ns_.begin(), late_ns_.end(), 0);
  if (cut) {
    delay(gap_ns);
  }
}

/// Marks which of the packet's steps lead over a gap; whether one within the packet does.
bool VelodyneTurning::find_jumps(std::int64_t gap_ns) {
  const Index end = groups_ - 1;
  const bool next = follows(gap_ns);
  double least = next ? std::abs(ahead_[end]) : std::numeric_limits<double>::infinity();
  for (Index g = 0; g < end; ++g) {
    least = std::min(least, std::abs(ahead_[g]));
  }
  bool cut = false;
  for (Index g = 0; g < end; ++g) {
    jump_[g] = std::abs(ahead_[g]) > 1.5 * least + jump;
    cut = cut || jump_[g];
  }
  const bool near = std::abs(ahead_[end]) <= 1.5 * least + jump;
  jump_[end] = !(near && (next || (cut && gap_ns > 0)));
  return cut;
}

/// Writes how much later the groups of a packet with jumps are than its stamp says.
void VelodyneTurning::delay(std::int64_t gap_ns) {
  double missing = 0;  // hundredths that the head turned while nothing was fired
  double turned = 0;
  Index steady = 0;
  for (Index g = 0; g < groups_; ++g) {
    if (!jump_[g]) {
      turned += step_[g];
      ++steady;
    } else if (g + 1 < groups_ || gap_ns > 0) {
      missing += std::max(clockwise(ahead_[g]) - step_[g], 0.0);
    }
  }
  double spare_ns = static_cast<double>(gap_ns) - static_cast<double>(period_ns_);
  if (!(0 < spare_ns && spare_ns < second_ns)) {
    spare_ns = turned > 0 ? missing * steady / turned * group_ns_ : 0;
  }
  double passed = 0;
  for (Index g = 0; g + 1 < groups_; ++g) {
    if (jump_[g]) {
      passed += std::max(clockwise(ahead_[g]) - step_[g], 0.0);
    }
    late_ns_[g + 1] = missing > 0 ? rounded(spare_ns * passed / missing) : 0;
  }
}

void RobosenseTurning::advance(View<const std::uint16_t> azimuth, std::uint16_t next_azimuth, std::int64_t gap_ns) {
  const Index end = groups_ - 1;
  double least = std::numeric_limits<double>::infinity();
  for (Index g = 0; g < groups_; ++g) {
    step_[g] = clockwise(azimuth[g], g < end ? azimuth[g + 1] : next_azimuth);
    least = g < end ? std::min(least, step_[g]) : least;
  }
  const bool next = follows(gap_ns);
  double usual = groups_ > 1 ? least : 0;
  double missing_ns = 0;  // in which nothing was fired
  for (Index g = 0; g < groups_; ++g) {
    late_ns_[g] = rounded(missing_ns);
    if (step_[g] <= 1.5 * least + jump && (g < end || next)) {
      usual = step_[g];
      continue;
    }
    if (usual > 0 && (g < end || gap_ns > 0)) {
      missing_ns += std::max(step_[g] / usual - 1, 0.0) * group_ns_;
    }
    step_[g] = usual;
  }
  if (late_ns_[end] != 0 && 0 < gap_ns && gap_ns < second_ns) {  // the next packet says how long that took
    const double spare_ns = static_cast<double>(std::max<std::int64_t>(gap_ns - period_ns_, 0));
    for (std::int64_t& late_ns : late_ns_) {
      late_ns = rounded(late_ns / missing_ns * spare_ns);
    }
  }
}

}  // namespace lidarcfg::packets
