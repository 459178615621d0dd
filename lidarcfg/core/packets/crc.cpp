#include "packets/crc.h"

namespace lidarcfg::packets {
namespace {

constexpr std::uint32_t polynomial = 0x04C11DB7;
constexpr int slices = 8;

using Tables = std::array<std::array<std::uint32_t, 256>, slices>;

/// The effect on the CRC of a byte at each distance from the end of eight.
constexpr Tables tables = [] {
  Tables out{};
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    std::uint32_t value = byte << 24;
    for (auto& table : out) {
      for (int bit = 0; bit < 8; ++bit) {
        value = value << 1 ^ (value >> 31 ? polynomial : 0);
      }
      table[byte] = value;
    }
  }
  return out;
}();

constexpr std::uint32_t castagnoli = 0x82F63B78;  // its bits reversed

/// The same for CRC-32C.
constexpr Tables castagnoli_tables = [] {
  Tables out{};
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    std::uint32_t value = byte;
    for (auto& table : out) {
      for (int bit = 0; bit < 8; ++bit) {
        value = value >> 1 ^ (value & 1 ? castagnoli : 0);
      }
      table[byte] = value;
    }
  }
  return out;
}();

std::uint32_t crc32c_on(std::uint32_t value, View<const std::uint8_t> bytes) {
  const Tables& tables = castagnoli_tables;
  std::size_t n = 0;
  for (; n + slices <= bytes.size(); n += slices) {
    const std::uint8_t* at = &bytes[n];
    value = tables[7][(value & 255) ^ at[0]] ^ tables[6][(value >> 8 & 255) ^ at[1]] ^
            tables[5][(value >> 16 & 255) ^ at[2]] ^ tables[4][value >> 24 ^ at[3]] ^ tables[3][at[4]] ^
            tables[2][at[5]] ^ tables[1][at[6]] ^ tables[0][at[7]];
  }
  for (; n < bytes.size(); ++n) {
    value = value >> 8 ^ tables[0][(value & 255) ^ bytes[n]];
  }
  return value;
}

}  // namespace

std::uint32_t crc32_mpeg2(View<const std::uint8_t> bytes) {
  std::uint32_t value = ~std::uint32_t{0};
  std::size_t n = 0;
  for (; n + slices <= bytes.size(); n += slices) {
    const std::uint8_t* at = &bytes[n];
    value = tables[7][value >> 24 ^ at[0]] ^ tables[6][(value >> 16 & 255) ^ at[1]] ^
            tables[5][(value >> 8 & 255) ^ at[2]] ^ tables[4][(value & 255) ^ at[3]] ^ tables[3][at[4]] ^
            tables[2][at[5]] ^ tables[1][at[6]] ^ tables[0][at[7]];
  }
  for (; n < bytes.size(); ++n) {
    value = value << 8 ^ tables[0][value >> 24 ^ bytes[n]];
  }
  return value;
}

std::uint32_t crc32c(View<const std::uint8_t> first, View<const std::uint8_t> second) {
  return ~crc32c_on(crc32c_on(~std::uint32_t{0}, first), second);
}

}  // namespace lidarcfg::packets
