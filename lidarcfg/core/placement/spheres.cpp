#include "placement/spheres.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

namespace lidarcfg::placement {
namespace {

using Labels = Tables<const std::int32_t>;

constexpr int row_size = 64;
constexpr int recent_count = 8;
constexpr std::array<Index, 2> strides{8, 1};  // some of the nodes first, so that there is a good sphere to beat
constexpr Index step = 2147483647;  // through the columns, which are fewer: a prime, so that all are tried, spread out

/// The bits of a word below one of its cuboids.
constexpr Word below(Index cuboid) { return (Word{1} << (cuboid % row_size)) - 1; }

/// Half cuboids from a node of this parity to the nearest side of a cuboid that is so many on.
Index apart(Index cuboids, Index parity) {
  if (cuboids > 0) {
    return 2 * cuboids - parity;
  }
  return cuboids < 0 ? -2 * cuboids - 2 + parity : 0;
}

/// Of a length in half cuboids.
double square_of(Index count, double half) {
  const double length = static_cast<double>(count) * half;
  return length * length;
}

/// The most half cuboids along z that, with the square of what is across, are within a square; −1 where none are.
Index chord(double square, double level, double half) {
  if (level > square) {
    return -1;
  }
  Index count = static_cast<Index>(std::sqrt(square - level) / half);
  while (level + square_of(count + 1, half) <= square) {
    ++count;
  }
  while (level + square_of(count, half) > square) {
    --count;
  }
  return count;
}

/// The cuboids of a run along one axis, the nearest first on either side of a node's.
template <class Visit>
void outwards(Index count, Visit visit) {
  for (const bool lower : {false, true}) {
    for (Index n = 0; n <= count; ++n) {
      if (!visit(lower ? -n - 1 : n)) {
        break;
      }
    }
  }
}

/// The squared distance of a node from the nearest cuboid that is not of its subspace.
double nearest_other(Labels label, const Vec3& half, const Node& node) {
  const auto [i, j, k] = node;
  const Index x = i / 2;
  const Index y = j / 2;
  const Index z = k / 2;
  const std::int32_t own = label(x, y, z);
  double nearest = std::numeric_limits<double>::infinity();
  outwards(label.tables(), [&](Index on_x) {
    const double across = square_of(apart(on_x, i % 2), half[0]);
    if (across >= nearest) {
      return false;
    }
    outwards(label.rows(), [&](Index on_y) {
      const double level = across + square_of(apart(on_y, j % 2), half[1]);
      if (level >= nearest) {
        return false;
      }
      const bool outside = x + on_x < 0 || x + on_x >= label.tables() || y + on_y < 0 || y + on_y >= label.rows();
      outwards(label.columns(), [&](Index on_z) {
        const double square = level + square_of(apart(on_z, k % 2), half[2]);
        if (square >= nearest) {
          return false;
        }
        if (outside || z + on_z < 0 || z + on_z >= label.columns() || label(x + on_x, y + on_y, z + on_z) != own) {
          nearest = square;
          return false;
        }
        return true;
      });
      return true;
    });
    return true;
  });
  return nearest;
}

/// Searches all nodes, row by row along z.
///
/// A node has no larger sphere than the best so far if a cuboid that is not of its subspace is near enough, and a
/// column of cuboids that shows it for one node mostly shows it for its neighbours. Along z each test passes over all
/// nodes that its cuboid is near enough to.
class Search {
 public:
  Search(Labels label, Tables<const Word> ends, const Vec3& half) : label_(label), ends_(ends), half_(half) {}

  Sphere run(Index number, const Node& low, const Node& high) {
    for (const Index stride : strides) {
      best_.square = std::max(std::nextafter(best_.square, -1.0), 0.0);  // the first of equals comes last
      reach_ = chord(best_.square, 0.0, half_[2]);
      for (Index i = 2 * low[0] + 1; i < 2 * high[0]; i += stride) {
        if (square_of(std::min(i - 2 * low[0], 2 * high[0] - i), half_[0]) <= best_.square) {
          continue;
        }
        for (Index j = 2 * low[1] + 1; j < 2 * high[1]; j += stride) {
          if (square_of(std::min(j - 2 * low[1], 2 * high[1] - j), half_[1]) > best_.square) {
            search_row(number, i, j);
          }
        }
      }
    }
    return best_;
  }

 private:
  /// A column of cuboids along z as a node sees it: cuboids on along x and y, and the half cuboids along z in reach.
  struct Column {
    Index x = 0;
    Index y = 0;
    Index chord = 0;
  };

  /// Raise the best to the largest sphere around a node of a row along z.
  void search_row(Index number, Index i, Index j) {
    const View<const std::int32_t> labels = label_[i / 2][j / 2];
    const View<const Word> ends = ends_[i / 2][j / 2];
    Index first = 0;
    while (first < label_.columns()) {
      Index word = first / row_size;
      Word bits = ends[word] & ~below(first);
      while (bits == 0) {
        bits = ends[++word];
      }
      const Index last = word * row_size + std::countr_zero(bits);
      const std::int32_t own = labels[first];
      if (own >= 0 && (number < 0 || own == number)) {
        search_run({i, j, 2 * first + reach_ + 1}, first, last);
      }
      first = last + 1;
    }
  }

