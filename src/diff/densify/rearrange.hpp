// SPDX-License-Identifier: Apache-2.0
// The arrays of a densification and the move of everything that belongs to a surfel into
// its new order, through one spare set of arrays that takes the place of each set in
// turn. Private to densify.
#pragma once

#include <relidar/diff/densify.hpp>

#include "diff/densify/growth_plan.hpp"
#include "diff/shared/densify.h"
#include "gpu/prefix_sum.hpp"

namespace relidar {

class Rearrangement {
public:
    Rearrangement(Device& device, std::uint32_t n_surfels, std::uint32_t n_frames, ParameterSet of);
    /// Makes room for so many surfels. Nothing may be in flight. @throws DeviceError
    /// where memory is exhausted: nothing is lost
    void reserve(std::uint32_t capacity);
    std::uint32_t capacity() const;
    /// Bytes held a surfel.
    std::size_t bytes_per_surfel() const;
    /// Records who gets copies and where each row goes, from `action` and `weight`.
    void allot(Stream& stream, const GrowthPlan& plan, std::uint32_t before);
    /// Records the move of a set into its new order; the sizes are the plan's afterwards.
    /// @param fresh as in shared::MoveParams
    void move(Stream& stream, SurfelArrays& set, bool fresh, std::uint32_t after);
    /// Records the move of the statistics, which then start over: only in which frames a
    /// surfel was seen is kept.
    void move_statistics(Stream& stream);
    /// Records zeros in sums and counts.
    void start_over(Stream& stream);

    SurfelStatistics statistics;
    // [n] before
    Array<std::uint32_t, shared::DensifyActions> action;
    Array<std::uint32_t, shared::GrowthWeights> weight;
    Array<std::uint32_t, shared::RowStarts> starts;  ///< holds the cumulative weights first
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
