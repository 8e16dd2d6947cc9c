// SPDX-License-Identifier: Apache-2.0
// Moves the rows of all surfel arrays to their new order after a densification. Moves one
// set of arrays at a time into spare arrays, and then swaps both sets.
#pragma once

#include <relidar/diff/densify.hpp>

#include "diff/densify/growth_plan.hpp"
#include "diff/shared/densify.h"
#include "gpu/prefix_sum.hpp"

namespace relidar {

/// Values of the copies of cloned surfels and of the parts of split surfels: those of the
/// original surfel, or zeros.
enum class NewRows { copy, zero };

class SurfelReorderer {
public:
    SurfelReorderer(Device& device, std::uint32_t n, std::uint32_t n_frames, SurfelParameterSet used);
    /// Enlarges all arrays to at least `n_surfels` surfels. The device must be idle. If
    /// memory is exhausted, throws DeviceError and keeps the data.
    void reserve_surfels(std::uint32_t n_surfels);
    std::uint32_t capacity() const;
    std::size_t bytes_per_surfel() const;
    /// Computes the new index of each surfel from `action` and `weight`.
    void compute_indices(Stream& stream, const GrowthPlan& plan, std::uint32_t n_before);
    /// Moves the parameters of all surfels to the new indices.
    /// @param n_after new number of surfels
    void move_surfels(Stream& stream, SurfelArrays& surfels, NewRows new_rows, std::uint32_t n_after);
    /// Resets all statistics except the frames in which a surfel was visible.
    void move_statistics(Stream& stream);
    void reset_sums(Stream& stream);

    SurfelStatistics statistics;
    // [n] action of each surfel, in the old order
    Array<std::uint32_t, shared::DensifyActions> action;
    /// [n] share of each surfel in the new copies, 0 if it does not grow
    Array<std::uint32_t, shared::GrowthWeights> weight;
    /// [n] index of each surfel after the densification. Its copies get the next indices.
    /// Before, compute_indices() uses this array for the prefix sums of `weight`.
    Array<std::uint32_t, shared::RowStarts> starts;
    /// [n] number of surfels that replace a surfel: 0 (dropped), 1, or more (with copies)
    Array<std::uint32_t, shared::RowCounts> n_rows;

private:
    Device& device_;
    SurfelArrays scratch_surfels_;
    Array<std::uint32_t> scratch_frames_;
    PrefixSum prefix_sum_{device_};
    Kernel<shared::AllotParams> count_rows_;
    Kernel<shared::MoveParams> copy_rows_;
    std::uint32_t n_before_ = 0;  ///< number of surfels before the densification

    template <class T>
    void move_rows(Stream& stream, Array<T>& rows, Array<T>& spare, std::uint32_t stride, NewRows new_rows);
};

}  // namespace relidar
