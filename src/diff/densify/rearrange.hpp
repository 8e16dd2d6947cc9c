// SPDX-License-Identifier: Apache-2.0
// Owns the arrays of a densification, and moves all arrays of surfels into the new order.
// Moves one set of arrays at a time into a spare set and swaps both. Used only by
// densify.
#pragma once

#include <relidar/diff/densify.hpp>

#include "diff/densify/growth_plan.hpp"
#include "diff/shared/densify.h"
#include "gpu/prefix_sum.hpp"

namespace relidar {

class Rearrangement {
public:
    Rearrangement(Device& device, std::uint32_t n_surfels, std::uint32_t n_frames, ParameterSet of);
    /// Allocates memory for a number of surfels. No commands may be pending on the
    /// device.
    /// @throws DeviceError if memory is exhausted. The data stays valid.
    void reserve(std::uint32_t capacity);
    std::uint32_t capacity() const;
    /// Returns the memory per surfel in bytes.
    std::size_t bytes_per_surfel() const;
    /// Submits the kernels that distribute the copies and compute the new position of
    /// each row, from `action` and `weight`.
    void allot(Stream& stream, const GrowthPlan& plan, std::uint32_t before);
    /// Submits the kernels that move a set of arrays into the new order.
    /// @param fresh  true: rows of new and changed surfels become zero
    /// @param after  number of surfels after the move
    void move(Stream& stream, SurfelArrays& set, bool fresh, std::uint32_t after);
    /// Submits the kernels that move the statistics into the new order and reset them.
    /// Keeps only the frames in which each surfel was visible.
    void move_statistics(Stream& stream);
    /// Submits commands that reset the sums of gradient norms and the counts to zero.
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
