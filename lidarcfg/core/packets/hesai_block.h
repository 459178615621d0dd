/// A block of a Hesai's packet: its returns, and of which kind each is.
#pragma once

#include <array>
#include <cstring>

#include "packets/hesai.h"

namespace lidarcfg::packets::hesai {

constexpr Index lasers_max = 256;
constexpr int no_return = 255;  // of a kind

inline int word(const std::uint8_t* bytes) { return bytes[0] | bytes[1] << 8; }

/// A block's returns, and of which kind each is.
struct Block {
  std::array<int, lasers_max> distance;
  std::array<int, lasers_max> reflectivity;
  std::array<int, lasers_max> kind;

  void read(const std::uint8_t* at, const Layout& layout, int least) {
    switch (layout.return_bytes) {
      case 3:
        return read<3>(at, layout.lasers, least);
      case 4:
        return read<4>(at, layout.lasers, least);
      case 5:
        return read<5>(at, layout.lasers, least);
      default:
        return read<6>(at, layout.lasers, least);
    }
  }

  /// All are returns of one kind.
  void set(Index lasers, int single) {
    for (Index k = 0; k < lasers; ++k) {
      kind[k] = distance[k] != 0 ? single : no_return;
    }
  }

 private:
  template <Index return_bytes>
  void read(const std::uint8_t* at, Index lasers, int least) {
    for (Index k = 0; k < lasers; ++k) {
      std::uint32_t bytes;
      std::memcpy(&bytes, at + k * return_bytes, sizeof bytes);
      const int units = bytes & 65535;
      distance[k] = units < least ? 0 : units;
      reflectivity[k] = bytes >> 16 & 255;
    }
  }
};

/// Tell the kinds of a block's returns by those of its neighbour: a nearer and a farther one's are given.
///
/// An identical pair is one return, the strongest, and stands in the even block. Which of two is the last return, the
/// distance decides and not the block, as early firmware has them the other way round.
inline void pair(Block& block, const Block& other, Index lasers, bool odd, int near, int far) {
  const bool ranked = near != by_block;  // else the strongest stands in the even block
  const int nearer_kind = ranked ? near : odd ? second_strongest : strongest;
  const int farther_kind = far != by_block ? far : odd ? second_strongest : strongest;
  const int same_kind = odd ? no_return : strongest;
  for (Index k = 0; k < lasers; ++k) {
    const int distance = block.distance[k];
    const int other_distance = other.distance[k];
    const bool weaker = block.reflectivity[k] < other.reflectivity[k];
    const bool same = (distance == other_distance) & (block.reflectivity[k] == other.reflectivity[k]);
    const bool nearer = (distance < other_distance) | ((distance == other_distance) & odd);
    int kind = nearer ? nearer_kind : farther_kind;
    kind = (kind == strongest) & weaker & ranked ? second_strongest : kind;
    kind = same ? same_kind : kind;
    kind = other_distance == 0 ? strongest : kind;
    block.kind[k] = distance == 0 ? no_return : kind;
  }
}

}  // namespace lidarcfg::packets::hesai