  /// The same from a node on, of a run of cuboids of its subspace from first to last.
  void search_run(Node node, Index first, Index last) {
    Index& k = node[2];
    while (k <= 2 * last + 1 - reach_) {
      Index onward = rule_out(node);
      if (onward == k) {
        best_ = {nearest_other(label_, half_, node), node};
        reach_ = chord(best_.square, 0.0, half_[2]);
        onward = std::max(k + 1, 2 * first + reach_ + 1);
      }
      k = onward;
    }
  }

  /// The first node of a row, from one on, that no test for that one rules out.
  Index rule_out(const Node& node) {
    const Index parity = 2 * (node[0] % 2) + node[1] % 2;
    std::array<Column, recent_count>& recent = recent_[parity];
    for (int n = 0; n < recent_count; ++n) {
      const Index onward = pass(node, recent[n]);
      if (onward > node[2]) {
        std::rotate(recent.begin(), recent.begin() + n, recent.begin() + n + 1);
        return onward;
      }
    }
    if (squares_[parity] != best_.square) {
      find_columns(parity);
    }
    const std::vector<Column>& columns = columns_[parity];
    const Index count = std::ssize(columns);
    Index at = 0;
    for (Index n = 0; n < count; ++n) {
      const Index onward = pass(node, columns[at]);
      if (onward > node[2]) {
        std::copy_backward(recent.begin(), recent.end() - 1, recent.end());
        recent[0] = columns[at];
        return onward;
      }
      at = (at + step) % count;
    }
    return node[2];
  }

  /// The first node of a row, from one on, that a column does not rule out; for all but the row's end that one in
  /// reach.
  Index pass(const Node& node, const Column& column) const {
    const Index x = node[0] / 2 + column.x;
    const Index y = node[1] / 2 + column.y;
    if (x < 0 || y < 0 || x >= label_.tables() || y >= label_.rows()) {
      return 2 * label_.columns() + 1;
    }
    const Index z = node[2] / 2;
    const Index parity = node[2] % 2;
    const std::int32_t own = label_(node[0] / 2, node[1] / 2, z);
    const Index low = z - (column.chord + 2 - parity) / 2;
    const Index high = z + (column.chord + parity) / 2;
    const Index found = highest_other(x, y, low, high, own);
    return found < 0 ? node[2] : 2 * found + 3 + column.chord;
  }

  /// The highest of a column's cuboids from low to high that is not of a subspace; −1 where all are.
  Index highest_other(Index x, Index y, Index low, Index high, std::int32_t own) const {
    // A column of before the last stride may reach one cuboid beyond the grid.
    if (high >= label_.columns() || label_(x, y, high) != own) {
      return high;
    }
    low = std::max<Index>(low, 0);
    for (Index word = high / row_size; word >= low / row_size; --word) {
      Word bits = ends_(x, y, word);
      if (word == high / row_size) {
        bits &= below(high);
      }
      if (word == low / row_size) {
        bits &= ~below(low);
      }
      if (bits != 0) {
        return word * row_size + std::bit_width(bits) - 1;
      }
    }
    return -1;
  }

  /// Find the columns around a node that the best sphere reaches.
  void find_columns(Index parity) {
    std::vector<Column>& columns = columns_[parity];
    columns.clear();
    const double radius = std::sqrt(best_.square);
    const Index far_x = static_cast<Index>(radius / half_[0]) / 2 + 2;
    const Index far_y = static_cast<Index>(radius / half_[1]) / 2 + 2;
    for (Index x = -far_x; x <= far_x; ++x) {
      const double across = square_of(apart(x, parity / 2), half_[0]);
      for (Index y = -far_y; y <= far_y; ++y) {
        const double level = across + square_of(apart(y, parity % 2), half_[1]);
        const Index reach = chord(best_.square, level, half_[2]);
        if (reach >= 0) {
          columns.push_back({x, y, reach});
        }
      }
    }
    squares_[parity] = best_.square;
  }

  Labels label_;
  Tables<const Word> ends_;
  Vec3 half_;
  Sphere best_;
  Index reach_ = 0;                                           // half cuboids in the best radius along z
  std::array<std::vector<Column>, 4> columns_;                // by parity of a node, in reach
  std::array<double, 4> squares_{-1.0, -1.0, -1.0, -1.0};     // that they are for
  std::array<std::array<Column, recent_count>, 4> recent_{};  // those that ruled out a node lately
};

}  // namespace

void find_ends(Labels label, Tables<Word> ends) {
  for (Index x = 0; x < label.tables(); ++x) {
    for (Index y = 0; y < label.rows(); ++y) {
      const View<const std::int32_t> column = label[x][y];
      const View<Word> words = ends[x][y];
      std::fill(words.begin(), words.end(), Word{0});
      for (Index z = 0; z < label.columns(); ++z) {
        const bool end = z + 1 == label.columns() || column[z] != column[z + 1];
        words[z / row_size] |= Word{end} << (z % row_size);
      }
    }
  }
}

Sphere largest_sphere(Labels label, Tables<const Word> ends, const Vec3& half, Index number, const Node& low,
                      const Node& high) {
  return Search(label, ends, half).run(number, low, high);
}

double clearance(Labels label, const Vec3& half, const Node& node) {
  const Node end{2 * label.tables(), 2 * label.rows(), 2 * label.columns()};
  if (node[0] >= end[0] || node[1] >= end[1] || node[2] >= end[2] || label(node[0] / 2, node[1] / 2, node[2] / 2) < 0) {
    return 0.0;
  }
  return nearest_other(label, half, node);
}

}  // namespace lidarcfg::placement
