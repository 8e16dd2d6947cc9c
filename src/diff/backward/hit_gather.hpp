// SPDX-License-Identifier: Apache-2.0
// Hit records of the backward pass, sorted by surfel and summed without atomics
// (diff/backward/gather, gather_heads).
#pragma once

#include <memory>

#include <relidar/diff/backward.hpp>

#include "diff/shared/backward.h"
#include "gpu/prefix_sum.hpp"
#include "gpu/radix_sort.hpp"

namespace relidar {

class HitGather {
public:
    /// Creates the kernels.
    /// @param hits_per_ray  capacity in records per ray of the largest batch
    HitGather(Device& device, const ImageModel& model, std::uint32_t hits_per_ray,
              const TraceOptions& options);
    /// Allocates memory for a batch. Records the assignment of slots to rays: one slot
    /// per rendered hit, in the order of rays. Waits if a batch is larger than all
    /// batches before.
    void assign_slots(Stream& stream, const RenderedBatch& batch);
    /// Sets the output addresses of the backward kernel.
    void fill(shared::BackwardParams& params) const;
    /// Sums the records by row into the gradient arrays of `params`.
    void run(Stream& stream, const shared::BackwardParams& params);
    /// Largest number of hits [1] of a batch since the value was reset to 0.
    const Array<std::uint32_t>& most_hits() const { return most_hits_; }
    std::uint64_t capacity() const { return sort_ ? sort_->capacity() : 0; }
    /// Allocates memory for at least this many hits. The device must be idle.
    void reserve(std::uint64_t n_hits);

private:
    Device& device_;
    std::uint32_t hits_per_ray_, part_floats_;
    Kernel<shared::GatherParams> gather_, heads_kernel_;
    Array<std::uint32_t, shared::MostHits> most_hits_;
    Array<std::uint32_t, shared::HitCount> n_hits_;
    Array<std::uint32_t, shared::FirstHits> first_hit_;
    Array<shared::HitRecord> hits_;
    Array<float, shared::RowParts> parts_;
    Array<std::uint32_t, shared::HitRows> rows_[2];    ///< row of each hit, the sort keys
    Array<std::uint32_t, shared::HitSlots> slots_[2];  ///< slots of the hits in sorted order
    PrefixSum prefix_sum_;                             ///< prefix sum over rays
    std::unique_ptr<RadixSort> sort_;                  ///< sorts by row
    std::uint32_t n_rays_ = 0;                         ///< rays of the current batch
};

}  // namespace relidar
