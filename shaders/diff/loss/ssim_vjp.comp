// SPDX-License-Identifier: Apache-2.0
// Computes the derivative of the structural similarity loss with respect to the rendered
// intensity. Each pixel sums over all windows that contain it. One thread per pixel.
//   dL/dx_q = sum_p w_pq / sum_p' w
//             (dL/dm_p + 2 (x_q - mx_p) dL/dv_p + (y_q - my_p) dL/dcov_p)
//
// Input: rendered, targets, statistics. Accumulated: upstream.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "../../base/kernel.glsl"
#include "../shared/loss.h"
RELIDAR_PARAMS(SsimParams);
#include "ssim.glsl"

void main() {
    uint q = thread_index();
    if (q >= params.rows * params.columns || !has_return(load_target(q))) return;
    float x = params.rendered.at[q].intensity, y = load_target(q).intensity, sum = 0.0;
    for (int row = -kSsimRadius; row <= kSsimRadius; ++row) {
        for (int column = -kSsimRadius; column <= kSsimRadius; ++column) {
            uint p = window_pixel(q, row, column);
            if (p == kNoPixel || !has_return(load_target(p))) continue;
            uint at = p * RELIDAR_SSIM_FLOATS;
            // Statistics of the window around p: dL/dm, 2 dL/dv and dL/dcov, divided by
            // the sum of weights; then the means mx and my.
            sum += window_weight(row, column) *
                   (params.statistics.at[at] +
                    (x - params.statistics.at[at + 3u]) * params.statistics.at[at + 1u] +
                    (y - params.statistics.at[at + 4u]) * params.statistics.at[at + 2u]);
        }
    }
    params.upstream.at[q].intensity += sum;
}
