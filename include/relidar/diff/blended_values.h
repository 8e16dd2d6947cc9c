// SPDX-License-Identifier: Apache-2.0
// List of all values that a ray blends from its hits, one value per line. C++ and GLSL
// generate struct fields and the sums of the forward and backward kernels from this list.
// docs/architecture.md section 3 explains how to add a value.
#ifndef RELIDAR_INCLUDED_DIFF_BLENDED_VALUES_H
#define RELIDAR_INCLUDED_DIFF_BLENDED_VALUES_H

/// VALUE(name, built, value of a hit, input, slope, meaning) describes one float that a
/// ray blends from its hits: the sum of w * c over all hits. w is the weight of a hit
/// (docs/method.md M4, M5), and c is the value of a hit. A vector has one line per
/// component.
///
///   built           condition on specialisation constants. If false, the value stays 0.
///   value of a hit  GLSL expression for c. It uses `hit` and its `channels` (intensity,
///                   hit logit, drop logit).
///   input           quantity that c depends on: d_t, d_channel.x, .y or .z. The backward
///                   pass adds w * gradient * slope to it. `nowhere` if c is constant.
///   slope           GLSL expression for dc / d(input)
///
/// The background adds 1 to drop_logit and 0 to all other values.

// All blended values except the range D. The backward pass sums these values separately
// from D, because D is much larger.
#define RELIDAR_CHANNEL_VALUES(VALUE)                                                \
    VALUE(weight, true, 1.0, nowhere, 0.0, "sum of w")                               \
    VALUE(intensity, true, channels.x, d_channel.x, 1.0, "sum of w times intensity") \
    VALUE(hit_logit, true, channels.y, d_channel.y, 1.0, "sum of w times hit logit") \
    VALUE(drop_logit, true, channels.z, d_channel.z, 1.0,                            \
          "sum of w times drop logit, plus the remaining transmittance")

// Values that are blended from the hits of each ray and then copied to the host. A loss
// that is computed on the host can provide the gradients dL/d(value).
#define RELIDAR_IMAGE_VALUES(VALUE)                                                                       \
    VALUE(depth, true, hit.t, d_t, 1.0, "sum of w times distance in metres, not divided by the sum of w") \
    RELIDAR_CHANNEL_VALUES(VALUE)

// Values that only some losses need. They are never copied to the host.
#define RELIDAR_LOSS_VALUES(VALUE)                                                                 \
    VALUE(likelihood, LIKELIHOOD != 0u, range_likelihood(hit.t), d_t, range_likelihood_vjp(hit.t), \
          "sum of w times the likelihood of the measured range (docs/method.md M12), 0 without it")

#define RELIDAR_BLENDED_VALUES(VALUE) \
    RELIDAR_IMAGE_VALUES(VALUE)       \
    RELIDAR_LOSS_VALUES(VALUE)

#endif
