#include "simulate/firings.h"

#include <algorithm>
#include <numeric>

namespace lidarcfg::simulate {
namespace {

constexpr Index lasers = 256;           // that their numbers can tell apart
constexpr std::uint64_t blocks = 4096;  // at most

}  // namespace

Batches divide(const Firings& firings, Index most, std::int64_t block_ns) {
  const Index count = std::ssize(firings.time_ns);
  Batches out;
  if (count == 0) {
    out.first = {0};
    return out;
  }
  const auto [low, high] = std::minmax_element(firings.time_ns.begin(), firings.time_ns.end());
  const std::uint64_t zero_ns = *low;
  const std::uint64_t span_ns = *high - zero_ns;
  const std::uint64_t lasts_ns = block_ns ? std::max<std::uint64_t>(block_ns, span_ns / blocks + 1) : span_ns + 1;
  out.zero_ns = *low;
  out.block_ns = static_cast<std::int64_t>(lasts_ns);

  std::vector<std::int32_t> group(count);
  for (Index n = 0; n < count; ++n) {
    const std::uint64_t block = block_ns ? (firings.time_ns[n] - zero_ns) / lasts_ns : 0;
    group[n] = static_cast<std::int32_t>(block * lasers + firings.laser[n]);
  }
  std::vector<Index> end(*std::max_element(group.begin(), group.end()) + 1);  // first how many, then where, each ends
  for (const std::int32_t one : group) {
    ++end[one];
  }
  std::partial_sum(end.begin(), end.end(), end.begin());
  for (Index g = 0; g < std::ssize(end); ++g) {
    const Index last = end[g];
    for (Index begin = g ? end[g - 1] : 0; begin < last; begin += most) {
      out.first.push_back(begin);
      out.block.push_back(g / lasers);
    }
  }
  out.first.push_back(count);
  out.order.resize(count);
  for (Index n = count - 1; n >= 0; --n) {
    out.order[--end[group[n]]] = n;
  }
  return out;
}

}  // namespace lidarcfg::simulate
