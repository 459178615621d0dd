/// From Python's arguments to the views that kernels take, and from their results to Python's.
///
/// An array of another dtype, order or number of dimensions, or a read-only one that is to be written, is refused by a
/// ValueError that names it. Nothing is converted: what a kernel wrote to a copy would be lost. The structs that
/// kernels take come from NamedTuples, field by field, as `Fields` of each says.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <concepts>
#include <deque>
#include <stdexcept>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "bind/classes.h"
#include "views.h"

namespace lidarcfg::bind {

namespace nb = nanobind;

/// Raises ValueError unless a condition holds, which the message states: "x: one for each y".
inline void require(bool holds, const char* message) {
  if (!holds) {
    throw std::invalid_argument(message);
  }
}

/// The name of an argument, or of a part of one, for messages.
struct Name {
  const char* own;
  const Name* whole = nullptr;
  Index number = -1;  // of an item of a sequence

  std::string text() const {
    if (number >= 0) {
      return whole->text() + "[" + std::to_string(number) + "]";
    }
    return whole ? whole->text() + "." + own : own;
  }

  [[noreturn]] void refuse(const std::string& why) const { throw std::invalid_argument(text() + ": " + why); }
};

/// The name of an object's type.
inline std::string kind_of(nb::handle object) { return nb::type_name(object.type()).c_str(); }

/// The memory that the arguments of a call look at; held until it returns.
class Held {
 public:
  Held() = default;
  Held(const Held&) = delete;
  Held& operator=(const Held&) = delete;
  ~Held() {
    for (Py_buffer& buffer : buffers_) {
      PyBuffer_Release(&buffer);
    }
  }

  const Py_buffer& buffer(nb::handle object, const Name& name) {
    Py_buffer found;
    if (PyObject_GetBuffer(object.ptr(), &found, PyBUF_FORMAT | PyBUF_STRIDES) != 0) {
      PyErr_Clear();
      name.refuse("not an array, but " + kind_of(object));
    }
    return buffers_.emplace_back(found);
  }

  /// A value that a view looks at, such as the items of a sequence.
  void keep(nb::object object) { objects_.push_back(std::move(object)); }

 private:
  std::deque<Py_buffer> buffers_;
  std::vector<nb::object> objects_;
};

/// How numpy calls a type of elements, and what it has instead; the kinds of the buffer protocol's formats.
template <class T>
constexpr const char* dtype_name() {
  using V = std::remove_const_t<T>;
  if constexpr (std::same_as<V, bool>) {
    return "bool";
  } else if constexpr (std::floating_point<V>) {
    return sizeof(V) == 8 ? "float64" : "float32";
  } else if constexpr (std::is_signed_v<V>) {
    return sizeof(V) == 8 ? "int64" : sizeof(V) == 4 ? "int32" : sizeof(V) == 2 ? "int16" : "int8";
  } else {
    return sizeof(V) == 8 ? "uint64" : sizeof(V) == 4 ? "uint32" : sizeof(V) == 2 ? "uint16" : "uint8";
  }
}

template <class T>
bool is_dtype(const Py_buffer& buffer) {
  using V = std::remove_const_t<T>;
  const std::string format = buffer.format ? buffer.format : "B";
  if (format.size() != 1 || buffer.itemsize != static_cast<Py_ssize_t>(sizeof(V))) {
    return false;
  }
  if constexpr (std::same_as<V, bool>) {
    return format == "?";
  } else if constexpr (std::floating_point<V>) {
    return format == "d" || format == "f";
  } else if constexpr (std::is_signed_v<V>) {
    return std::string("bhilq").find(format) != std::string::npos;
  } else {
    return std::string("BHILQ").find(format) != std::string::npos;
  }
}

/// The elements of values that lie in several columns of an array: three of a Vec3, one of a double.
template <class T>
struct Columns {
  using Element = T;
  static constexpr Index count = 0;  // no dimension of its own
};
template <class E, std::size_t N>
struct Columns<std::array<E, N>> {
  using Element = E;
  static constexpr Index count = N;
};
template <class E, std::size_t N>
struct Columns<const std::array<E, N>> {
  using Element = const E;
  static constexpr Index count = N;
};

/// An array of `dimensions` of values; its lengths along them are written to `shape`.
template <class T>
T* array(nb::handle object, Held& held, const Name& name, int dimensions, Index* shape) {
  using E = typename Columns<T>::Element;
  constexpr Index columns = Columns<T>::count;
  const int all = dimensions + (columns > 0);
  const Py_buffer& buffer = held.buffer(object, name);
  if (!is_dtype<E>(buffer)) {
    name.refuse(std::string("another dtype than ") + dtype_name<E>());
  }
  if (buffer.ndim != all) {
    name.refuse(std::to_string(buffer.ndim) + " dimensions; allowed: " + std::to_string(all));
  }
  if (columns && buffer.shape[all - 1] != columns) {
    name.refuse(std::to_string(buffer.shape[all - 1]) + " columns; allowed: " + std::to_string(columns));
  }
  if (!std::is_const_v<E> && buffer.readonly) {
    name.refuse("read-only, but to be written");
  }
  if (reinterpret_cast<std::uintptr_t>(buffer.buf) % alignof(E) != 0) {
    name.refuse("not aligned in memory");
  }
  bool empty = false;
  for (int k = 0; k < buffer.ndim; ++k) {
    empty |= buffer.shape[k] == 0;
  }
  Py_ssize_t stride = buffer.itemsize;
  for (int k = buffer.ndim - 1; k >= 0; --k) {
    if (!empty && buffer.shape[k] > 1 && buffer.strides[k] != stride) {
      name.refuse("not contiguous, row by row");
    }
    stride *= buffer.shape[k];
  }
  for (int k = 0; k < dimensions; ++k) {
    shape[k] = buffer.shape[k];
  }
  return static_cast<T*>(buffer.buf);
}

/// The fields that a struct takes from a NamedTuple: `static constexpr auto members = fields(field("x", &Grid::x), …)`.
template <class T>
struct Fields;

template <class S, class M>
struct Field {
  const char* name;
  M S::* member;
};

template <class S, class M>
constexpr Field<S, M> field(const char* name, M S::* member) {
  return {name, member};
}

template <class... F>
constexpr std::tuple<F...> fields(F... all) {
  return {all...};
}

template <class T>
concept Described = requires { Fields<T>::members; };

/// From<T>::python(object, held, name) is the T that a Python object says.
template <class T>
struct From {  // an object of a class that is bound, by reference
  static_assert(is_bound<std::remove_const_t<T>>, "neither a class that is bound, nor what can be taken by value");

