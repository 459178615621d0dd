/// What the processor at hand can do.
#pragma once

namespace lidarcfg {

/// The x86-64 level whose instructions it has, from 1 to 3; 0 where it is none of that kind.
inline int x86_64_level() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("bmi") && __builtin_cpu_supports("bmi2") &&
      __builtin_cpu_supports("fma")) {
    return 3;
  }
  return __builtin_cpu_supports("sse4.2") && __builtin_cpu_supports("popcnt") ? 2 : 1;
#else
  return 0;
#endif
}

}  // namespace lidarcfg
