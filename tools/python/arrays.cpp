// SPDX-License-Identifier: Apache-2.0
#include "arrays.hpp"

#include <string>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar::python {
namespace {

std::string format_shape(const Shape& shape) {
    std::string text;
    for (std::size_t i = 0; i < shape.size(); ++i)
        text +=
            (i ? "," : "") + (shape[i] == kAny ? (shape.size() > 1 && i == 1 && shape[0] == kAny ? "m" : "n")
                                               : std::to_string(shape[i]));
    return "[" + text + "]";
}

std::string format_dtype(const py::dtype& dtype) { return py::str(py::handle(dtype)); }

bool has_shape(const py::array& array, const Shape& shape) {
    if (static_cast<std::size_t>(array.ndim()) != shape.size()) return false;
    for (std::size_t i = 0; i < shape.size(); ++i)
        if (shape[i] != kAny && shape[i] != array.shape(static_cast<py::ssize_t>(i))) return false;
    return true;
}

}  // namespace

py::array to_numpy(NamedArray&& array) {
    const Shape shape(array.shape.begin(), array.shape.end());
    const py::dtype dtype(array.dtype == "b1" ? "?" : array.dtype);
    auto* kept = new std::vector<std::byte>(std::move(array.bytes));
    const py::capsule owner(kept, [](void* p) { delete static_cast<std::vector<std::byte>*>(p); });
    return py::array(dtype, shape, kept->data(), owner);
}

py::dict to_dict(std::vector<NamedArray>&& arrays) {
    py::dict dict;
    for (NamedArray& array : arrays) {
        const py::str name(array.name);
        dict[name] = to_numpy(std::move(array));
    }
    return dict;
}

void check_array(const py::handle& object, const std::string& description, const py::dtype& dtype,
                 const Shape& shape) {
    const std::string expected = fmt::format("an array of {} {}", format_dtype(dtype), format_shape(shape));
    if (!py::isinstance<py::array>(object)) {
        throw DataError(fmt::format("{}: found an object of type {}, expected {}", description,
                                    std::string(py::str(py::type::handle_of(object).attr("__name__"))),
                                    expected));
    }
    const auto array = py::reinterpret_borrow<py::array>(object);
    if (!array.dtype().equal(dtype) || !has_shape(array, shape)) {
        const Shape found(array.shape(), array.shape() + array.ndim());
        throw DataError(fmt::format("{}: found {} {}, expected {}", description, format_dtype(array.dtype()),
                                    format_shape(found), expected));
    }
    const bool ordered = (array.flags() & py::array::c_style) != 0,
               aligned = array.attr("flags").attr("aligned").cast<bool>();
    if (!ordered || !aligned)
        throw DataError(
            fmt::format("{}: found an array that is not contiguous, expected {} in C order; "
                        "numpy.ascontiguousarray() converts it",
                        description, expected));
}

}  // namespace relidar::python