  static T& python(nb::handle object, Held& held, const Name& name) {
    std::remove_const_t<T>* found = nullptr;
    if (!nb::try_cast(object, found) || !found) {
      name.refuse("of type " + kind_of(object) +
                  "; allowed: " + nb::type_name(nb::type<std::remove_const_t<T>>()).c_str());
    }
    held.keep(nb::borrow(object));
    return *found;
  }
};

template <>
struct From<nb::handle> {
  static nb::handle python(nb::handle object, Held&, const Name&) { return object; }
};

template <std::floating_point T>
struct From<T> {
  static T python(nb::handle object, Held&, const Name& name) {
    const double value = PyFloat_AsDouble(object.ptr());
    if (value == -1.0 && PyErr_Occurred()) {
      PyErr_Clear();
      name.refuse("not a number, but " + kind_of(object));
    }
    return static_cast<T>(value);
  }
};

template <std::integral T>
struct From<T> {
  static T python(nb::handle object, Held&, const Name& name) {
    const nb::object number = nb::steal(PyNumber_Index(object.ptr()));
    if (!number.is_valid()) {
      PyErr_Clear();
      name.refuse("not an integer, but " + kind_of(object));
    }
    T value;
    if (!nb::try_cast(number, value)) {
      name.refuse(std::string("out of the range of ") + dtype_name<T>());
    }
    return value;
  }
};

template <>
struct From<bool> {
  static bool python(nb::handle object, Held&, const Name& name) {
    const int value = PyObject_IsTrue(object.ptr());
    if (value < 0) {
      PyErr_Clear();
      name.refuse("not a truth value, but " + kind_of(object));
    }
    return value != 0;
  }
};

template <class T>
struct From<View<T>> {
  static View<T> python(nb::handle object, Held& held, const Name& name) {
    Index shape[1];
    T* data = array<T>(object, held, name, 1, shape);
    return {data, static_cast<std::size_t>(shape[0])};
  }
};

template <class T>
struct From<Rows<T>> {
  static Rows<T> python(nb::handle object, Held& held, const Name& name) {
    Index shape[2];
    T* data = array<T>(object, held, name, 2, shape);
    return {data, shape[0], shape[1]};
  }
};

template <class T>
struct From<Tables<T>> {
  static Tables<T> python(nb::handle object, Held& held, const Name& name) {
    Index shape[3];
    T* data = array<T>(object, held, name, 3, shape);
    return {data, shape[0], shape[1], shape[2]};
  }
};

template <class T>
struct From<Strided<T>> {  // of one or two dimensions
  static Strided<T> python(nb::handle object, Held& held, const Name& name) {
    const Py_buffer& buffer = held.buffer(object, name);
    if (!is_dtype<T>(buffer)) {
      name.refuse(std::string("another dtype than ") + dtype_name<T>());
    }
    if (buffer.ndim != 1 && buffer.ndim != 2) {
      name.refuse(std::to_string(buffer.ndim) + " dimensions; allowed: 1 and 2");
    }
    if (!std::is_const_v<T> && buffer.readonly) {
      name.refuse("read-only, but to be written");
    }
    const bool table = buffer.ndim == 2;
    return {static_cast<typename Strided<T>::Byte*>(buffer.buf), buffer.shape[0], buffer.strides[0],
            table ? buffer.shape[1] : 1, table ? buffer.strides[1] : 0};
  }
};

template <class T, std::size_t N>
struct From<std::array<T, N>> {  // from any sequence of N
  static std::array<T, N> python(nb::handle object, Held& held, const Name& name) {
    if (!PySequence_Check(object.ptr()) || nb::len(object) != N) {
      name.refuse("not a sequence of " + std::to_string(N));
    }
    std::array<T, N> out;
    for (std::size_t n = 0; n < N; ++n) {
      out[n] = From<T>::python(nb::object(object[n]), held, Name{"", &name, static_cast<Index>(n)});
    }
    return out;
  }
};

template <class T>
struct From<std::vector<T>> {  // from a list or a tuple
  static std::vector<T> python(nb::handle object, Held& held, const Name& name) {
    if (!nb::isinstance<nb::list>(object) && !nb::isinstance<nb::tuple>(object)) {
      name.refuse("not a list or tuple, but " + kind_of(object));
    }
    std::vector<T> out;
    for (nb::handle item : object) {
      held.keep(nb::borrow(item));
      const Name here{"", &name, static_cast<Index>(out.size())};
      if constexpr (std::is_pointer_v<T>) {
        out.push_back(&From<std::remove_pointer_t<T>>::python(item, held, here));
      } else {
        out.push_back(From<T>::python(item, held, here));
      }
    }
    return out;
  }
};

template <Described T>
struct From<T> {
  static T python(nb::handle object, Held& held, const Name& name) {
    T out{};
    std::apply([&](const auto&... each) { (take(out, each, object, held, name), ...); }, Fields<T>::members);
    return out;
  }

