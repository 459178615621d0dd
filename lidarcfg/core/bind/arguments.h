/// From Python's arguments to the views that kernels take, and from their results to Python's.
///
/// Arrays are nanobind's, which compares dtype, shape and order: another one, or one that is to be written and must not
/// be, is refused by a TypeError that names it and says what is allowed. Nothing is converted: what a kernel wrote to a
/// copy would be lost. The structs that kernels take come from NamedTuples, field by field, as `Fields` of each says.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <concepts>
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

  [[noreturn]] void refuse(const std::string& why) const { throw nb::type_error((text() + ": " + why).c_str()); }
};

/// The name of an object's type.
inline std::string kind_of(nb::handle object) { return nb::type_name(object.type()).c_str(); }

/// What the arguments of a call look at; held until it returns.
class Held {
 public:
  template <class... Config>
  void keep(const nb::ndarray<Config...>& array) {
    arrays_.emplace_back(array);
  }

  /// A value that a view looks at, such as the items of a sequence.
  void keep(nb::object object) { objects_.push_back(std::move(object)); }

 private:
  std::vector<nb::ndarray<>> arrays_;
  std::vector<nb::object> objects_;
};

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

template <class T, nb::ssize_t... lengths>
using Contiguous = nb::ndarray<T, nb::shape<lengths...>, nb::c_contig, nb::device::cpu>;

/// The array of values that has so many dimensions of any lengths, and that of their columns.
template <class T, nb::ssize_t... any>
using ArrayOf = std::conditional_t<Columns<T>::count == 0, Contiguous<typename Columns<T>::Element, any...>,
                                   Contiguous<typename Columns<T>::Element, any..., Columns<T>::count>>;

/// What an object is: of an array dtype and shape.
inline std::string kind_of_array(nb::handle object) {
  if (!nb::hasattr(object, "dtype") || !nb::hasattr(object, "shape")) {
    return kind_of(object);
  }
  const nb::object dtype = object.attr("dtype");
  const nb::object shape = object.attr("shape");
  return std::string(nb::str(nb::handle(dtype)).c_str()) + " of shape " + nb::str(nb::handle(shape)).c_str();
}

/// The array that an object is.
template <class A>
A array(nb::handle object, Held& held, const Name& name) {
  A found;
  if (!nb::try_cast(object, found, false)) {
    name.refuse(kind_of_array(object) + "; allowed: " + nb::detail::make_caster<A>::Name.text);
  }
  if (reinterpret_cast<std::uintptr_t>(found.data()) % alignof(typename A::Scalar) != 0) {
    name.refuse("not aligned in memory");
  }
  held.keep(found);
  return found;
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
      name.refuse("out of the range of " + std::to_string(8 * sizeof(T)) + " bits");
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
    const auto found = array<ArrayOf<T, -1>>(object, held, name);
    return {reinterpret_cast<T*>(found.data()), found.shape(0)};
  }
};

template <class T>
struct From<Rows<T>> {
  static Rows<T> python(nb::handle object, Held& held, const Name& name) {
    const auto found = array<ArrayOf<T, -1, -1>>(object, held, name);
    return {reinterpret_cast<T*>(found.data()), Index(found.shape(0)), Index(found.shape(1))};
  }
};

template <class T>
struct From<Tables<T>> {
  static Tables<T> python(nb::handle object, Held& held, const Name& name) {
    const auto found = array<ArrayOf<T, -1, -1, -1>>(object, held, name);
    return {reinterpret_cast<T*>(found.data()), Index(found.shape(0)), Index(found.shape(1)), Index(found.shape(2))};
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
