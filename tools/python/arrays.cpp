// SPDX-License-Identifier: Apache-2.0
#include "arrays.hpp"

#include <fmt/format.h>
#include "base/fail.hpp"

namespace relidar::python {
namespace {

/// Returns a shape for messages: "[n,3]". Names unknown lengths n, or n and m.
std::string format_shape(const NumpyShape& shape) {
    std::string text;
    for (std::size_t i = 0; i < shape.size(); ++i) {
        if (i > 0) text += ",";
        if (shape[i] != kAnyLength) text += std::to_string(shape[i]);
        else text += i == 1 && shape[0] == kAnyLength ? "m" : "n";
    }
    return "[" + text + "]";
}

std::string format_dtype(const py::dtype& dtype) { return py::str(py::handle(dtype)); }

bool has_shape(const py::array& array, const NumpyShape& shape) {
    if (static_cast<std::size_t>(array.ndim()) != shape.size()) return false;
    for (std::size_t i = 0; i < shape.size(); ++i)
        if (shape[i] != kAnyLength && shape[i] != array.shape(static_cast<py::ssize_t>(i))) return false;
    return true;
}

}  // namespace

/// Converts an array of an npz file without copying its bytes. The capsule frees the
/// bytes when Python releases the array.
py::array to_numpy(NamedArray&& npz_array) {
    const NumpyShape shape(npz_array.shape.begin(), npz_array.shape.end());
    const py::dtype dtype(npz_array.dtype == "b1" ? "?" : npz_array.dtype);
    auto* owned_bytes = new std::vector<std::byte>(std::move(npz_array.bytes));
    const py::capsule owner(owned_bytes, [](void* p) { delete static_cast<std::vector<std::byte>*>(p); });
    return py::array(dtype, shape, owned_bytes->data(), owner);
}

py::dict to_array_dict(std::vector<NamedArray>&& npz_arrays) {
    py::dict dict;
    for (NamedArray& array : npz_arrays) {
        const py::str name(array.name);
        dict[name] = to_numpy(std::move(array));
    }
    return dict;
}

py::object to_numpy(const py::handle& object) {
    const auto same = py::reinterpret_borrow<py::object>(object);
    if (py::isinstance<py::array>(object) || !py::hasattr(object, "__dlpack_device__")) return same;
    constexpr int kDlCpu = 1;
    if (object.attr("__dlpack_device__")().cast<std::pair<int, int>>().first != kDlCpu)
        throw DataError("cannot read a tensor in the memory of a GPU; copy it to the host");
    return py::module_::import("numpy").attr("from_dlpack")(same);
}

void check_dtype(const py::handle& object, const std::string& where, const py::dtype& dtype,
                 const NumpyShape& shape) {
    const std::string expected = fmt::format("an array of {} {}", format_dtype(dtype), format_shape(shape));
    if (!py::isinstance<py::array>(object)) {
        fail("{}: found an object of type {}, expected {}", where,
             std::string(py::str(py::type::handle_of(object).attr("__name__"))), expected);
    }
    const auto array = py::reinterpret_borrow<py::array>(object);
    if (!array.dtype().equal(dtype) || !has_shape(array, shape)) {
        const NumpyShape actual_shape(array.shape(), array.shape() + array.ndim());
        fail("{}: found {} {}, expected {}", where, format_dtype(array.dtype()), format_shape(actual_shape),
             expected);
    }
}

void check_array(const py::handle& object, const std::string& where, const py::dtype& dtype,
                 const NumpyShape& shape) {
    check_dtype(object, where, dtype, shape);
    const std::string expected = fmt::format("an array of {} {}", format_dtype(dtype), format_shape(shape));
    const auto array = py::reinterpret_borrow<py::array>(object);
    // C order and aligned, so that the data can be read as a plain C array.
    const bool is_c_order = (array.flags() & py::array::c_style) != 0,
               is_aligned = array.attr("flags").attr("aligned").cast<bool>();
    if (!is_c_order || !is_aligned)
        fail(
            "{}: found an array that is not contiguous, expected {} in C order; "
            "numpy.ascontiguousarray() converts it",
            where, expected);
}

}  // namespace relidar::python
