// SPDX-License-Identifier: Apache-2.0
// Computes the structural similarity S of rendered (x) and measured (y) intensity in a
// window around each pixel with a return. Uses the constants of Wang et al. 2004 for
// values 0..1. Also writes the derivatives with respect to the mean, variance and
// covariance in the window. One thread per pixel.
//   S = (2 mx my + C1) (2 cov + C2) / ((mx^2 + my^2 + C1) (vx + vy + C2))
//   term = weight (1 - S)
//
// Input: rendered, targets. Output: statistics. Accumulated: terms.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/loss.h"
#include "relidar/base/atomic_add.glsl"
#include "relidar/base/reduce.glsl"
RELIDAR_PARAMS(SsimParams);
#include "ssim.glsl"

const float kC1 = 1e-4;  // (0.01)^2
const float kC2 = 9e-4;  // (0.03)^2

struct Window {
    float sum;  // sum of the window's weights
    vec2 mean;  // means of x and y
    vec2 variance;
    float covariance;
};

/// Computes weighted means, variances and the covariance of both images in the window
/// around a pixel. Subtracts the value of the centre pixel first, because the sums would
/// otherwise lose precision in flat regions.
Window window_statistics(uint index) {
    vec2 centre = vec2(params.rendered.at[index].intensity, load_target(index).intensity);
    float sum = 0.0, products = 0.0;
    vec2 values = vec2(0.0), squares = vec2(0.0);
    for (int row = -kSsimRadius; row <= kSsimRadius; ++row) {
        for (int column = -kSsimRadius; column <= kSsimRadius; ++column) {
            uint j = window_pixel(index, row, column);
            if (j == kNoPixel) continue;
            DeviceTarget t = load_target(j);
            if (!has_return(t)) continue;
            float w = window_weight(row, column);
            vec2 v = vec2(params.rendered.at[j].intensity, t.intensity) - centre;
            sum += w;
            values += w * v;
            squares += w * v * v;
            products += w * v.x * v.y;
        }
    }
    vec2 shifted = values / sum;
    return Window(sum, centre + shifted, squares / sum - shifted * shifted,
                  products / sum - shifted.x * shifted.y);
}

/// Computes the structural similarity (SSIM) loss of a pixel: rendered against measured
/// intensity. Also writes the derivatives of the loss to `statistics`.
float ssim_loss(uint pixel) {
    Window w = window_statistics(pixel);
    float a1 = 2.0 * w.mean.x * w.mean.y + kC1, a2 = 2.0 * w.covariance + kC2;
    float b1 = dot(w.mean, w.mean) + kC1, b2 = w.variance.x + w.variance.y + kC2;
    float s = a1 * a2 / (b1 * b2);
    float scale = -params.weight / w.sum;
    uint at = pixel * RELIDAR_SSIM_FLOATS;
    params.statistics.at[at] = scale * (2.0 * w.mean.y * a2 / (b1 * b2) - 2.0 * w.mean.x * s / b1);
    params.statistics.at[at + 1u] = scale * -2.0 * s / b2;
    params.statistics.at[at + 2u] = scale * 2.0 * a1 / (b1 * b2);
    params.statistics.at[at + 3u] = w.mean.x;
    params.statistics.at[at + 4u] = w.mean.y;
    return params.weight * (1.0 - s);
}

void main() {
    uint i = thread_index();
    float term = i < params.rows * params.columns && has_return(load_target(i)) ? ssim_loss(i) : 0.0;
    add_to_sum(params.terms, kTerm_ssim, term);
}
