// SPDX-License-Identifier: Apache-2.0
// Arrays of a densification, and the move of all per-surfel arrays into the new order.
// One spare set of arrays is swapped with each set in turn. Private to densify.
#pragma once

#include <relidar/diff/densify.hpp>

#include "diff/densify/growth_plan.hpp"
#include "diff/shared/densify.h"
#include "gpu/prefix_sum.hpp"

namespace relidar {

class Rearrangement {
public:
    Rearrangement(Device& device, std::uint32_t n_surfels, std::uint32_t n_frames, ParameterSet of);
    /// Allocates memory for a number of surfels. No commands may be pending.
    /// @throws DeviceError if memory is exhausted; the data stays valid
    void reserve(std::uint32_t capacity);
    std::uint32_t capacity() const;
    /// Returns the memory per surfel in bytes.
    std::size_t bytes_per_surfel() const;
    /// Records the distribution of copies and the new position of each row, from `action`
    /// and `weight`.
    void allot(Stream& stream, const GrowthPlan& plan, std::uint32_t before);
    /// Records the move of a set of arrays into the new order.
    /// @param fresh  as in shared::MoveParams
    /// @param after  number of surfels after the move
    void move(Stream& stream, SurfelArrays& set, bool fresh, std::uint32_t after);
    /// Records the move of the statistics and resets them. Keeps only the frames in which
    /// a surfel was visible.
    void move_statistics(Stream& stream);
    /// Records zeros in sums and counts.
    void start_over(Stream& stream);

    SurfelStatistics statistics;
    // [n] in the old order
    Array<std::uint32_t, shared::DensifyActions> action;
    Array<std::uint32_t, shared::GrowthWeights> weight;
    /// holds the cumulative weights before the row starts
    Array<std::uint32_t, shared::RowStarts> starts;
    Array<std::uint32_t, shared::RowCounts> n_rows;

private:
    Device& device_;
    SurfelArrays spare_;
    Array<std::uint32_t> spare_frames_;
    PrefixSum prefix_sum_;
    Kernel<shared::AllotParams> allot_;
    Kernel<shared::MoveParams> move_;
    std::uint32_t before_ = 0;

    template <class T>
    void move_rows(Stream& stream, Array<T>& rows, Array<T>& spare, std::uint32_t stride, bool fresh);
};

}  // namespace relidar
