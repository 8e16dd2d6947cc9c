// SPDX-License-Identifier: Apache-2.0
// An array of a device as a Python object, which numpy, PyTorch and other libraries use
// through DLPack. On a CPU device, and on cards that share their memory with CUDA or HIP,
// they read and write the memory of the device without a copy.
#pragma once

#include <relidar/gpu/stream.hpp>
#include "arrays.hpp"
#include "device.hpp"

namespace relidar::python {

/// Numbers of 32 bits in the memory of a device. Keeps the memory and the device alive,
/// also after the object that owns the array was destroyed or has replaced the array.
struct DeviceArray {
    SharedDevice device;
    Buffer buffer;  ///< destroyed before `device`
    std::size_t offset_bytes = 0;
    NumpyShape shape, strides;  ///< strides in numbers, not bytes
    char kind = 'f';            ///< 'f' float32, 'i' int32, 'u' uint32
};

template <class Number>
constexpr char kind_of() {
    static_assert(sizeof(Number) == 4);
    if (std::is_floating_point_v<Number>) return 'f';
    return std::is_signed_v<Number> ? 'i' : 'u';
}

/// Wraps a device array, or a part of it, that consists of Numbers in C order.
/// @tparam Number float, std::int32_t (for PyTorch, which lacks uint32) or std::uint32_t
/// @param shape product at most the count of Numbers behind `first_element`
/// @param first_element index of the first element of type T
template <class Number, class T, class Meaning>
DeviceArray wrap_array(const SharedDevice& device, const Array<T, Meaning>& array, NumpyShape shape,
                       std::size_t first_element = 0) {
    NumpyShape strides(shape.size(), 1);
    for (std::size_t i = shape.size(); i-- > 1;) strides[i - 1] = strides[i] * shape[i];
    return {device,           array.buffer().share(), first_element * sizeof(T),
            std::move(shape), std::move(strides),     kind_of<Number>()};
}

/// Wraps one member of all structs of a device array, for example
/// wrap_member<float>(device, rendered, offsetof(shared::RenderedRay, depth), n_rays).
/// @param member_bytes offset of the member
/// @param n_rows number of structs
/// @param width count of Numbers of the member; 0: a single number, shape [n_rows]
///        instead of [n_rows,width]
template <class Number, class T, class Meaning>
DeviceArray wrap_member(const SharedDevice& device, const Array<T, Meaning>& array, std::size_t member_bytes,
                        std::size_t n_rows, py::ssize_t width = 0) {
    // Strides count Numbers, not bytes.
    constexpr py::ssize_t kStride = sizeof(T) / sizeof(Number);
    NumpyShape shape{static_cast<py::ssize_t>(n_rows)}, strides{kStride};
    if (width > 0) {
        shape.push_back(width);
        strides.push_back(1);
    }
    return {device,           array.buffer().share(), member_bytes,
            std::move(shape), std::move(strides),     kind_of<Number>()};
}

}  // namespace relidar::python
