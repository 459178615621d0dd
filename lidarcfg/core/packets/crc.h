/// CRC-32/MPEG-2: polynomial 0x04C11DB7, most significant bit first, from all ones, nothing inverted at the end.
#pragma once

#include "views.h"

namespace lidarcfg::packets {

std::uint32_t crc32_mpeg2(View<const std::uint8_t> bytes);

}  // namespace lidarcfg::packets
