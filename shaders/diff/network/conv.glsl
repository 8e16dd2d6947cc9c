// SPDX-License-Identifier: Apache-2.0
// Functions that all convolution kernels use. Define TAPS and RELIDAR_PARAMS(ConvParams)
// before this file is included.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_CONV_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_CONV_GLSL

/// Returns the index of a weight in the weight array.
/// @param o output channel
/// @param i input channel
/// @param tap position in the convolution kernel, 0 to TAPS - 1
uint weight_index(uint o, uint i, uint tap) {
    return params.transposed != 0u ? (i * params.n_out + o) * TAPS + (TAPS - 1u - tap)
                                   : (o * params.n_in + i) * TAPS + tap;
}

/// Adds the bias of the channel to a value of the output. Then writes the value, or adds
/// it to the stored value if `accumulate` is set.
void put(uint at, uint channel, float value) {
    if (!is_null(params.bias)) value += params.bias.at[channel];
    if (params.accumulate != 0u) value += params.to.values.at[at];
    params.to.values.at[at] = value;
}
#endif
