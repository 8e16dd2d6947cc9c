// SPDX-License-Identifier: Apache-2.0
// What the kernels of a convolution share. Include after TAPS and
// RELIDAR_PARAMS(ConvParams).
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_CONV_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_CONV_GLSL

/// Where a weight lies.
uint weight_index(uint o, uint i, uint tap) {
    return params.transposed != 0u ? (i * params.n_out + o) * TAPS + (TAPS - 1u - tap)
                                   : (o * params.n_in + i) * TAPS + tap;
}

/// Writes a value of an output channel, or adds it to what is there.
void put(uint at, uint channel, float value) {
    if (!is_null(params.bias)) value += params.bias.at[channel];
    if (params.accumulate != 0u) value += params.to.values.at[at];
    params.to.values.at[at] = value;
}
#endif
