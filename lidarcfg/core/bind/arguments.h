/// From Python's arguments to the views that kernels take, and from their results to Python's.
///
/// Arrays are nanobind's, which compares dtype, shape and order: another one, or one that is to be written and must not
/// be, is refused by a TypeError that names it and says what is allowed. Nothing is converted: what a kernel wrote to a
/// copy would be lost. Structs that kernels take are classes in Python, made field by field, as `Fields` of each says.
/// All of it is in the functions' signatures, from which `tools/make_stubs.py` makes the `.pyi` files.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <concepts>
#include <stdexcept>
#include <string>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

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

template <class T, template <class, nb::ssize_t...> class A, nb::ssize_t... lengths>
auto with_columns() {
  using Element = typename Columns<T>::Element;
  if constexpr (Columns<T>::count == 0) {
    return std::type_identity<A<Element, lengths...>>();
  } else {
    return std::type_identity<A<Element, lengths..., Columns<T>::count>>();
  }
}

/// The array of values that has these dimensions, and that of their columns.
template <class T, nb::ssize_t... lengths>
using ArrayOf = typename decltype(with_columns<T, Contiguous, lengths...>())::type;

/// What Python calls its type: dtype and shape.
template <class T, nb::ssize_t... lengths>
using Plain = nb::ndarray<T, nb::shape<lengths...>>;
template <class T, nb::ssize_t... lengths>
constexpr auto type_of_array =
    nb::detail::make_caster<typename decltype(with_columns<T, Plain, lengths...>())::type>::Name;

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

/// The fields of a struct, by name: `static constexpr auto members = fields(field("x", &Grid::x), …)`.
template <class T>
struct Fields;

template <class S, class M, class A>
struct Field {
  using Argument = A;  // what it is made of

  const char* name;
  M S::* member;
};

/// A field that is made of a value of its own type, or of one that is a pointer's; or of what is told, such as
/// `Shaped`.
template <class A = void, class S, class M>
constexpr auto field(const char* name, M S::* member) {
  using Own = std::remove_cv_t<std::remove_pointer_t<M>>;
  return Field<S, M, std::conditional_t<std::is_void_v<A>, Own, A>>{name, member};
}

template <class... F>
constexpr std::tuple<F...> fields(F... all) {
  return {all...};
}

template <class T>
concept Described = requires { Fields<T>::members; };

template <Described T>
struct Record;

/// The class by which Python knows objects of a class.
template <class T>
struct BoundAs {
  using Class = T;
};
template <Described T>
struct BoundAs<T> {
  using Class = Record<T>;
};

/// From<T>::python(object, held, name) is the T that a Python object says; `type` is what Python calls its type.
template <class T>
struct From {  // an object of a class, by reference
  using Class = typename BoundAs<T>::Class;
  static constexpr auto type = nb::detail::make_caster<Class>::Name;

  static auto& python(nb::handle object, Held& held, const Name& name) {
    Class* found = nullptr;
    if (!nb::try_cast(object, found) || !found) {
      name.refuse("of type " + kind_of(object) + "; allowed: " + nb::type_name(nb::type<Class>()).c_str());
    }
    held.keep(nb::borrow(object));
    if constexpr (Described<T>) {
      return std::as_const(found->value);
    } else {
      return *found;
    }
  }
};

template <std::floating_point T>
struct From<T> {
  static constexpr auto type = nb::detail::const_name("float");

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
  static constexpr auto type = nb::detail::const_name("int");

  static T python(nb::handle object, Held&, const Name& name) {
    const nb::object number = nb::steal(PyNumber_Index(object.ptr()));
    if (!number.is_valid()) {
      PyErr_Clear();
      name.refuse("not an integer, but " + kind_of(object));
    }
    T value{};
    if (!nb::try_cast(number, value)) {
      name.refuse("out of the range of " + std::to_string(8 * sizeof(T)) + " bits");
    }
    return value;
  }
};

