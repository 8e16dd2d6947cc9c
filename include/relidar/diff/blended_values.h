// SPDX-License-Identifier: Apache-2.0
// Every value that a ray blends from its hits, a line each: the only list of them, read by
// C++ and GLSL. From it come the fields of RenderedRay and RayGradient, of Rendering and
// RenderedGradients, and what the forward and the backward kernels sum. docs/architecture.md
// section 3 says how to add one.
#ifndef RELIDAR_INCLUDED_DIFF_BLENDED_VALUES_H
#define RELIDAR_INCLUDED_DIFF_BLENDED_VALUES_H

/// VALUE(name, built, value of a hit, input, slope, meaning) stands for one float,
/// sum over hits of w * c, where w is the weight of a hit (docs/method.md M4, M5). A vector
/// has a line for each component.
///   built           condition on specialisation constants: kernels without it leave the value 0
///   value of a hit  GLSL, c: from `hit` and its `channels` (intensity, hit logit, drop logit)
///   input           what c depends on, and what the backward pass gives w * gradient * slope to:
///                   d_t, d_channel.x, .y, .z; `nowhere` if c is constant
///   slope           GLSL, dc / d(input)
/// The background adds 0 to each value, except 1 to drop_logit.

// Values of every ray except the range D. The backward pass sums them before it adds D,
// which is larger.
#define RELIDAR_CHANNEL_VALUES(VALUE)                                                \
    VALUE(weight, true, 1.0, nowhere, 0.0, "sum of w")                               \
    VALUE(intensity, true, channels.x, d_channel.x, 1.0, "sum of w times intensity") \
    VALUE(hit_logit, true, channels.y, d_channel.y, 1.0, "sum of w times hit logit") \
    VALUE(drop_logit, true, channels.z, d_channel.z, 1.0, "sum of w times drop logit, + transmittance")

// Values of every ray: the host reads them and sets their gradients.
#define RELIDAR_IMAGE_VALUES(VALUE)                                                        \
    VALUE(depth, true, hit.t, d_t, 1.0, "sum of w times distance, not normalised, metres") \
    RELIDAR_CHANNEL_VALUES(VALUE)

// Values that only some losses need, on the device.
#define RELIDAR_LOSS_VALUES(VALUE)                                                          \
    VALUE(likelihood, LIKELIHOOD != 0u, range_kernel(hit.t), d_t, range_kernel_by_t(hit.t), \
          "sum of w times the kernel about the measured range (M12), 0 without one")

#define RELIDAR_BLENDED_VALUES(VALUE) \
    RELIDAR_IMAGE_VALUES(VALUE)       \
    RELIDAR_LOSS_VALUES(VALUE)

#endif
