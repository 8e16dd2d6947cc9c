// SPDX-License-Identifier: Apache-2.0
// Hit records of the second cast, their order by surfel, and their sums
// (diff/backward/gather, gather_heads): the way without atomics.
#pragma once

#include <memory>

#include <relidar/diff/backward.hpp>

#include "diff/shared/backward.h"
#include "gpu/prefix_sum.hpp"
#include "gpu/radix_sort.hpp"

namespace relidar {

class HitGather {
public:
    /// @param hits_per_ray  room for records is made for so many a ray of the largest
    /// batch
    HitGather(Device& device, const ImageModel& model, std::uint32_t hits_per_ray,
              const TraceOptions& options);
    /// Makes room for a batch and, in the stream, gives each ray its slots: those of its
    /// rendered hits, in the order of rays. Waits where a batch is larger than any
    /// before.
    void assign_slots(Stream& stream, const RenderedBatch& batch);
    /// Where the second cast writes.
    void fill(shared::BackwardParams& params) const;
    /// Sums the records by row into what the second cast was given for it.
    void run(Stream& stream, const shared::BackwardParams& params);
    /// [1] of the largest batch since it was set to 0
    const Array<std::uint32_t>& most_hits() const { return most_hits_; }
    std::uint64_t capacity() const { return sort_ ? sort_->capacity() : 0; }
    /// Room for so many hits, at least. The device must be idle.
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
    Array<std::uint32_t, shared::HitRows> rows_[2];    ///< sort keys
    Array<std::uint32_t, shared::HitSlots> slots_[2];  ///< where the hits lie
    PrefixSum prefix_sum_;                             ///< over rays
    std::unique_ptr<RadixSort> sort_;                  ///< by row
    std::uint32_t n_rays_ = 0;                         ///< of the present batch
};

}  // namespace relidar