template <>
struct From<bool> {
  static constexpr auto type = nb::detail::const_name("bool");

  static bool python(nb::handle object, Held&, const Name& name) {
    const int value = PyObject_IsTrue(object.ptr());
    if (value < 0) {
      PyErr_Clear();
      name.refuse("not a truth value, but " + kind_of(object));
    }
    return value != 0;
  }
};

/// A view that has so many elements along each axis; -1: any number.
template <class V, nb::ssize_t... lengths>
struct Shaped : V {};

template <class V, nb::ssize_t... lengths>
struct From<Shaped<V, lengths...>> {
  using Element = std::remove_pointer_t<decltype(V().data())>;
  static constexpr auto type = type_of_array<std::remove_const_t<Element>, lengths...>;

  static Shaped<V, lengths...> python(nb::handle object, Held& held, const Name& name) {
    const auto found = array<ArrayOf<Element, lengths...>>(object, held, name);
    auto* const data = reinterpret_cast<Element*>(found.data());
    return [&]<std::size_t... I>(std::index_sequence<I...>) {
      return Shaped<V, lengths...>{V(data, static_cast<Index>(found.shape(I))...)};
    }(std::make_index_sequence<sizeof...(lengths)>());
  }
};

template <class T>
struct From<View<T>> : From<Shaped<View<T>, -1>> {};
template <class T>
struct From<Rows<T>> : From<Shaped<Rows<T>, -1, -1>> {};
template <class T>
struct From<Tables<T>> : From<Shaped<Tables<T>, -1, -1, -1>> {};

template <class T, std::size_t N, nb::ssize_t length>
struct From<Shaped<std::array<T, N>, length>> {  // from an array, and no other sequence
  static_assert(N == length);
  using Elements = From<Shaped<View<const T>, length>>;
  static constexpr auto type = Elements::type;

  static std::array<T, N> python(nb::handle object, Held& held, const Name& name) {
    std::array<T, N> out;
    std::ranges::copy(Elements::python(object, held, name), out.begin());
    return out;
  }
};

template <class T, std::size_t N>
struct From<std::array<T, N>> {  // from any sequence of N
  static constexpr auto type = nb::detail::const_name("collections.abc.Sequence[") + From<T>::type +
                               nb::detail::const_name("] | ") +
                               nb::detail::make_caster<nb::ndarray<T, nb::shape<N>>>::Name;

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
  using Item = std::remove_cv_t<std::remove_pointer_t<T>>;
  static constexpr auto type =
      nb::detail::const_name("collections.abc.Sequence[") + From<Item>::type + nb::detail::const_name("]");

  static std::vector<T> python(nb::handle object, Held& held, const Name& name) {
    if (!nb::isinstance<nb::list>(object) && !nb::isinstance<nb::tuple>(object)) {
      name.refuse("not a list or tuple, but " + kind_of(object));
    }
    std::vector<T> out;
    for (nb::handle item : object) {
      held.keep(nb::borrow(item));
      const Name here{"", &name, static_cast<Index>(out.size())};
      if constexpr (std::is_pointer_v<T>) {
        out.push_back(&From<Item>::python(item, held, here));
      } else {
        out.push_back(From<Item>::python(item, held, here));
      }
    }
    return out;
  }
};

template <class T>
bool has_shape(const View<T>& column, Index size) {
  return std::ssize(column) == size;
}
template <class T>
bool has_shape(const Rows<T>& table, Index rows, Index columns) {
  return table.rows() == rows && table.columns() == columns;
}
template <class T>
bool has_shape(const Tables<T>& all, Index tables, Index rows, Index columns) {
  return all.tables() == tables && all.rows() == rows && all.columns() == columns;
}

