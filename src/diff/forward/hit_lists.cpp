// SPDX-License-Identifier: Apache-2.0
#include "diff/forward/hit_lists.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include <relidar/gpu/out_of_memory.hpp>

namespace relidar {
namespace {

using enum SpecialisationConstantId;

// Maximum number of hit lists (one per ray). One subgroup sorts each list, so more lists
// could need more than 2^32 threads in a launch.
constexpr std::size_t kMostLists = std::size_t(1) << 24;

Kernel<shared::SortHitsParams> make_sort_kernel(Device& device) {
    const auto lanes = std::uint32_t(device.info().subgroup_size);
    return {device,
            KernelName<shared::SortHitsParams>("diff/forward/sort_hits"),
            {{LANES, lanes}, {WORKGROUP_SIZE, RELIDAR_SORTED_TOGETHER * lanes}},
            SubgroupRequirement::full};
}

}  // namespace

std::uint32_t max_list_hits(const Device& device) {
    return std::min<std::uint32_t>(RELIDAR_MOST_ROOM,
                                   RELIDAR_MOST_HELD * std::uint32_t(device.info().subgroup_size));
}

HitListTracer::HitListTracer(Device& device, const KernelVariant& variant, const TraceConstants& constants,
                             int capacity)
    : device_(device),
      append_(device, "diff/forward/append", variant, constants),
      blend_(device, "diff/forward/blend", constants),
      sort_(make_sort_kernel(device)),
      hits_per_list_(std::min(std::uint32_t(capacity), max_hits_per_list_)) {}

/// Ensures that `hits_` has enough lists. Halves the capacity of a list until all lists
/// fit into the device memory. Allocates none if no memory is free.
void HitListTracer::reserve_hits(Stream& stream, std::size_t n_lists) {
    if (allocated_hits_per_list_ == hits_per_list_ && hits_.size() >= n_lists * hits_per_list_) return;
    // Keeps as many lists as before, so that smaller batches cause no reallocation.
    if (allocated_hits_per_list_ > 0) n_lists = std::max(n_lists, hits_.size() / allocated_hits_per_list_);
    stream.submit_and_wait();  // the GPU may still use the old lists
    hits_ = {};
    // All lists may use one eighth of the device's memory. Assumes 8 GiB of memory if the
    // size is unknown.
    const std::size_t memory_bytes = device_.info().memory_bytes;
    const std::size_t max_list_bytes = (memory_bytes ? memory_bytes : std::size_t(8) << 30) / 8;
    const std::uint32_t n_requested = hits_per_list_;
    for (; hits_per_list_ > 0; hits_per_list_ /= 2) {
        if (n_lists * hits_per_list_ * sizeof(shared::Hit) > max_list_bytes) continue;
        try {
            hits_ = Array<shared::Hit>(device_, n_lists * hits_per_list_, "lists of hits");
            break;
        } catch (const OutOfDeviceMemory&) {  // not enough memory for this capacity
        }
    }
    allocated_hits_per_list_ = hits_per_list_;
    if (hits_per_list_ < n_requested) grows_ = false;
}

/// Returns how many rays had more hits than their lists can hold, since the last count
/// that was read. Such rays are slow, because kernel diff/forward/trace must render them
/// again. Never waits: returns 0 while the copy of the next count is pending.
std::uint32_t HitListTracer::count_overflows(Stream& stream) {
    // A stream has at most kMaxPending unfinished submissions. So the submission that
    // copied the count is finished if that many submissions followed.
    const bool is_finished = stream.impl().last_ticket + 1 >= readback_ticket_ + Stream::Impl::kMaxPending;
    if (!overflows_.is_pending() || !is_finished) return 0;
    std::uint32_t count = 0;
    std::memcpy(&count, overflows_.wait_for_bytes(stream), sizeof count);
    return count - std::exchange(overflows_before_, count);
}

/// Doubles the capacity of new lists, and counts their overflows from zero.
void HitListTracer::grow_lists(Stream& stream) {
    hits_per_list_ = std::min(2 * hits_per_list_, max_hits_per_list_);
    stream.fill(n_overflows_);
    overflows_before_ = 0;
}

/// Ensures that `lengths_` has enough entries.
/// @return false if there is not enough memory
bool HitListTracer::reserve_lengths(Stream& stream, std::size_t n_lists) {
    if (lengths_.size() >= n_lists) return true;
    stream.submit_and_wait();
    try {
        lengths_ = Array<std::uint32_t, shared::ListLengths>(device_, n_lists, "lengths of lists of hits");
    } catch (const OutOfDeviceMemory&) {
        return false;
    }
    return true;
}

/// Returns memory for one hit list per thread. The lists have room for 0 hits if no
/// memory is available.
/// @param kept memory for hits that the backward pass reads, or null. Lists use it if
/// possible, because their hits then need no copy
shared::HitLists HitListTracer::reserve_lists(Stream& stream, std::size_t n_threads,
                                              const StoredRayHits* kept) {
    const std::size_t n_lists = StoredRayHits::round_up_threads(n_threads);
    if (n_lists > kMostLists) return {};
    if (count_overflows(stream) > 0 && can_grow()) grow_lists(stream);
    // The kept memory of a ray must have room for a full list, but not for more hits than
    // a subgroup can sort.
    const bool uses_kept =
        kept && kept->per_ray >= std::max(hits_per_list_, 1u) && kept->per_ray <= max_hits_per_list_;
    if (!uses_kept) {
        reserve_hits(stream, n_lists);
    } else if (hits_.size() > 0) {
        stream.submit_and_wait();
        hits_ = {};
    }
    if (!reserve_lengths(stream, n_lists)) return {};
    return {.hits = uses_kept ? kept->hits.address() : hits_.address(),
            .lengths = lengths_.address(),
            .n = std::uint32_t(n_threads),
            .room = uses_kept ? kept->per_ray : hits_per_list_};
}

/// Starts to copy the number of overflows to the host, unless the capacity cannot grow or
/// an earlier copy was not read yet.
void HitListTracer::record_readback(Stream& stream) {
    if (!can_grow() || overflows_.is_pending()) return;
    overflows_.record_copy(stream, n_overflows_.buffer(), sizeof(std::uint32_t));
    readback_ticket_ = stream.impl().last_ticket + 1;
}

/// Renders the rays with hit lists. Without memory for lists it does nothing, and kernel
/// diff/forward/trace renders all rays.
void HitListTracer::render(Stream& stream, const RayBatch& batch, shared::ForwardParams& params,
                           const StoredRayHits* kept) {
    const std::size_t n_threads = count_threads(batch);
    const shared::HitLists lists = reserve_lists(stream, n_threads, kept);
    if (lists.room == 0) return;
    params.lists = lists;
    // If the lists use the memory of `kept`, the blending need not copy the hits to it.
    const bool lists_are_kept = kept && lists.hits == kept->hits.address();
    params.kept_in_lists = lists_are_kept ? 1 : 0;
    // Each thread appends the hits of its ray to its list, in any order.
    relidar::run(stream, append_, n_threads,
                 {.scene = params.scene, .lists = lists, .n_overflows = n_overflows_.address()});
    record_readback(stream);  // of the overflows, which later decide whether lists grow
    const auto threads_per_list = std::size_t(device_.info().subgroup_size);
    relidar::run(stream, sort_, n_threads * threads_per_list, {.lists = lists});
    relidar::run(stream, blend_, n_threads, params);
}

}  // namespace relidar
