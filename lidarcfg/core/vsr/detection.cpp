#include "vsr/detection.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "maths.h"
#include "simd.h"

namespace lidarcfg::vsr {
namespace {

using Labels = Tables<const std::int32_t>;
using Word = std::uint64_t;
using Box = std::array<double, 4>;

constexpr int row_size = 64;
constexpr Word all_bits = ~Word{0};

constexpr Word bit(Index place) { return Word{1} << (place % row_size); }

/// The bits of so many places, or of all of a word.
constexpr Word below(Index count) { return count < row_size ? bit(count) - 1 : all_bits; }

/// A word that begins with a bit of several; one more word follows them.
Word from(const std::vector<Word>& words, Index first) {
  const Index word = first / row_size;
  const Index shift = first % row_size;
  return shift == 0 ? words[word] : words[word] >> shift | words[word + 1] << (row_size - shift);
}

/// Write a bit for each pair of labels: what a predicate of both, or of vectors of both, says.
template <class Predicate>
void compare(const std::int32_t* labels, const std::int32_t* others, Index count, Word* out, Predicate holds) {
  using Vector = simd::Vector<std::int32_t>;
  std::fill_n(out, count / row_size + 1, Word{0});
  Index n = 0;
  for (; n + simd::lanes<std::int32_t> <= count; n += simd::lanes<std::int32_t>) {
    const Vector found = holds(simd::load<Vector>(labels + n), simd::load<Vector>(others + n));
    out[n / row_size] |= Word{simd::bits(found)} << (n % row_size);
  }
  for (; n < count; ++n) {
    out[n / row_size] |= Word{holds(labels[n], others[n])} << (n % row_size);
  }
}

/// What is the same of 64 boxes above one another, by place of a box along z.
struct Places {
  Word free = 0;   // without an excluded cuboid
  Word whole = 0;  // in one subspace
  Word like = 0;   // whose first cuboid is of the same subspace as the next row's, or the next slice's
};

/// The rows, or slices, of a box together; `like` is not set.
template <class At>
Places join(Index first, Index count, At at) {
  Places out{all_bits, all_bits, 0};
  for (Index n = first; n < first + count; ++n) {
    const Places& one = at(n);
    out.free &= one.free;
    out.whole &= one.whole;
    if (n + 1 < first + count) {
      out.whole &= one.like;
    }
  }
  return out;
}

/// Counts subspaces, up to some number.
class Distinct {
 public:
  explicit Distinct(Index most) : seen_(most) {}

  void clear() { count_ = 0; }
  Index count() const { return count_; }
  bool full() const { return count_ == std::ssize(seen_); }

  /// Whether a label is another one than all so far. It is counted, unless there is no room for it.
  bool add(std::int32_t label) {
    if (std::find(seen_.begin(), seen_.begin() + count_, label) != seen_.begin() + count_) {
      return false;
    }
    if (!full()) {
      seen_[count_++] = label;
    }
    return true;
  }

 private:
  std::vector<std::int32_t> seen_;
  Index count_ = 0;
};

/// Places of a box of whole cuboids.
///
/// A box lies in one subspace if each of its upright rows does, and each row's first cuboid is of the subspace of the
/// next row's. So 64 boxes above one another are compared at once, bit by bit.
class Positions {
 public:
  Positions(Labels labels, const std::array<Index, 3>& size, Index threshold, Index layers, View<bool> held)
      : labels_(labels),
        size_(size),
        threshold_(std::min(threshold, size[0] * size[1] * size[2])),  // a box cannot touch more
        heights_(std::min(labels.columns() - size[2] + 1, layers)),
        words_((heights_ + row_size - 1) / row_size),
        held_(held),
        rows_(labels.rows() * words_),
        slices_(labels.tables() * (labels.rows() - size[1] + 1) * words_),
        free_(labels.columns() / row_size + 2),
        same_(free_.size()),
        like_(free_.size()),
        seen_(threshold_) {}