/// Raises ValueError unless columns of a struct, whose name and theirs the message begins with, have a shape.
template <Described T, class... M, class... I>
void require_columns(const T& whole, const char* name, const char* why, std::tuple<M T::*...> columns, I... shape) {
  const auto check = [&]<class C>(C T::* column) {
    if (has_shape(whole.*column, static_cast<Index>(shape)...)) {
      return;
    }
    const auto refuse = [&](const auto& field) {
      if constexpr (std::is_same_v<std::remove_cvref_t<decltype(field.member)>, C T::*>) {
        require(field.member != column, (std::string(name) + "." + field.name + ": " + why).c_str());
      }
    };
    std::apply([&](const auto&... field) { (refuse(field), ...); }, Fields<T>::members);
  };
  std::apply([&](auto... column) { (check(column), ...); }, columns);
}

/// A new array, which Python owns from then on.
template <class T, std::size_t N = 1>
struct Array {
  std::vector<T> values;
  std::array<std::size_t, N> shape;
};

/// To<T>::python(value) is the Python object of a result; `type` is what Python calls its type.
template <class T>
struct To {
  static constexpr auto type = nb::detail::make_caster<T>::Name;

  static nb::object python(T&& value) { return nb::cast(std::move(value)); }
};

template <class T, std::size_t N>
struct To<Array<T, N>> {
  static constexpr auto type = nb::detail::make_caster<nb::ndarray<nb::numpy, T, nb::ndim<N>>>::Name;

  static nb::object python(Array<T, N>&& array) {
    auto* values = new std::vector<T>(std::move(array.values));
    nb::capsule owner(values, [](void* pointer) noexcept { delete static_cast<std::vector<T>*>(pointer); });
    return nb::cast(nb::ndarray<nb::numpy, T>(values->data(), N, array.shape.data(), owner));
  }
};

template <class T>
struct To<std::vector<T>> {
  static constexpr auto type = To<Array<T>>::type;

  static nb::object python(std::vector<T>&& values) {
    const std::size_t count = values.size();
    return To<Array<T>>::python({std::move(values), {count}});
  }
};

template <class... T>
struct To<std::tuple<T...>> {
  static constexpr auto type =
      nb::detail::const_name("tuple[") + nb::detail::concat(To<T>::type...) + nb::detail::const_name("]");

  static nb::object python(std::tuple<T...>&& values) {
    return std::apply([](T&... each) -> nb::object { return nb::make_tuple(To<T>::python(std::move(each))...); },
                      values);
  }
};

/// A Python object of the type that a signature gives: an argument that From<T> is yet to read.
template <class T>
struct Given {
  nb::handle object;
};

/// The same of a result that To<T> has made.
template <class T>
struct Made {
  nb::object object;
};

}  // namespace lidarcfg::bind

namespace nanobind::detail {

template <class T>
struct type_caster<lidarcfg::bind::Given<T>> {
  NB_TYPE_CASTER(lidarcfg::bind::Given<T>, lidarcfg::bind::From<T>::type)

  bool from_python(handle object, std::uint32_t, cleanup_list*) noexcept {
    value.object = object;
    return true;
  }

  static handle from_cpp(Value given, rv_policy, cleanup_list*) noexcept { return given.object.inc_ref(); }
};

template <class T>
struct type_caster<lidarcfg::bind::Made<T>> {
  NB_TYPE_CASTER(lidarcfg::bind::Made<T>, lidarcfg::bind::To<T>::type)

  static handle from_cpp(Value&& made, rv_policy, cleanup_list*) noexcept { return made.object.release(); }
};

}  // namespace nanobind::detail

