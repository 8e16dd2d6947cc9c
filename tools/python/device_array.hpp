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

/// Wraps a device array, or a part of it, that consists of Numbers in C order.
/// @tparam Number float, std::int32_t (for PyTorch, which lacks uint32) or std::uint32_t
/// @param shape product at most the count of Numbers behind `first_element`
/// @param first_element index of the first element of type T
template <class Number, class T, class Meaning>
DeviceArray wrap_array(const SharedDevice& device, const Array<T, Meaning>& array, NumpyShape shape,
                       std::size_t first_element = 0) {
    static_assert(sizeof(Number) == 4);
    constexpr char kKind = std::is_floating_point_v<Number> ? 'f' : std::is_signed_v<Number> ? 'i' : 'u';
    NumpyShape strides(shape.size(), 1);
    for (std::size_t i = shape.size(); i-- > 1;) strides[i - 1] = strides[i] * shape[i];
    return {device,           array.buffer().share(), first_element * sizeof(T),
            std::move(shape), std::move(strides),     kKind};
}

/// Wraps a member of n structs of a device array, such as &shared::RenderedRay::depth:
/// shape [n], or [n,3] for a vector. Integers become int32, because PyTorch lacks uint32.
/// The structs are first, first + stride, ...
template <class Struct, class Meaning, class Member>
DeviceArray wrap_member(const SharedDevice& device, const Array<Struct, Meaning>& array,
                        Member Struct::*member, std::size_t n, std::size_t first = 0,
                        py::ssize_t stride = 1) {
    static const Struct example{};
    const auto member_bytes = std::size_t(reinterpret_cast<const char*>(&(example.*member)) -
                                          reinterpret_cast<const char*>(&example));
    constexpr std::size_t kNumber = sizeof(float), kWidth = sizeof(Member) / kNumber;
    NumpyShape shape{static_cast<py::ssize_t>(n)}, strides{stride * py::ssize_t(sizeof(Struct) / kNumber)};
    if (kWidth > 1) {
        shape.push_back(kWidth);
        strides.push_back(1);
    }
    return {device,           array.buffer().share(), first * sizeof(Struct) + member_bytes,
            std::move(shape), std::move(strides),     std::is_integral_v<Member> ? 'i' : 'f'};
}

}  // namespace relidar::python