 private:
  template <class S, class M>
  static void take(T& out, const Field<S, M>& each, nb::handle object, Held& held, const Name& whole) {
    const Name name{each.name, &whole};
    const nb::object value = nb::steal(PyObject_GetAttrString(object.ptr(), each.name));
    if (!value.is_valid()) {
      PyErr_Clear();
      name.refuse("missing");
    }
    held.keep(value);
    if constexpr (std::is_pointer_v<M>) {
      out.*each.member = &From<std::remove_pointer_t<M>>::python(value, held, name);
    } else {
      out.*each.member = From<M>::python(value, held, name);
    }
  }
};

/// A new array, which Python owns from then on.
template <class T, std::size_t N = 1>
struct Array {
  std::vector<T> values;
  std::array<std::size_t, N> shape;
};

template <class T>
struct ToPython {
  static nb::object object(T&& value) { return nb::cast(std::move(value)); }
};

template <class T, std::size_t N>
struct ToPython<Array<T, N>> {
  static nb::object object(Array<T, N>&& array) {
    auto* values = new std::vector<T>(std::move(array.values));
    nb::capsule owner(values, [](void* pointer) noexcept { delete static_cast<std::vector<T>*>(pointer); });
    return nb::cast(nb::ndarray<nb::numpy, T>(values->data(), N, array.shape.data(), owner));
  }
};

template <class T>
struct ToPython<std::vector<T>> {
  static nb::object object(std::vector<T>&& values) {
    const std::size_t count = values.size();
    return ToPython<Array<T, 1>>::object({std::move(values), {count}});
  }
};

template <class T, std::size_t N>
struct ToPython<std::vector<std::array<T, N>>> {  // a row for each
  static nb::object object(std::vector<std::array<T, N>>&& rows) {
    auto* values = new std::vector<std::array<T, N>>(std::move(rows));
    nb::capsule owner(values,
                      [](void* pointer) noexcept { delete static_cast<std::vector<std::array<T, N>>*>(pointer); });
    const std::array<std::size_t, 2> shape{values->size(), N};
    return nb::cast(nb::ndarray<nb::numpy, T>(values->data(), 2, shape.data(), owner));
  }
};

template <class... T>
struct ToPython<std::tuple<T...>> {
  static nb::object object(std::tuple<T...>&& values) {
    return std::apply([](T&... each) -> nb::object { return nb::make_tuple(ToPython<T>::object(std::move(each))...); },
                      values);
  }
};

/// The types of the arguments and the result of a function or lambda.
template <class F>
struct Signature : Signature<decltype(&F::operator())> {};
template <class C, class R, class... A>
struct Signature<R (C::*)(A...) const> {
  using Result = R;
  using Arguments = std::tuple<A...>;
  static constexpr std::size_t count = sizeof...(A);
};
template <class R, class... A>
struct Signature<R (*)(A...)> {
  using Result = R;
  using Arguments = std::tuple<A...>;
  static constexpr std::size_t count = sizeof...(A);
};

template <class A>
decltype(auto) argument(nb::handle object, Held& held, const char* name) {
  using V = std::remove_cvref_t<A>;
  static_assert(!std::is_reference_v<A> || Described<V> || is_bound<V>, "what is not bound is taken by value");
  return From<std::conditional_t<is_bound<V>, std::remove_reference_t<A>, V>>::python(object, held, Name{name});
}

/// Call a kernel, without the GIL, with what Python objects say.
template <class F, std::size_t... I, class Objects>
auto call(const F& kernel, const char* const* names, const Objects& objects, std::index_sequence<I...>) {
  using S = Signature<F>;
  Held held;
  std::tuple<decltype(argument<std::tuple_element_t<I, typename S::Arguments>>(nb::handle(), held, ""))...> arguments{
      argument<std::tuple_element_t<I, typename S::Arguments>>(objects[I], held, names[I])...};
  nb::gil_scoped_release released;
  return std::apply(kernel, arguments);
}

template <std::size_t>
using Handle = nb::handle;

/// Bind a kernel to a module or, with the object first, to a class: its name, and those of its arguments.
template <class Scope, class F, class... Names>
void def(Scope& scope, const char* name, F kernel, const char* doc, Names... names) {
  using S = Signature<F>;
  constexpr bool method = !std::is_same_v<Scope, nb::module_>;
  static_assert(sizeof...(Names) + method == S::count, "a name for each argument");
  [&]<std::size_t... I>(std::index_sequence<I...> each) {
    std::array<const char*, S::count> all;
    std::size_t n = 0;
    if constexpr (method) {
      all[n++] = "self";
    }
    ((all[n++] = names), ...);
    scope.def(
        name,
        [kernel, all](Handle<I>... objects) -> nb::object {
          const std::array<nb::handle, sizeof...(I)> given{objects...};
          if constexpr (std::is_void_v<typename S::Result>) {
            call(kernel, all.data(), given, std::index_sequence<I...>());
            return nb::none();
          } else {
            return ToPython<typename S::Result>::object(call(kernel, all.data(), given, std::index_sequence<I...>()));
          }
        },
        doc, nb::arg(names).none()...);
    (void)each;
  }(std::make_index_sequence<S::count>());
}

/// Bind a function that makes objects of a class as its constructor. The objects look at no arguments: they own copies.
template <class T, class F, class... Names>
void init(nb::class_<T>& type, F make, const char* doc, Names... names) {
  using S = Signature<F>;
  static_assert(is_bound<T>, "not in bind/classes.h");
  static_assert(sizeof...(Names) == S::count, "a name for each argument");
  [&]<std::size_t... I>(std::index_sequence<I...>) {
    const std::array<const char*, S::count> all{names...};
    type.def(
        "__init__",
        [make, all](T* self, Handle<I>... objects) {
          const std::array<nb::handle, sizeof...(I)> given{objects...};
          new (self) T(call(make, all.data(), given, std::index_sequence<I...>()));
        },
        doc, nb::arg(names).none()...);
  }(std::make_index_sequence<S::count>());
}

}  // namespace lidarcfg::bind
