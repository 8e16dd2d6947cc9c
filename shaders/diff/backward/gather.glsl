// SPDX-License-Identifier: Apache-2.0
// Functions of the kernels gather and gather_heads, which sum the gradients of hits by
// surfel. A sum consists of 16 floats. If spherical harmonics (SH) are evaluated per hit,
// it has 48 more floats for their coefficients.
#ifndef RELIDAR_INCLUDED_DIFF_BACKWARD_GATHER_GLSL
#define RELIDAR_INCLUDED_DIFF_BACKWARD_GATHER_GLSL
float sums[16];
float sh_sums[RELIDAR_SH_FLOATS];

uint floats_per_sum() { return SH_PER_SURFEL != 0u ? 16u : 16u + RELIDAR_SH_FLOATS; }
// Hits are sorted by surfel and split into blocks. If a surfel has hits in several
// blocks, kernel gather_heads adds the partial gradient sums of these blocks. Returns the
// index in `parts` of the sum for the surfel that continues from the previous block.
uint first_row_sum(uint block) { return 2u * block * floats_per_sum(); }
// The hits of a surfel may begin in this block and continue in the next block. Returns
// the index in `parts` of the gradient sum over the surfel's hits in this block.
uint last_row_sum(uint block) { return first_row_sum(block) + floats_per_sum(); }
uint n_sorted_hits() { return min(params.n_hits.at[0], params.capacity); }
uint block_end(uint block) { return min((block + 1u) * RELIDAR_GATHER_BLOCK, n_sorted_hits()); }

void clear_sums() {
    for (uint k = 0u; k < 16u; ++k) sums[k] = 0.0;
    if (SH_PER_SURFEL == 0u)
        for (uint k = 0u; k < RELIDAR_SH_FLOATS; ++k) sh_sums[k] = 0.0;
}

/// Adds the sums of this thread to the gradients of one surfel. Only the gradients of
/// spherical harmonics need atomics, because two instances may share the coefficients.
void add_surfel_sums(uint gradient_row, uint instance) {
    for (uint k = 0u; k < 16u; ++k) params.d_records.at[16u * gradient_row + k] += sums[k];
    if (SH_PER_SURFEL != 0u) return;
    InstanceEntry m = params.scene.instances.at[instance];
    uint first = RELIDAR_SH_FLOATS * (gradient_row - m.first_row + m.first_surfel);
    for (uint k = 0u; k < RELIDAR_SH_FLOATS; ++k) atomic_add(params.d_sh, first + k, sh_sums[k]);
}
#endif
