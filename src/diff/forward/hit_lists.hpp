// SPDX-License-Identifier: Apache-2.0
// Forward pass in which each ray writes its hits to a list. Then kernels sort the lists.
#pragma once

#include <relidar/diff/traversal.hpp>

#include "diff/traversal/trace_scene.hpp"
#include "gpu/stream.hpp"

namespace relidar {

/// Returns true if rays write their hits to lists in global memory. On a CPU, a small
/// sorted buffer per ray is faster: it stays in the cache and needs no second kernel.
inline bool uses_hit_lists(const Device& device, const TraceOptions& options) {
    return options.order == HitSortMethod::automatic ? device.info().type != "CPU"
                                                     : options.order == HitSortMethod::lists;
}

/// Returns the maximum number of hits in a list. A single subgroup of the device can sort
/// at most this many hits.
std::uint32_t max_list_hits(const Device& device);

class HitListTracer {
public:
    /// Creates the kernels that fill, sort and blend hit lists.
    /// @param constants specialisation constants of the tracing kernels
    /// @param capacity initial capacity of a list in hits, limited to the maximum
    HitListTracer(Device& device, const KernelVariant& variant, const TraceConstants& constants,
                  int capacity);

    /// Renders the rays of a batch with hit lists. Sets `params.lists`. Kernel
    /// diff/forward/trace must run afterwards for the rays whose lists cannot be used.
    /// All calls must use the same stream.
    /// @param kept memory of the hits for the backward pass. Lists use it if possible
    void render(Stream& stream, const RayBatch& batch, shared::ForwardParams& params,
                const StoredRayHits* kept);
    std::uint32_t capacity() const { return hits_per_list_; }  ///< capacity of a list in hits

private:
    Device& device_;
    Kernel<shared::AppendParams> append_;
    Kernel<shared::ForwardParams> blend_;
    Kernel<shared::SortHitsParams> sort_;
    std::uint32_t max_hits_per_list_ = max_list_hits(device_), hits_per_list_;
    bool grows_ = true;                          ///< false after an allocation has failed
    Array<shared::Hit> hits_;                    ///< empty if lists use the memory of stored hits
    std::uint32_t allocated_hits_per_list_ = 0;  ///< capacity of a list in `hits_`
    Array<std::uint32_t, shared::ListLengths> lengths_;
    Array<std::uint32_t, shared::OverflowCount> n_overflows_{
        device_, std::vector<std::uint32_t>{0u}, "number of rays with more hits than a hit list can store"};
    ReadbackBuffer overflows_{device_, sizeof(std::uint32_t), "number of rays with too many hits"};
    std::uint64_t readback_ticket_ = 0;   ///< submission that copies the count to the host
    std::uint32_t overflows_before_ = 0;  ///< overflow count at the previous check

    bool can_grow() const { return grows_ && hits_per_list_ < max_hits_per_list_; }
    void reserve_hits(Stream& stream, std::size_t n_lists);
    bool reserve_lengths(Stream& stream, std::size_t n_lists);
    void grow_lists(Stream& stream);
    shared::HitLists reserve_lists(Stream& stream, std::size_t n_threads, const StoredRayHits* kept);
    std::uint32_t count_overflows(Stream& stream);
    void record_readback(Stream& stream);
};

}  // namespace relidar
