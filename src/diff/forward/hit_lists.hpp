// SPDX-License-Identifier: Apache-2.0
// Forward pass with hit lists: each ray appends its hits to a list, and then the lists
// are sorted and blended. Used only by the forward pass.
#pragma once

#include <memory>

#include <relidar/diff/traversal.hpp>

#include "diff/traversal/trace_scene.hpp"
#include "gpu/stream.hpp"

namespace relidar {

/// Returns true if rays append their hits to lists. A CPU uses an ordered buffer instead,
/// which stays in the cache and is faster than a second launch.
inline bool appends_hits(const Device& device, const TraceOptions& options) {
    return options.order == HitOrder::automatic ? device.info().type != "CPU"
                                                : options.order == HitOrder::lists;
}

/// Returns the largest number of hits that a list may hold. A subgroup of the device must
/// be able to sort the list.
std::uint32_t max_list_capacity(const Device& device);

class HitLists {
public:
    /// Creates the kernels that fill, sort and blend hit lists.
    /// @param constants  constants of the tracing kernels
    /// @param room  initial capacity of a list in hits, limited to the maximum
    HitLists(Device& device, const KernelVariant& variant, const std::vector<Constant>& constants, int room);

    /// Renders the rays of a batch with hit lists. Sets `params.lists`, so that
    /// diff/forward/trace can render the rays whose lists could not be used. If the
    /// device has no memory for lists, diff/forward/trace renders all rays. All calls
    /// must use the same stream.
    /// @param kept  hit storage of `params`. Lists use its memory if it is large enough,
    /// which avoids a copy.
    void run(Stream& stream, const RayBatch& batch, shared::ForwardParams& params,
             const KeptHits* kept = nullptr);
    std::uint32_t room() const { return room_; }  ///< capacity of a list in hits

private:
    Device& device_;
    Kernel<shared::AppendParams> append_;
    Kernel<shared::ForwardParams> blend_;
    Kernel<shared::SortHitsParams> sort_;
    std::uint32_t most_room_, room_;
    bool grows_ = true;
    Array<shared::Hit> hits_;      ///< empty if lists use the memory of kept hits
    std::uint32_t hits_room_ = 0;  ///< capacity of a list in `hits_`
    Array<std::uint32_t, shared::ListLengths> lengths_;
    Array<std::uint32_t, shared::OverflowCount> n_overflows_;
    Readback overflows_;
    std::uint64_t counted_until_ = 0;     ///< ticket of the submission that reads the count
    std::uint32_t overflows_before_ = 0;  ///< overflow count that was read before

    void make_hits(std::size_t n_lists);
    shared::HitLists make_room(Stream& stream, std::size_t n_threads, const KeptHits* kept);
    bool needs_more_room(Stream& stream);
    void count_overflows(Stream& stream);
};

}  // namespace relidar
