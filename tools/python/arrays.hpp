// SPDX-License-Identifier: Apache-2.0
// Conversions between numpy arrays and the library. A returned vector becomes an array
// without a copy. An argument array is read in place, so dtype, shape and order must
// match exactly; nothing is converted implicitly.
#pragma once

#include <span>
#include <vector>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <relidar/base/arrays.hpp>

namespace relidar::python {

namespace py = pybind11;

using Shape = std::vector<py::ssize_t>;
inline constexpr py::ssize_t kAny = -1;  ///< Any length, in the expected shape of an array.

/// Returns an array that takes ownership of the vector's values.
/// @tparam Number element type of the array; an Element consists of one or more Numbers
template <class Number, class Element>
py::array owned(std::vector<Element>&& values, const Shape& shape) {
    auto* kept = new std::vector<Element>(std::move(values));
    const py::capsule owner(kept, [](void* p) { delete static_cast<std::vector<Element>*>(p); });
    return py::array(py::dtype::of<Number>(), shape, kept->data(), owner);
}

/// Returns a read-only array over values that `owner` keeps alive.
template <class Number, class Element>
py::array view(const std::vector<Element>& values, const Shape& shape, const py::handle& owner) {
    py::array array(py::dtype::of<Number>(), shape, values.data(), owner);
    array.attr("setflags")(py::arg("write") = false);
    return array;
}

/// Returns an array of an npz file as a numpy array.
py::array to_numpy(NamedArray&& array);
/// Returns all arrays of an npz file by name.
py::dict to_dict(std::vector<NamedArray>&& arrays);

/// Checks the type of a numpy array.
/// @throws DataError that states what was found, if the object is not an array of this
/// dtype, shape and C order
void check_array(const py::handle& object, const std::string& what, const py::dtype& dtype,
                 const Shape& shape);

/// Returns the values of a C-ordered array without a copy.
/// @param what name of the values, for error messages
/// @param shape expected shape; kAny for any length
/// @throws DataError as check_array()
template <class Number>
std::span<const Number> values_of(const py::handle& object, const std::string& what, const Shape& shape) {
    check_array(object, what, py::dtype::of<Number>(), shape);
    const auto array = py::reinterpret_borrow<py::array>(object);
    return {static_cast<const Number*>(array.data()), static_cast<std::size_t>(array.size())};
}

/// Copies the values into a vector whose elements consist of one or more Numbers.
template <class Number, class Element>
std::vector<Element> copied(const py::handle& object, const std::string& what, const Shape& shape) {
    const std::span<const Number> values = values_of<Number>(object, what, shape);
    const auto* first = reinterpret_cast<const Element*>(values.data());
    return {first, first + values.size() * sizeof(Number) / sizeof(Element)};
}

}  // namespace relidar::python
