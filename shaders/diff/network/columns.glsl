// SPDX-License-Identifier: Apache-2.0
// Finds the image columns that a convolution reads. Define TAPS and RELIDAR_PARAMS before
// this file is included.
#ifndef RELIDAR_INCLUDED_DIFF_NETWORK_COLUMNS_GLSL
#define RELIDAR_INCLUDED_DIFF_NETWORK_COLUMNS_GLSL

/// Returns the column that the first weight of a kernel row multiplies: the column itself
/// for 1x1 kernels, otherwise its left neighbour.
/// @param inside output: false if the column is outside an image that is not circular
uint source_column(uint column, out bool inside) {
    // In column 0, column - 1 wraps to a large unsigned number.
    inside = params.circular != 0u || (TAPS == 1u ? column : column - 1u) < params.columns;
    return (column + (TAPS == 1u ? 0u : params.columns - 1u)) % params.columns;
}
#endif
