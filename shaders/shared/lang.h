// SPDX-License-Identifier: Apache-2.0
// The only file that knows both languages. The other shared headers are plain struct definitions, read unchanged by C++ and
// GLSL: scalar block layout, vectors by GLSL name, pointers as buffer references here and 8-byte addresses there.
#ifndef RELIDAR_INCLUDED_SHARED_LANG_H
#define RELIDAR_INCLUDED_SHARED_LANG_H
#ifdef __cplusplus
#include <cstdint>
#include <glm/glm.hpp>
#define RELIDAR_SHARED_BEGIN namespace relidar::shared {
#define RELIDAR_SHARED_END }
#define RELIDAR_POINTER(name, type) using name = Address<type>
namespace relidar::shared {
using glm::uvec2;
using glm::vec2;
using glm::vec3;
using glm::vec4;
using uint = std::uint32_t;
/// Device address of an array of T; nothing but 8 bytes on the host. Arrays begin at multiples of 16 bytes, so that kernels load a record in
/// pieces of 16 bytes. A part of one that begins elsewhere (a row of counters) is indexed at run time, or by atomics, and nothing else.
template <class T>
struct Address {
    std::uint64_t value = 0;
    Address() = default;
    Address(std::uint64_t address) : value(address) {}
};
}  // namespace relidar::shared
#else
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference2 : require
#extension GL_EXT_buffer_reference_uvec2 : require
#extension GL_EXT_control_flow_attributes : enable
#define RELIDAR_SHARED_BEGIN
#define RELIDAR_SHARED_END
#define RELIDAR_POINTER(name, type) \
    layout(buffer_reference, scalar, buffer_reference_align = 16) buffer name { type at[]; }
// Addresses are never numbers here: not every device has 64-bit integers. A pointer becomes one of another type through uvec2, as not
// every compiler (SwiftShader's) casts pointers.
/// Whether a pointer is address 0: how the host says that there is no such array.
#define is_null(pointer) (uvec2(pointer) == uvec2(0u))
#endif

RELIDAR_SHARED_BEGIN
RELIDAR_POINTER(Floats, float);
RELIDAR_POINTER(Uints, uint);
RELIDAR_POINTER(Vec2s, vec2);
RELIDAR_POINTER(Vec3s, vec3);
RELIDAR_POINTER(Vec4s, vec4);
RELIDAR_SHARED_END
#endif
