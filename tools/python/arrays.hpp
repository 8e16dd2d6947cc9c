// SPDX-License-Identifier: Apache-2.0
// Between numpy and the library. Out: a vector's values become an array without a copy.
// In: an array's values are read where they lie, so dtype, shape and order must be as
// they are named; nothing is converted behind the caller's back.
#pragma once

#include <span>
#include <vector>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <relidar/base/arrays.hpp>

namespace relidar::python {

namespace py = pybind11;

using Shape = std::vector<py::ssize_t>;
inline constexpr py::ssize_t kAny = -1;  ///< any length, in the shape that is expected of an array

/// An array that owns the vector's values: they are moved. @tparam Number  of which an
/// element has one or more
template <class Number, class Element>
py::array owned(std::vector<Element>&& values, const Shape& shape) {
    auto* kept = new std::vector<Element>(std::move(values));
    const py::capsule owner(kept, [](void* p) { delete static_cast<std::vector<Element>*>(p); });
    return py::array(py::dtype::of<Number>(), shape, kept->data(), owner);
}

/// A read-only array over values that `owner` keeps alive.
template <class Number, class Element>
py::array view(const std::vector<Element>& values, const Shape& shape, const py::handle& owner) {
    py::array array(py::dtype::of<Number>(), shape, values.data(), owner);
    array.attr("setflags")(py::arg("write") = false);
    return array;
}

/// An array of an npz as numpy reads it.
py::array to_numpy(NamedArray&& array);
/// All arrays of an npz, by name.
py::dict to_dict(std::vector<NamedArray>&& arrays);

/// @throws DataError naming what was found where the object is no array of this dtype,
/// shape and C order
void check_array(const py::handle& object, const std::string& what, const py::dtype& dtype,
                 const Shape& shape);

/// The values of a C-ordered array, where they lie. @param what  is read, for the message
/// @param shape  of the array; kAny for any length
/// @throws DataError as check_array()
template <class Number>
std::span<const Number> values_of(const py::handle& object, const std::string& what, const Shape& shape) {
    check_array(object, what, py::dtype::of<Number>(), shape);
    const auto array = py::reinterpret_borrow<py::array>(object);
    return {static_cast<const Number*>(array.data()), static_cast<std::size_t>(array.size())};
}

/// The same copied into a vector whose elements hold one Number or more.
template <class Number, class Element>
std::vector<Element> copied(const py::handle& object, const std::string& what, const Shape& shape) {
    const std::span<const Number> values = values_of<Number>(object, what, shape);
    const auto* first = reinterpret_cast<const Element*>(values.data());
    return {first, first + values.size() * sizeof(Number) / sizeof(Element)};
}

}  // namespace relidar::python
