/// Numbered work that threads share: each takes the next number as soon as it is done with its last.
#pragma once

#include "views.h"

namespace lidarcfg {

/// The next number, which no other thread gets, of a counter (1,) that threads share; -1 if none below `count` is left.
inline Index take(View<std::int64_t> counter, Index count) {
  const std::int64_t number = __atomic_fetch_add(counter.data(), 1, __ATOMIC_RELAXED);
  return 0 <= number && number < count ? number : -1;
}

}  // namespace lidarcfg
