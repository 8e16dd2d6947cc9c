// SPDX-License-Identifier: Apache-2.0
// Converts between numpy arrays and C++ vectors, without a copy if possible. An array
// argument is not converted, so its dtype, shape and order must match exactly.
#pragma once

#include <span>
#include <vector>

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <relidar/base/arrays.hpp>

namespace relidar::python {

namespace py = pybind11;

using NumpyShape = std::vector<py::ssize_t>;
inline constexpr py::ssize_t kAnyLength = -1;

/// Returns a numpy array that takes ownership of the values of a vector, without a copy.
/// @tparam Number element type of the array; each Element of the vector consists of one
/// or more Numbers
template <class Number, class Element>
py::array move_to_numpy(std::vector<Element>&& values, const NumpyShape& shape) {
    auto* owned_values = new std::vector<Element>(std::move(values));
    const py::capsule owner(owned_values, [](void* p) { delete static_cast<std::vector<Element>*>(p); });
    return py::array(py::dtype::of<Number>(), shape, owned_values->data(), owner);
}

py::array to_numpy(NamedArray&& npz_array);
py::dict to_array_dict(std::vector<NamedArray>&& npz_arrays);

/// Returns a numpy array unchanged, and other objects with __dlpack__ as a numpy array of
/// the same memory. Returns any other object unchanged.
/// @throws DataError if the object is a tensor in the memory of a GPU
py::object to_numpy(const py::handle& object);

/// Checks the dtype and shape of a numpy array.
/// @throws DataError like check_array()
void check_dtype(const py::handle& object, const std::string& where, const py::dtype& dtype,
                 const NumpyShape& shape);

/// Checks the dtype, shape and C order of a numpy array.
/// @throws DataError if the object is not such an array; the message contains the actual
/// type and shape
void check_array(const py::handle& object, const std::string& where, const py::dtype& dtype,
                 const NumpyShape& shape);

/// Returns the values of a numpy array in C order, without a copy.
/// @param where name of the values, for error messages
/// @param shape expected shape; kAnyLength means any length
/// @throws DataError if the dtype, shape or order of the array is wrong
template <class Number>
std::span<const Number> array_values(const py::handle& object, const std::string& where,
                                     const NumpyShape& shape) {
    check_array(object, where, py::dtype::of<Number>(), shape);
    const auto array = py::reinterpret_borrow<py::array>(object);
    return {static_cast<const Number*>(array.data()), static_cast<std::size_t>(array.size())};
}

/// The same as a vector. Accepts any object of to_numpy().
template <class Number, class Element>
std::vector<Element> copy_array(const py::handle& object, const std::string& where, const NumpyShape& shape) {
    const py::object array = to_numpy(object);
    const std::span<const Number> values = array_values<Number>(array, where, shape);
    const auto* first = reinterpret_cast<const Element*>(values.data());
    return {first, first + values.size() * sizeof(Number) / sizeof(Element)};
}

}  // namespace relidar::python
