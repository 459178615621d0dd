/// Times in integer nanoseconds. What is not true of any time wraps around instead of overflowing.
#pragma once

#include <cstdint>

namespace lidarcfg {

/// A time so much later.
inline std::int64_t later(std::int64_t time_ns, std::int64_t by_ns) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(time_ns) + static_cast<std::uint64_t>(by_ns));
}

/// Seconds from a time to a later one.
inline double seconds_between(std::int64_t from_ns, std::int64_t to_ns) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(to_ns) - static_cast<std::uint64_t>(from_ns)) / 1e9;
}

}  // namespace lidarcfg
