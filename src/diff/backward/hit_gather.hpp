// SPDX-License-Identifier: Apache-2.0
// Sums the gradients of hits by surfel without atomics. The backward pass writes one
// record per hit. Then kernels sort the records by surfel and sum them.
#pragma once

#include <memory>

#include <relidar/diff/backward.hpp>

#include "diff/shared/backward.h"
#include "gpu/prefix_sum.hpp"
#include "gpu/radix_sort.hpp"

namespace relidar {

class HitGather {
public:
    /// @param n number of hits per ray for which memory is allocated
    HitGather(Device& device, const ImageModel& model, std::uint32_t n, const TraceOptions& options);
    /// Assigns a record index to each rendered hit, in the order of the rays. If the
    /// batch is larger than all earlier batches, waits for the device and allocates
    /// memory.
    void assign_records(Stream& stream, const RenderedBatch& batch);
    void set_addresses(shared::BackwardParams& params) const;
    void sum_gradients(Stream& stream, const shared::BackwardParams& params);
    /// Returns an array with one number on the device: the maximum number of hits in any
    /// batch so far. The host can reset this number to 0.
    const Array<std::uint32_t>& max_hits() const { return most_hits_; }
    std::uint64_t hit_capacity() const { return sort_ ? sort_->capacity() : 0; }
    /// The device must be idle.
    void reserve_records(std::uint64_t n_hits);

private:
    Device& device_;
    std::uint32_t hits_per_ray_, part_floats_;
    Kernel<shared::GatherParams> gather_, heads_kernel_;
    Array<std::uint32_t, shared::MostHits> most_hits_{device_, std::vector<std::uint32_t>{0u},
                                                      "largest number of hits in a batch"};
    Array<std::uint32_t, shared::HitCount> n_hits_{device_, 1, "hits of a batch"};
    Array<std::uint32_t, shared::FirstHits> first_hit_;
    Array<shared::HitRecord> hits_;
    Array<float, shared::RowParts> parts_;
    Array<std::uint32_t, shared::HitRows> rows_[2];    ///< sort key of each hit: the row of its gradient
    Array<std::uint32_t, shared::HitSlots> slots_[2];  ///< record index of each hit, in sorted order
    PrefixSum prefix_sum_{device_};                    ///< counts the hits of earlier rays
    std::unique_ptr<RadixSort> sort_;                  ///< sorts the hits by row
    std::uint32_t n_rays_ = 0;                         ///< number of rays of the current batch
};

}  // namespace relidar
