// SPDX-License-Identifier: Apache-2.0
// The only file that knows both languages. C++ and GLSL read the other shared headers
// unchanged. These are struct definitions (scalar block layout, vectors by GLSL name,
// pointers as buffer references here and 8-byte addresses there) and a few functions.
#ifndef RELIDAR_INCLUDED_BASE_LANG_H
#define RELIDAR_INCLUDED_BASE_LANG_H
#ifdef __cplusplus
#include <cstdint>
#include <glm/glm.hpp>
#define RELIDAR_SHARED_BEGIN namespace relidar::shared {
#define RELIDAR_SHARED_END }
// Begins a function of both languages, and declares a variable that both compute by the
// same operations. Files that call it are compiled without fused multiplications and
// additions.
#define RELIDAR_FUNCTION inline
#define RELIDAR_EXACT
#define RELIDAR_POINTER(name, type) using name = Address<type>
#define RELIDAR_HANDLE(name)     \
    struct name {                \
        std::uint64_t value = 0; \
    }
// Where a struct has two pointers of one kind, each says what it holds:
// RELIDAR_OF(Floats, LossTerms) terms. In GLSL that is Floats.
#define RELIDAR_OF(pointer, meaning) pointer::Of<struct meaning>
namespace relidar {
template <class T, class Meaning = void>
class Array;
class Stream;

/// Where entries of an array of T begin on the device: nothing but 8 bytes, and nowhere
/// unless an Array<T, Meaning> has made it. Addresses of different types, or of different
/// meanings, are not each other, so that a kernel never gets one array for another.
template <class T, class Meaning = void>
class Address {
public:
    template <class Other>
    using Of = Address<T, Other>;

    Address() = default;
    friend bool operator==(const Address&, const Address&) = default;
    /// The same place under another meaning: the only way from one to the other.
    template <class Other>
    Of<Other> as() const {
        return Of<Other>(value_);
    }

private:
    template <class, class>
    friend class Address;
    template <class, class>
    friend class Array;
    friend class Stream;  // parameters of its own, for one submission
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
#define RELIDAR_POINTER(name, type) \
    layout(buffer_reference, scalar, buffer_reference_align = 16) buffer name { type at[]; }
// What the driver alone reads through.
#define RELIDAR_HANDLE(name) RELIDAR_POINTER(name, uint)
#define RELIDAR_OF(pointer, meaning) pointer
// Addresses are never numbers here: not every device has 64-bit integers. A pointer
// becomes one of another type through uvec2, as not every compiler (SwiftShader's) casts
// pointers.
#endif

RELIDAR_SHARED_BEGIN
RELIDAR_POINTER(Floats, float);
RELIDAR_POINTER(Uints, uint);
RELIDAR_POINTER(Vec2s, vec2);
RELIDAR_POINTER(Vec3s, vec3);
RELIDAR_POINTER(Vec4s, vec4);
RELIDAR_SHARED_END
#endif
