// SPDX-License-Identifier: Apache-2.0
// Sums the gradients of hits by surfel without atomics. The backward pass writes one
// record per hit, and the records are sorted by surfel.
#pragma once

#include <memory>

#include <relidar/diff/backward.hpp>

#include "diff/shared/backward.h"
#include "gpu/prefix_sum.hpp"
#include "gpu/radix_sort.hpp"

namespace relidar {

class HitGather {
public:
    /// Creates the kernels that sort and sum hit records.
    /// @param hits_per_ray  capacity in records per ray of the largest batch
    HitGather(Device& device, const ImageModel& model, std::uint32_t hits_per_ray,
              const TraceOptions& options);
    /// Assigns record slots to the rays of a batch: one slot per rendered hit, in the
    /// order of rays. Allocates memory, and waits for the device if the batch is larger
    /// than all earlier batches.
    void assign_slots(Stream& stream, const RenderedBatch& batch);
    /// Sets the output addresses of the backward kernel.
    void fill(shared::BackwardParams& params) const;
    /// Adds the gradients of all hit records to the gradient arrays of `params`, row by
    /// row.
    void run(Stream& stream, const shared::BackwardParams& params);
    /// Returns the largest number of hits of a batch, [1] on the device. It counts from
    /// the last reset to 0.
    const Array<std::uint32_t>& most_hits() const { return most_hits_; }
    std::uint64_t capacity() const { return sort_ ? sort_->capacity() : 0; }
    /// Allocates memory for at least `n_hits` hits. The device must be idle.
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
