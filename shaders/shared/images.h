// SPDX-License-Identifier: Apache-2.0
// Images of the ray-drop network: [n_images, channels, rows, columns], columns fastest. They are kept as floats, or as halves in the
// variants of kernels that are built with RELIDAR_HALVES; what is computed from them are floats in both.
#ifndef RELIDAR_INCLUDED_SHARED_IMAGES_H
#define RELIDAR_INCLUDED_SHARED_IMAGES_H
#include "relidar/shared/lang.h"

#ifdef __cplusplus
#define RELIDAR_IMAGE_VALUE ImageValue
#elif defined(RELIDAR_HALVES)
#extension GL_EXT_shader_16bit_storage : require
#define RELIDAR_IMAGE_VALUE float16_t
#else
#define RELIDAR_IMAGE_VALUE float
#endif

RELIDAR_SHARED_BEGIN
#ifdef __cplusplus
struct ImageValue { std::uint16_t bits; };   // or half of a float's
#else
/// No larger than a half can be; what is no number stays none, for the loss to show it.
float in_half(float x) { return isnan(x) ? x : clamp(x, -65504.0, 65504.0); }
#ifdef RELIDAR_HALVES
#define AS_KEPT(x) float16_t(in_half(x))
#else
#define AS_KEPT(x) (x)
#endif
#endif
RELIDAR_POINTER(Values, RELIDAR_IMAGE_VALUE);

// Some consecutive channels of images.
struct ImageSlice {
    Values values;
    uint channels;         // of the images
    uint first;            // that belongs to the slice
};

RELIDAR_SHARED_END
#endif
