/// Views of memory that somebody else owns, most often numpy. Indices are signed; asserts check them in debug builds.
#pragma once

#include <array>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <span>

namespace lidarcfg {

using Index = std::ptrdiff_t;
using Vec3 = std::array<double, 3>;

/// A column of values.
template <class T>
using View = std::span<T>;

/// A table of rows of equal length.
template <class T>
class Rows {
 public:
  using Element = T;

  Rows() = default;
  Rows(T* data, Index rows, Index columns) : data_(data), rows_(rows), columns_(columns) {}

  T* data() const { return data_; }
  Index rows() const { return rows_; }
  Index columns() const { return columns_; }
  Index size() const { return rows_ * columns_; }

  View<T> operator[](Index row) const {
    assert(0 <= row && row < rows_);
    return {data_ + row * columns_, static_cast<std::size_t>(columns_)};
  }

  T& operator()(Index row, Index column) const {
    assert(0 <= row && row < rows_ && 0 <= column && column < columns_);
    return data_[row * columns_ + column];
  }

  operator Rows<const T>() const { return {data_, rows_, columns_}; }

 private:
  T* data_ = nullptr;
  Index rows_ = 0;
  Index columns_ = 0;
};

/// Tables of equal size, one after another.
template <class T>
class Tables {
 public:
  using Element = T;

  Tables() = default;
  Tables(T* data, Index tables, Index rows, Index columns)
      : data_(data), tables_(tables), rows_(rows), columns_(columns) {}

  T* data() const { return data_; }
  Index tables() const { return tables_; }
  Index rows() const { return rows_; }
  Index columns() const { return columns_; }
  Index size() const { return tables_ * rows_ * columns_; }

  Rows<T> operator[](Index table) const {
    assert(0 <= table && table < tables_);
    return {data_ + table * rows_ * columns_, rows_, columns_};
  }

  T& operator()(Index table, Index row, Index column) const {
    assert(0 <= table && table < tables_ && 0 <= row && row < rows_ && 0 <= column && column < columns_);
    return data_[(table * rows_ + row) * columns_ + column];
  }

  operator Tables<const T>() const { return {data_, tables_, rows_, columns_}; }

 private:
  T* data_ = nullptr;
  Index tables_ = 0;
  Index rows_ = 0;
  Index columns_ = 0;
};

}  // namespace lidarcfg
