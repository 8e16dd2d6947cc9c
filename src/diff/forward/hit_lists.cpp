// SPDX-License-Identifier: Apache-2.0
// Host side of rendering with hit lists: submits kernels that fill, sort and blend the
// lists. Increases the capacity of the lists if rays have more hits.
#include "diff/forward/hit_lists.hpp"

#include <algorithm>
#include <cstring>
#include <utility>

#include <relidar/base/error.hpp>
#include <relidar/gpu/out_of_memory.hpp>

namespace relidar {
namespace {

// Maximum number of lists. Each list is sorted by one subgroup, and a launch can have at
// most 2^32 threads.
constexpr std::size_t kMostLists = std::size_t(1) << 24;

/// Returns the maximum size of all hit lists in bytes: one eighth of the device's memory.
/// Assumes 8 GiB of memory if the size is unknown.
std::size_t compute_max_bytes(const Device& device) {
    const std::size_t memory = device.info().memory_bytes;
    return (memory ? memory : std::size_t(8) << 30) / 8;
}

Kernel<shared::SortHitsParams> make_sort_kernel(Device& device) {
    const auto lanes = static_cast<std::uint32_t>(device.info().subgroup_size);
    return {device,
            KernelName<shared::SortHitsParams>("diff/forward/sort_hits"),
            {{ConstantId::LANES, lanes}, {ConstantId::WORKGROUP_SIZE, RELIDAR_SORTED_TOGETHER * lanes}},
            Subgroups::full};
}

std::size_t compute_list_bytes(std::size_t n_lists, std::uint32_t capacity) {
    return n_lists * capacity * sizeof(shared::Hit);
}

}  // namespace

std::uint32_t compute_max_list_capacity(const Device& device) {
    return std::min<std::uint32_t>(
        RELIDAR_MOST_ROOM, RELIDAR_MOST_HELD * static_cast<std::uint32_t>(device.info().subgroup_size));
}

HitLists::HitLists(Device& device, const KernelVariant& variant, const std::vector<Constant>& constants,
                   int room)
    : device_(device),
      append_(device, "diff/forward/append", variant, constants),
      blend_(device, "diff/forward/blend", constants),
      sort_(make_sort_kernel(device)),
      most_room_(compute_max_list_capacity(device)),
      room_(std::min(static_cast<std::uint32_t>(room), most_room_)),
      n_overflows_(device, std::vector<std::uint32_t>{0u}, "rays with more hits than fit into their lists"),
      overflows_(device, sizeof(std::uint32_t), "rays with more hits than fit into their lists") {}

/// Allocates hit lists. Halves the capacity of a list until all lists fit into the device
/// memory. Allocates none if no memory is free.
void HitLists::allocate_hit_lists(std::size_t n_lists) {
    const std::uint32_t wanted = room_;
    hits_ = {};
    for (; room_ > 0; room_ /= 2) {
        if (compute_list_bytes(n_lists, room_) > compute_max_bytes(device_)) continue;
        try {
            hits_ = Array<shared::Hit>(device_, n_lists * room_, "lists of hits");
            break;
        } catch (const OutOfDeviceMemory&) {  // not enough memory for this capacity
        }
    }
    hits_room_ = room_;
    if (room_ < wanted) grows_ = false;
}

/// Returns true if rays had more hits than their lists can contain. Such rays are slow,
/// because kernel diff/forward/trace must render them again. Reads the count of an
/// earlier submission that is already finished, so that the host never waits here.
bool HitLists::has_overflowed(Stream& stream) {
    if (!overflows_.pending() || stream.impl().last_ticket + 1 < counted_until_ + Stream::Impl::kSlots)
        return false;
    std::uint32_t count = 0;
    std::memcpy(&count, overflows_.wait(stream), sizeof count);
    const std::uint32_t n_overflows = count - std::exchange(overflows_before_, count);
    return grows_ && room_ < most_room_ && n_overflows > 0;
}

/// Returns memory for hit lists. Lists share the memory of the hits that are stored for
/// the backward pass if it is large enough.
shared::HitLists HitLists::reserve_hit_lists(Stream& stream, std::size_t n_threads, const KeptHits* kept) {
    const std::size_t n = KeptHits::side_by_side(n_threads);
    if (n > kMostLists) return {};
    if (has_overflowed(stream)) {
        room_ = std::min(2 * room_, most_room_);
        // Starts the overflow count again, because it was measured with a smaller
        // capacity.
        stream.fill(n_overflows_);
        overflows_before_ = 0;
    }
    const bool in_kept = kept && kept->per_ray >= std::max(room_, 1u) && kept->per_ray <= most_room_;
    const bool room_fits = hits_room_ == room_ && hits_.size() >= n * room_;
    // The device may still write to the lists that are freed below.
    if ((in_kept ? hits_.size() > 0 : !room_fits) || lengths_.size() < n) stream.finish();
    if (in_kept) hits_ = {};
    // allocates at least as many lists as before
    else if (!room_fits) allocate_hit_lists(std::max(n, hits_room_ > 0 ? hits_.size() / hits_room_ : 0));
    try {
        if (lengths_.size() < n)
            lengths_ = Array<std::uint32_t, shared::ListLengths>(device_, n, "lengths of lists of hits");
    } catch (const OutOfDeviceMemory&) {  // not enough memory for lists
        return {};
    }
    const std::uint32_t room = in_kept ? kept->per_ray : room_;
    return {.hits = in_kept ? kept->hits.address() : hits_.address(),
            .lengths = lengths_.address(),
            .n = static_cast<std::uint32_t>(n_threads),
            .room = room};
}

void HitLists::count_overflows(Stream& stream) {
    if (!grows_ || room_ >= most_room_ || overflows_.pending()) return;
    overflows_.record(stream, n_overflows_.buffer(), sizeof(std::uint32_t));
    counted_until_ = stream.impl().last_ticket + 1;
}

void HitLists::run(Stream& stream, const RayBatch& batch, shared::ForwardParams& params,
                   const KeptHits* kept) {
    const std::size_t n = count_trace_threads(batch);
    const shared::HitLists lists = reserve_hit_lists(stream, n, kept);
    if (lists.room == 0) return;
    params.lists = lists;
    params.kept_in_lists = kept && hits_.size() == 0 ? 1 : 0;  // lists without separate memory
    relidar::run(stream, append_, n,
                 {.scene = params.scene, .lists = lists, .n_overflows = n_overflows_.address()});
    count_overflows(stream);
    relidar::run(stream, sort_, n * static_cast<std::size_t>(device_.info().subgroup_size), {.lists = lists});
    relidar::run(stream, blend_, n, params);
}

}  // namespace relidar