namespace lidarcfg::bind {

/// The types of the arguments and the result of a function or lambda.
template <class F>
struct Signature : Signature<decltype(&F::operator())> {};
template <class C, class R, class... A>
struct Signature<R (C::*)(A...) const> {
  using Result = R;
  using Arguments = std::tuple<std::remove_cvref_t<A>...>;
  static constexpr std::size_t count = sizeof...(A);
};
template <class R, class... A>
struct Signature<R (*)(A...)> {
  using Result = R;
  using Arguments = std::tuple<std::remove_cvref_t<A>...>;
  static constexpr std::size_t count = sizeof...(A);
};

/// Call a kernel, without the GIL, with what Python objects say.
template <class F, class... A>
auto call(const F& kernel, const char* const* names, Given<A>... given) {
  Held held;
  std::tuple<decltype(From<A>::python(nb::handle(), held, Name{""}))...> arguments{
      From<A>::python(given.object, held, Name{*names++})...};
  nb::gil_scoped_release released;
  return std::apply(kernel, arguments);
}

/// Bind a kernel to a module or, with the object first, to a class: its name, and those of its arguments.
template <class Scope, class F, class... Names>
void def(Scope& scope, const char* name, F kernel, const char* doc, Names... names) {
  using S = Signature<F>;
  constexpr bool method = !std::is_same_v<Scope, nb::module_>;
  static_assert(sizeof...(Names) + method == S::count, "a name for each argument");
  [&]<class... A>(std::type_identity<std::tuple<A...>>) {
    std::array<const char*, S::count> all;
    std::size_t n = 0;
    if constexpr (method) {
      all[n++] = "self";
    }
    ((all[n++] = names), ...);
    scope.def(
        name,
        [kernel, all](Given<A>... given) {
          if constexpr (std::is_void_v<typename S::Result>) {
            call(kernel, all.data(), given...);
          } else {
            return Made<typename S::Result>{To<typename S::Result>::python(call(kernel, all.data(), given...))};
          }
        },
        doc, nb::arg(names)...);
  }(std::type_identity<typename S::Arguments>());
}

/// Bind a function that makes objects of a class as its constructor. The objects look at no arguments: they own copies.
template <class T, class F, class... Names>
void init(nb::class_<T>& type, F make, const char* doc, Names... names) {
  using S = Signature<F>;
  static_assert(sizeof...(Names) == S::count, "a name for each argument");
  [&]<class... A>(std::type_identity<std::tuple<A...>>) {
    const std::array<const char*, S::count> all{names...};
    type.def(
        "__init__", [make, all](T* self, Given<A>... given) { new (self) T(call(make, all.data(), given...)); }, doc,
        nb::arg(names)...);
  }(std::type_identity<typename S::Arguments>());
}

/// A struct as Python has it, with the objects that it is made of and looks at.
template <Described T>
struct Record {
  T value{};
  Held held;
  std::vector<nb::object> given;

  template <class M, class A>
  void take(const Field<T, M, A>& field, nb::handle object) {
    if constexpr (std::is_pointer_v<M>) {
      value.*field.member = &From<A>::python(object, held, Name{field.name});
    } else {
      value.*field.member = From<A>::python(object, held, Name{field.name});
    }
    given.push_back(nb::borrow(object));
  }
};

/// Bind a struct as a class that Python makes of its fields, and reads them from.
template <Described T>
void record(nb::module_& module, const char* name, const char* doc) {
  using Parts = nb::typed<nb::tuple, nb::any, nb::ellipsis>;
  nb::class_<Record<T>> type(module, name, doc);
  std::apply(
      [&]<class... M, class... A>(const Field<T, M, A>&... field) {
        type.def(
            "__init__",
            [=](Record<T>* self, Given<A>... given) {
              Record<T> made;
              (made.take(field, given.object), ...);
              new (self) Record<T>(std::move(made));
            },
            nb::arg(field.name)...);
        std::size_t n = 0;
        (type.def_prop_ro(field.name, [n = n++](const Record<T>& self) { return Given<A>{self.given[n]}; }), ...);
      },
      Fields<T>::members);
  type.def("__reduce__", [](nb::handle self) -> Parts {  // for pickles
    nb::list given;
    for (const nb::object& one : nb::cast<const Record<T>&>(self).given) {
      given.append(one);
    }
    return Parts(nb::make_tuple(self.type(), nb::tuple(given)));
  });
}

}  // namespace lidarcfg::bind
