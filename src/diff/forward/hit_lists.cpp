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

/// Allocates hit lists. Halves the capacity of a list until all lists fit into the device
/// memory. Allocates none if no memory is free.
void HitListTracer::allocate_lists(std::size_t n_lists) {
    // All lists may use one eighth of the device's memory. Assumes 8 GiB of memory if the
    // size is unknown.
    const std::size_t memory_bytes = device_.info().memory_bytes;
    const std::size_t max_list_bytes = (memory_bytes ? memory_bytes : std::size_t(8) << 30) / 8;
    const std::uint32_t n_requested = hits_per_list_;
    hits_ = {};
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

/// Returns true if rays had more hits than their lists can hold. Such rays are slow,
/// because kernel diff/forward/trace must render them again. Reads the count of an
/// earlier submission that is already finished, so that the host never waits here.
bool HitListTracer::has_overflowed(Stream& stream) {
    if (!overflows_.is_pending() ||
        stream.impl().last_ticket + 1 < counted_until_ + Stream::Impl::kMaxPending)
        return false;
    std::uint32_t count = 0;
    std::memcpy(&count, overflows_.wait_for_bytes(stream), sizeof count);
    const std::uint32_t n_overflows = count - std::exchange(overflows_before_, count);
    return grows_ && hits_per_list_ < max_hits_per_list_ && n_overflows > 0;
}

/// Returns memory for one hit list per thread. Uses the hit memory of the backward pass
/// (`kept`) if it is large enough.
shared::HitLists HitListTracer::reserve_lists(Stream& s, std::size_t n_used, const StoredRayHits* kept) {
    const std::size_t n = StoredRayHits::round_up_threads(n_used);
    if (n > kMostLists) return {};
    if (has_overflowed(s)) {
        hits_per_list_ = std::min(2 * hits_per_list_, max_hits_per_list_);
        // Counts overflows of the new capacity from zero.
        s.fill(n_overflows_);
        overflows_before_ = 0;
    }
    const bool uses_kept =
        kept && kept->per_ray >= std::max(hits_per_list_, 1u) && kept->per_ray <= max_hits_per_list_;
    const bool can_reuse_lists =
        allocated_hits_per_list_ == hits_per_list_ && hits_.size() >= n * hits_per_list_;
    // The code below frees old lists. Waits first, because the GPU may still write to
    // them.
    if ((uses_kept ? hits_.size() > 0 : !can_reuse_lists) || lengths_.size() < n) s.submit_and_wait();
    if (uses_kept) hits_ = {};
    else if (!can_reuse_lists)
        allocate_lists(
            // Allocates at least as many lists as before.
            std::max(n, allocated_hits_per_list_ > 0 ? hits_.size() / allocated_hits_per_list_ : 0));
    try {
        if (lengths_.size() < n)
            lengths_ = Array<std::uint32_t, shared::ListLengths>(device_, n, "lengths of lists of hits");
    } catch (const OutOfDeviceMemory&) {  // not enough memory for lists
        return {};
    }
    return {.hits = uses_kept ? kept->hits.address() : hits_.address(),
            .lengths = lengths_.address(),
            .n = std::uint32_t(n_used),
            .room = uses_kept ? kept->per_ray : hits_per_list_};
}

void HitListTracer::record_readback(Stream& stream) {
    if (!grows_ || hits_per_list_ >= max_hits_per_list_ || overflows_.is_pending()) return;
    overflows_.record_copy(stream, n_overflows_.buffer(), sizeof(std::uint32_t));
    counted_until_ = stream.impl().last_ticket + 1;
}

/// Renders the rays with hit lists: fills the lists, sorts each list, and blends its
/// hits. Without memory for lists it does nothing, and kernel diff/forward/trace renders
/// all rays.
void HitListTracer::render(Stream& s, const RayBatch& batch, shared::ForwardParams& p,
                           const StoredRayHits* kept) {
    const std::size_t n = count_threads(batch);
    const shared::HitLists lists = reserve_lists(s, n, kept);
    if (lists.room == 0) return;
    p.lists = lists;
    p.kept_in_lists = kept && hits_.size() == 0 ? 1 : 0;  // lists without separate memory
    relidar::run(s, append_, n, {.scene = p.scene, .lists = lists, .n_overflows = n_overflows_.address()});
    record_readback(s);
    relidar::run(s, sort_, n * std::size_t(device_.info().subgroup_size), {.lists = lists});
    relidar::run(s, blend_, n, p);
}

}  // namespace relidar
