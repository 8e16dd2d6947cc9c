// SPDX-License-Identifier: Apache-2.0
// The forward pass by lists: rays append what they meet, lists are sorted, then blended.
// Private to forward.
#pragma once

#include <memory>

#include <relidar/diff/traversal.hpp>

#include "diff/traversal/trace_scene.hpp"
#include "gpu/stream.hpp"

namespace relidar {

/// Whether rays append their hits to lists. On a CPU an ordered buffer lies in the cache
/// and costs less than a second launch.
inline bool appends_hits(const Device& device, const TraceOptions& options) {
    return options.order == HitOrder::automatic ? device.info().type != "CPU"
                                                : options.order == HitOrder::lists;
}

/// Hits that a list may have room for, so that the lanes of a subgroup can sort it.
std::uint32_t most_list_room(const Device& device);

class HitLists {
public:
    /// @param constants  of the tracing kernels @param room  hits that a list has room
    /// for at first; more than there may be: as many
    HitLists(Device& device, const KernelVariant& variant, const std::vector<Constant>& constants, int room);

    /// Renders the rays of a batch whose lists are fit, and fills `params.lists`, by
    /// which diff/forward/trace knows the others. Where the device has no memory for
    /// lists it stays empty: then these are all rays. One stream alone may be given.
    /// @param kept  of `params`: lists are made in its memory where they find room there,
    /// and need not be copied
    void run(Stream& stream, const RayBatch& batch, shared::ForwardParams& params,
             const KeptHits* kept = nullptr);
    std::uint32_t room() const { return room_; }  ///< hits that a list has room for

private:
    Device& device_;
    Kernel<shared::AppendParams> append_;
    Kernel<shared::ForwardParams> blend_;
    Kernel<shared::SortHitsParams> sort_;
    std::uint32_t most_room_, room_;
    bool grows_ = true;
    Array<shared::Hit> hits_;      ///< empty where lists are in the memory of kept hits
    std::uint32_t hits_room_ = 0;  ///< of a list there
    Array<std::uint32_t, shared::ListLengths> lengths_;
    Array<std::uint32_t, shared::OverflowCount> n_overflows_;
    Readback overflows_;
    std::uint64_t counted_until_ = 0;     ///< ticket of the submission that reads the count back
    std::uint32_t overflows_before_ = 0;  ///< what was read last

    void make_hits(std::size_t n_lists);
    shared::HitLists make_room(Stream& stream, std::size_t n_threads, const KeptHits* kept);
    bool wants_more_room(Stream& stream);
    void count_overflows(Stream& stream);
};

}  // namespace relidar
