// SPDX-License-Identifier: Apache-2.0
// Functions that all convolution kernels use. Include this file after TAPS and
// RELIDAR_PARAMS(ConvParams).
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_CONV_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_CONV_GLSL

/// Returns the index of a weight in the weight array, for output channel o, input channel
/// i and a tap.
uint weight_index(uint o, uint i, uint tap) {
    return params.transposed != 0u ? (i * params.n_out + o) * TAPS + (TAPS - 1u - tap)
                                   : (o * params.n_in + i) * TAPS + tap;
}

/// Writes a value of an output channel with its bias, or adds it to the stored value.
void put(uint at, uint channel, float value) {
    if (!is_null(params.bias)) value += params.bias.at[channel];
    if (params.accumulate != 0u) value += params.to.values.at[at];
    params.to.values.at[at] = value;
}
#endif
