/// Collects rays into packets of those that face the same way.
#pragma once

#include <algorithm>
#include <numeric>
#include <utility>
#include <vector>

#include "world/packet.h"

namespace lidarcfg::world {

/// Loads a packet as soon as it has its rays, and calls `take(packet, numbers)`; numbers are what the rays were given.
///
/// Who takes it says how far the rays may go, has them hit something and reads what they hit.
class Packer {
 public:
  template <class Take>
  void add(const Vec3& origin, const Vec3& direction, Index number, Take&& take) {
    const int face = facing(direction[0], direction[1], direction[2]);
    Queue& queue = queues_[face];
    for (int axis = 0; axis < 3; ++axis) {
      queue.origins[axis][queue.count] = origin[axis];
      queue.directions[axis][queue.count] = direction[axis];
    }
    queue.numbers[queue.count] = number;
    waiting_ |= 1u << face;
    if (++queue.count == packet_size) {
      flush(face, take);
    }
  }

  /// Add rays `first` to `first` + count of (3, N), which face the same way; their numbers are those of their columns.
  template <class Take>
  void add(Rows<const double> origins, Rows<const double> directions, Index first, Index count, int face, Take&& take) {
    Queue& queue = queues_[face];
    for (const Index end = first + count; first < end;) {
      const Index some = std::min<Index>(end - first, packet_size - queue.count);
      for (int axis = 0; axis < 3; ++axis) {
        std::copy_n(origins[axis].data() + first, some, queue.origins[axis] + queue.count);
        std::copy_n(directions[axis].data() + first, some, queue.directions[axis] + queue.count);
      }
      std::iota(queue.numbers + queue.count, queue.numbers + queue.count + some, first);
      waiting_ |= 1u << face;
      queue.count += static_cast<int>(some);
      first += some;
      if (queue.count == packet_size) {
        flush(face, take);
      }
    }
  }

  /// Hand on all packets that are not full.
  template <class Take>
  void finish(Take&& take) {
    for (int face = 0; face < faces; ++face) {
      if (waiting_ >> face & 1) {
        flush(face, take);
      }
    }
  }

 private:
  struct Queue {
    double origins[3][packet_size];
    double directions[3][packet_size];
    Index numbers[packet_size];
    int count = 0;
  };

  template <class Take>
  void flush(int face, Take& take) {
    Queue& queue = queues_[face];
    packet_.load({queue.origins[0], 3, packet_size}, {queue.directions[0], 3, packet_size}, 0, queue.count, face);
    queue.count = 0;
    waiting_ &= ~(1u << face);
    take(packet_, View<const Index>(queue.numbers, packet_.count()));
  }

  Packet packet_;
  std::vector<Queue> queues_ = std::vector<Queue>(faces);
  unsigned waiting_ = 0;  // faces, as bits
};

}  // namespace lidarcfg::world