  PlaceCounts count(Index misses) {
    PlaceCounts out;
    out.columns = labels_.tables() - size_[0] + 1;
    out.rows = labels_.rows() - size_[1] + 1;
    out.places.resize(out.columns * out.rows);
    out.detected.resize(out.columns * out.rows);
    Index written = 0;
    Index missed = 0;
    for (Index i = 0; i < out.columns; ++i) {
      for (; written < i + size_[0]; ++written) {
        write_slice(written);
      }
      for (Index j = 0; j < out.rows; ++j) {
        std::int64_t& places = out.places[i * out.rows + j];
        std::int64_t& detected = out.detected[i * out.rows + j];
        for (Index word = 0; word < words_; ++word) {
          const Places box = join(i, size_[0], [&](Index n) -> const Places& { return slice(n, j, word); });
          places += std::popcount(box.free);
          detected += std::popcount(find_detected(box, i, j, word));
          note_held(box, i, j, word);
        }
        missed += places - detected;
        if (missed >= misses) {
          return out;
        }
      }
    }
    return out;
  }

 private:
  Places& row(Index j, Index word) { return rows_[j * words_ + word]; }
  Places& slice(Index i, Index j, Index word) {
    return slices_[(i * (labels_.rows() - size_[1] + 1) + j) * words_ + word];
  }

  /// Write the upright rows of cuboids at one x.
  void write_rows(Index i) {
    const Index count = labels_.columns();
    for (Index j = 0; j < labels_.rows(); ++j) {
      const std::int32_t* column = labels_[i][j].data();
      compare(column, column, count, free_.data(), [](auto label, auto) { return label >= 0; });
      compare(column, column + 1, count - 1, same_.data(), [](auto label, auto next) { return label == next; });
      for (Index word = 0; word < words_; ++word) {
        Places& out = row(j, word);
        out.free = below(heights_ - word * row_size);
        for (Index n = 0; n < size_[2]; ++n) {
          out.free &= from(free_, word * row_size + n);
        }
        out.whole = out.free;
        for (Index n = 0; n + 1 < size_[2]; ++n) {
          out.whole &= from(same_, word * row_size + n);
        }
      }
      if (j + 1 < labels_.rows()) {
        write_like(column, labels_[i][j + 1].data(), &row(j, 0));
      }
    }
  }

  void write_slice(Index i) {
    write_rows(i);
    for (Index j = 0; j + size_[1] <= labels_.rows(); ++j) {
      for (Index word = 0; word < words_; ++word) {
        slice(i, j, word) = join(j, size_[1], [&](Index n) -> const Places& { return row(n, word); });
      }
      if (i + 1 < labels_.tables()) {
        write_like(labels_[i][j].data(), labels_[i + 1][j].data(), &slice(i, j, 0));
      }
    }
  }

  void write_like(const std::int32_t* column, const std::int32_t* next, Places* out) {
    compare(column, next, heights_, like_.data(), [](auto label, auto other) { return label == other; });
    for (Index word = 0; word < words_; ++word) {
      out[word].like = like_[word];
    }
  }

  Word find_detected(const Places& box, Index i, Index j, Index word) {
    Word found = threshold_ > 0 ? box.free & ~box.whole : box.free;
    if (threshold_ > 1) {
      for (Word left = found; left != 0; left &= left - 1) {
        const Index k = word * row_size + std::countr_zero(left);
        if (!touches_more(i, j, k)) {
          found ^= bit(k);
        }
      }
    }
    return found;
  }

  /// Whether a box touches more subspaces than the threshold.
  bool touches_more(Index i, Index j, Index k) {
    seen_.clear();
    std::int32_t last = -1;
    for (Index a = i; a < i + size_[0]; ++a) {
      for (Index b = j; b < j + size_[1]; ++b) {
        for (const std::int32_t label : labels_[a][b].subspan(k, size_[2])) {
          if (label != last) {
            last = label;
            const bool full = seen_.full();
            if (seen_.add(label) && full) {
              return true;
            }
          }
        }
      }
    }
    return false;
  }

