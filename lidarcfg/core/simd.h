/// Vectors of the compiler's vector extensions, exactly as wide as a register: wider ones are taken apart lane by lane.
#pragma once

#include <array>
#include <cstdint>
#include <cstring>

namespace lidarcfg::simd {

template <class T, int N>
struct VectorOf {
  typedef T type __attribute__((vector_size(N * sizeof(T))));
};

#if defined(__AVX__)
constexpr int register_bytes = 32;
#else
constexpr int register_bytes = 16;
#endif

/// How many values a register holds.
template <class T>
constexpr int lanes = register_bytes / sizeof(T);

template <class T>
using Vector = typename VectorOf<T, lanes<T>>::type;

using Doubles = Vector<double>;
using Floats = Vector<float>;
using Words = Vector<std::uint64_t>;

template <class V, class T>
V load(const T* from) {
  V out;
  std::memcpy(&out, from, sizeof out);
  return out;
}

template <class V, class T>
void store(T* to, V value) {
  std::memcpy(to, &value, sizeof value);
}

template <class V>
V min(V a, V b) {
  return a < b ? a : b;
}

template <class V>
V max(V a, V b) {
  return a > b ? a : b;
}

template <class V>
auto highest(V value) {
  constexpr int count = sizeof(V) / sizeof(value[0]);
  if constexpr (count == 8) {
    value = max(value, __builtin_shufflevector(value, value, 4, 5, 6, 7, 0, 1, 2, 3));
    value = max(value, __builtin_shufflevector(value, value, 2, 3, 0, 1, 6, 7, 4, 5));
    value = max(value, __builtin_shufflevector(value, value, 1, 0, 3, 2, 5, 4, 7, 6));
  } else if constexpr (count == 4) {
    value = max(value, __builtin_shufflevector(value, value, 2, 3, 0, 1));
    value = max(value, __builtin_shufflevector(value, value, 1, 0, 3, 2));
  } else {
    value = max(value, __builtin_shufflevector(value, value, 1, 0));
  }
  return value[0];
}

/// A bit for each lane of a comparison of floats, or of doubles, of whichever integers the compiler makes the mask.
template <class Mask>
unsigned bits(Mask mask) {
  constexpr bool narrow = sizeof(mask[0]) == sizeof(float);
#if defined(__AVX__)
  if constexpr (narrow) {
    return __builtin_ia32_movmskps256(reinterpret_cast<Floats>(mask));
  } else {
    return __builtin_ia32_movmskpd256(reinterpret_cast<Doubles>(mask));
  }
#elif defined(__SSE2__)
  if constexpr (narrow) {
    return __builtin_ia32_movmskps(reinterpret_cast<Floats>(mask));
  } else {
    return __builtin_ia32_movmskpd(reinterpret_cast<Doubles>(mask));
  }
#else
  unsigned out = 0;
  for (int n = 0; n < (narrow ? lanes<float> : lanes<double>); ++n) {
    out |= static_cast<unsigned>(mask[n] & 1) << n;
  }
  return out;
#endif
}

/// Comparisons of `mask_block` doubles at once, in eight registers, become bits by few instructions, but in the order
/// that packing leaves them in: where the double of which place is compared.
constexpr int mask_block = 8 * lanes<double>;

/// The place of the double whose comparison becomes bit `number`, 0 to `mask_block` − 1.
constexpr int mask_place(int number) {
#if defined(__AVX2__)  // packing stays within either half of a register
  return number % 16 / 2 * 4 + number / 16 * 2 + number % 2;
#else
  return number;
#endif
}

/// The higher halves of the lanes of two comparisons.
inline Vector<int> high_halves(Vector<std::int64_t> a, Vector<std::int64_t> b) {
  const auto low = reinterpret_cast<Floats>(a);  // there is one instruction for this, of floats
  const auto high = reinterpret_cast<Floats>(b);
#if defined(__AVX2__)
  return reinterpret_cast<Vector<int>>(__builtin_shufflevector(low, high, 1, 3, 9, 11, 5, 7, 13, 15));
#else
  return reinterpret_cast<Vector<int>>(__builtin_shufflevector(low, high, 1, 3, 5, 7));
#endif
}

/// A bit for each comparison of a block, of which there are the higher halves, register by register.
inline std::uint64_t block_bits(Vector<int> a, Vector<int> b, Vector<int> c, Vector<int> d) {
#if defined(__AVX2__)
  const auto low = __builtin_ia32_packssdw256(a, b);
  const auto high = __builtin_ia32_packssdw256(c, d);
  return static_cast<unsigned>(__builtin_ia32_pmovmskb256(__builtin_ia32_packsswb256(low, high)));
#elif defined(__SSE2__) && !defined(__AVX__)
  const auto low = __builtin_ia32_packssdw128(a, b);
  const auto high = __builtin_ia32_packssdw128(c, d);
  return static_cast<unsigned>(__builtin_ia32_pmovmskb128(__builtin_ia32_packsswb128(low, high)));
#else
  std::uint64_t out = 0;
  int number = 0;
  for (const Vector<int>& half : {a, b, c, d}) {
    for (int lane = 0; lane < lanes<int>; ++lane) {
      out |= static_cast<std::uint64_t>(half[lane] & 1) << number++;
    }
  }
  return out;
#endif
}

/// Whether any lane of a comparison of doubles is true.
template <class Mask>
bool any(Mask mask) {
#if defined(__AVX__)
  return __builtin_ia32_movmskpd256(reinterpret_cast<Doubles>(mask)) != 0;
#elif defined(__SSE2__)
  return __builtin_ia32_movmskpd(reinterpret_cast<Doubles>(mask)) != 0;
#else
  return (mask[0] | mask[1]) != 0;
#endif
}

/// One half of a register of integers as doubles: the lower, part 0, or the upper, part 1. None is above 2^31 − 1.
inline Doubles half_to_doubles(Vector<std::uint32_t> values, int part) {
  constexpr int half = lanes<double>;
  typename VectorOf<std::int32_t, half>::type integers;
  std::memcpy(&integers, reinterpret_cast<const char*>(&values) + part * sizeof integers, sizeof integers);
  return __builtin_convertvector(integers, Doubles);
}

/// The lanes that have a bit in a mask, moved to the front; what comes after them is of no use.
inline Doubles compress(Doubles value, unsigned mask) {
#if defined(__AVX2__)
  static constexpr auto order = [] {
    std::array<std::array<std::int32_t, 8>, 16> out{};
    for (unsigned one = 0; one < 16; ++one) {
      for (int lane = 0, n = 0; lane < 4; ++lane) {
        if (one >> lane & 1) {
          out[one][n++] = 2 * lane;
          out[one][n++] = 2 * lane + 1;
        }
      }
    }
    return out;
  }();
  using Order = Vector<std::int32_t>;
  return reinterpret_cast<Doubles>(
      __builtin_ia32_permvarsf256(reinterpret_cast<Floats>(value), load<Order>(order[mask].data())));
#else
  return mask == 2 ? __builtin_shufflevector(value, value, 1, 1) : value;
#endif
}

/// Write x, y, z, x, y, z … of a register of points.
inline void interleave(Doubles x, Doubles y, Doubles z, double* to) {
#if defined(__AVX__)
  const Doubles xy = __builtin_shufflevector(x, y, 0, 4, 2, 6);
  const Doubles zx = __builtin_shufflevector(z, x, 0, 5, 2, 7);
  const Doubles yz = __builtin_shufflevector(y, z, 1, 5, 3, 7);
  store(to, __builtin_shufflevector(xy, zx, 0, 1, 4, 5));
  store(to + 4, __builtin_shufflevector(yz, xy, 0, 1, 6, 7));
  store(to + 8, __builtin_shufflevector(zx, yz, 2, 3, 6, 7));
#else
  store(to, __builtin_shufflevector(x, y, 0, 2));
  store(to + 2, __builtin_shufflevector(z, x, 0, 3));
  store(to + 4, __builtin_shufflevector(y, z, 1, 3));
#endif
}

}  // namespace lidarcfg::simd
