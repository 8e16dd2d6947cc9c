// SPDX-License-Identifier: Apache-2.0
// Defines the pointer and vector types that C++ and GLSL share. Both languages include
// the same headers, which contain struct definitions and a few functions. Structs use the
// scalar block layout. A pointer is a buffer reference in GLSL and an 8-byte address in
// C++.
#ifndef RELIDAR_INCLUDED_BASE_LANG_H
#define RELIDAR_INCLUDED_BASE_LANG_H
#ifdef __cplusplus
#include <cstdint>
#include <glm/glm.hpp>
#define RELIDAR_SHARED_BEGIN namespace relidar::shared {
#define RELIDAR_SHARED_END }
// RELIDAR_FUNCTION marks a function that both C++ and GLSL compile. RELIDAR_EXACT marks a
// variable whose arithmetic the compiler must not reorder or fuse, so that both languages
// compute the same value. C++ files that call such functions are compiled without fused
// multiply-add.
#define RELIDAR_FUNCTION inline
#define RELIDAR_EXACT
#define RELIDAR_DECLARE_POINTER(name, type) using name = Address<type>
#define RELIDAR_DECLARE_HANDLE(name) \
    struct name {                    \
        std::uint64_t value = 0;     \
    }
// Adds a name for the content of the data to a pointer type, for example
// RELIDAR_OF(Floats, LossTerms) terms. In C++, pointers with different content names are
// different types, even if their element types are equal. In GLSL the type is simply
// Floats.
#define RELIDAR_OF(pointer, content) pointer::Of<struct content>
namespace relidar {
template <class T, class Meaning = void>
class Array;
class Stream;

/// Device address of an array of T, 8 bytes. `Meaning` names the content of the array.
/// Addresses other than null are created only by Array<T, Meaning>. An assignment
/// requires the same T and the same Meaning, so that a kernel cannot get the wrong array.
template <class T, class Meaning = void>
class Address {
public:
    template <class Other>
    using Of = Address<T, Other>;

    Address() = default;
    friend bool operator==(const Address&, const Address&) = default;
    /// Returns the same address, but with `Other` as the tag type that names the content
    /// of the array. Only this function changes the tag type.
    template <class Other>
    Of<Other> cast_tag() const {
        return Of<Other>(value_);
    }

private:
    template <class, class>
    friend class Address;
    template <class, class>
    friend class Array;
    // Stream is a friend because it creates addresses of the memory that holds the
    // parameters of a kernel launch. Such an address is valid for one submission.
    friend class Stream;
    explicit Address(std::uint64_t value) : value_(value) {}
    std::uint64_t value_ = 0;
};
}  // namespace relidar
namespace relidar::shared {
using glm::uvec2;
using glm::vec2;
using glm::vec3;
using glm::vec4;
using uint = std::uint32_t;
}  // namespace relidar::shared
#else
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference2 : require
#extension GL_EXT_buffer_reference_uvec2 : require
#extension GL_EXT_control_flow_attributes : enable
#define RELIDAR_SHARED_BEGIN
#define RELIDAR_SHARED_END
#define RELIDAR_FUNCTION
#define RELIDAR_EXACT precise
#define RELIDAR_DECLARE_POINTER(name, type) \
    layout(buffer_reference, scalar, buffer_reference_align = 16) buffer name { type at[]; }
// Declares a pointer type for memory that only the driver reads, never relidar's kernels.
#define RELIDAR_DECLARE_HANDLE(name) RELIDAR_DECLARE_POINTER(name, uint)
#define RELIDAR_OF(pointer, content) pointer
// Shaders never convert an address to a 64-bit integer, because some devices lack 64-bit
// integers. To convert between pointer types, shaders use uvec2, because some compilers
// (SwiftShader) cannot cast pointers directly.
#endif

RELIDAR_SHARED_BEGIN
RELIDAR_DECLARE_POINTER(Floats, float);
RELIDAR_DECLARE_POINTER(Uints, uint);
RELIDAR_DECLARE_POINTER(Vec2s, vec2);
RELIDAR_DECLARE_POINTER(Vec3s, vec3);
RELIDAR_DECLARE_POINTER(Vec4s, vec4);
RELIDAR_SHARED_END
#endif
