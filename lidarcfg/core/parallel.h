/// Numbered work that threads share: each takes the next number as soon as it is done with its last.
#pragma once

#include "views.h"

namespace lidarcfg {

/// The next number, which no other thread gets, of a counter (1,) that threads share.
inline std::int64_t take(View<std::int64_t> counter) { return __atomic_fetch_add(counter.data(), 1, __ATOMIC_RELAXED); }

}  // namespace lidarcfg
