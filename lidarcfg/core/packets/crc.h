/// CRCs of 32 bits, from all ones.
#pragma once

#include "views.h"

namespace lidarcfg::packets {

/// CRC-32/MPEG-2: polynomial 0x04C11DB7, most significant bit first, nothing inverted at the end.
std::uint32_t crc32_mpeg2(View<const std::uint8_t> bytes);

/// CRC-32C of two parts: Castagnoli's polynomial 0x1EDC6F41, least significant bit first, inverted at the end.
std::uint32_t crc32c(View<const std::uint8_t> first, View<const std::uint8_t> second);

}  // namespace lidarcfg::packets