  void note_held(const Places& box, Index i, Index j, Index word) {
    if (held_.empty()) {
      return;
    }
    for (Word left = box.whole & box.free; left != 0; left &= left - 1) {
      held_[labels_(i, j, word * row_size + std::countr_zero(left))] = true;
    }
  }

  Labels labels_;
  std::array<Index, 3> size_;
  Index threshold_;
  Index heights_;  // places along z
  Index words_;
  View<bool> held_;
  std::vector<Places> rows_;    // (ny, words) at one x
  std::vector<Places> slices_;  // (nx, places along y, words)
  std::vector<Word> free_;      // of a column, the cuboids that are not excluded
  std::vector<Word> same_;      // those of the same subspace as the next one
  std::vector<Word> like_;      // those of the same subspace as the other column's
  Distinct seen_;
};

/// A number towards 0, cut to −1 … most.
Index truncate(double value, Index most) {
  return value > -1.0 ? static_cast<Index>(std::min(value, static_cast<double>(most))) : -1;
}

/// Cuboids along one axis that may lie within a length.
struct Run {
  Index begin, end;

  Run(double low, double high, Index count)
      : begin(std::max<Index>(truncate(low, count), 0)), end(std::min(truncate(high, count) + 1, count)) {}
};

}  // namespace

PlaceCounts detected_positions(Labels labels, const std::array<Index, 3>& size, Index threshold, Index layers,
                               Index misses, View<bool> held) {
  return Positions(labels, size, threshold, layers, held).count(misses);
}

BoxCounts detected_boxes(Labels labels, const Vec3& low, const Vec3& edge, View<const Box> boxes, const Vec3& size,
                         Index threshold) {
  Distinct seen(std::min(threshold, labels.size()) + 1);
  BoxCounts out{};
  for (const Box& box : boxes) {
    const double x = box[0] - low[0];
    const double y = box[1] - low[1];
    const double bottom = box[2] - low[2];
    const auto [c, s] = cos_sin(box[3]);
    const double reach_x = (size[0] * std::abs(c) + size[1] * std::abs(s)) / 2;
    const double reach_y = (size[0] * std::abs(s) + size[1] * std::abs(c)) / 2;
    const double along = (edge[0] * std::abs(c) + edge[1] * std::abs(s)) / 2;
    const double across = (edge[0] * std::abs(s) + edge[1] * std::abs(c)) / 2;
    const Run run_x((x - reach_x) / edge[0], (x + reach_x) / edge[0], labels.tables());
    const Run run_y((y - reach_y) / edge[1], (y + reach_y) / edge[1], labels.rows());
    const Index low_k = std::max<Index>(truncate(std::floor(bottom / edge[2] + 1e-9), labels.columns()), 0);
    const Index high_k = truncate(std::ceil((bottom + size[2]) / edge[2] - 1e-9), labels.columns());
    bool free = true;
    seen.clear();
    for (Index i = run_x.begin; i < run_x.end; ++i) {
      for (Index j = run_y.begin; j < run_y.end; ++j) {
        const double dx = (i + 0.5) * edge[0] - x;
        const double dy = (j + 0.5) * edge[1] - y;
        if (std::abs(dx * c + dy * s) >= size[0] / 2 + along || std::abs(dy * c - dx * s) >= size[1] / 2 + across) {
          continue;
        }
        for (Index k = low_k; k < high_k; ++k) {
          const std::int32_t label = labels(i, j, k);
          free = free && label >= 0;
          if (free && !seen.full()) {
            seen.add(label);
          }
        }
      }
    }
    out.free += free;
    out.detected += free && seen.full();
  }
  return out;
}

}  // namespace lidarcfg::vsr
