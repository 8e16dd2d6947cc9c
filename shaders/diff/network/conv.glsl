// SPDX-License-Identifier: Apache-2.0
// Functions that all convolution kernels use. Define TAPS and RELIDAR_PARAMS(ConvParams)
// before this file is included.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_CONV_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_CONV_GLSL

uint weight_index(uint out_channel, uint in_channel, uint tap) {
    return params.transposed != 0u ? (in_channel * params.n_out + out_channel) * TAPS + (TAPS - 1u - tap)
                                   : (out_channel * params.n_in + in_channel) * TAPS + tap;
}

void store_output(uint index, uint channel, float value) {
    if (!is_null(params.bias)) value += params.bias.at[channel];
    if (params.accumulate != 0u) value += params.to.values.at[index];
    params.to.values.at[index] = value;
}
#endif
