// SPDX-License-Identifier: Apache-2.0
// Submits the kernels diff/densify/allot and diff/densify/move, which distribute copies
// and move surfels to their new rows.
#include "diff/densify/rearrange.hpp"

#include <algorithm>
#include <utility>

#include "base/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {

Rearrangement::Rearrangement(Device& device, std::uint32_t n_surfels, std::uint32_t n_frames,
                             ParameterSet parameter_set)
    : device_(device),
      prefix_sum_(device),
      allot_(device, "diff/densify/allot"),
      move_(device, "diff/densify/move") {
    spare_.primitive = parameter_set.primitive, spare_.bends = parameter_set.bends;
    statistics.n_words = std::max(1u, (n_frames + 31) / 32);
    reserve(n_surfels);
    Stream stream(device);
    stream.fill(statistics.frames);
    reset_gradient_sums(stream);
    stream.finish();
}

void Rearrangement::reserve(std::uint32_t count) {
    const std::size_t n_words = std::size_t(count) * statistics.n_words;
    prefix_sum_.reserve(device_, count);
    spare_.reserve(device_, count, "spare surfel");
    statistics.gradient_sum.reserve(device_, count, "gradient statistics");
    statistics.n_seen.reserve(device_, count, "seen batches");
    statistics.frames.reserve(device_, n_words, "seen frames");
    spare_frames_.reserve(device_, n_words, "spare seen frames");
    for (Array<std::uint32_t>* array :
         std::initializer_list<Array<std::uint32_t>*>{&action, &weight, &starts, &n_rows})
        array->reserve(device_, count, "densification");
}

std::uint32_t Rearrangement::capacity() const {
    const std::size_t n = std::min({action.size(), weight.size(), starts.size(), n_rows.size(),
                                    statistics.gradient_sum.size(), statistics.n_seen.size()});
    const std::size_t n_frames =
        std::min(statistics.frames.size(), spare_frames_.size()) / statistics.n_words;
    return std::min(spare_.capacity(), static_cast<std::uint32_t>(std::min(n, n_frames)));
}

std::size_t Rearrangement::bytes_per_surfel() const {
    return 4 * (count_floats_per_surfel(spare_.parameters()) + 6 + 2 * statistics.n_words);
}

void Rearrangement::assign_new_positions(Stream& stream, const GrowthPlan& plan,
                                         std::uint32_t n_surfels_before) {
    RELIDAR_ASSERT_LE(std::max(n_surfels_before, plan.size()), capacity());
    before_ = n_surfels_before;
    prefix_sum_.run(stream, {.address = weight.address().as<shared::ScanCounts>()},
                    starts.address().as<shared::ScanPrefix>(), n_surfels_before);
    run(stream, allot_, n_surfels_before,
        {.weight = weight.address(),
         .cumulative = starts.address().as<shared::WeightsBefore>(),
         .action = action.address(),
         .n_rows = n_rows.address(),
         .n_surfels = n_surfels_before,
         .n_new = plan.n_new,
         .total_weight = plan.total_weight,
         .phase = plan.phase});
    prefix_sum_.run(stream, {.address = n_rows.address().as<shared::ScanCounts>()},
                    starts.address().as<shared::ScanPrefix>(), n_surfels_before);
}

template <class T>
void Rearrangement::move_rows(Stream& stream, Array<T>& rows, Array<T>& spare, std::uint32_t stride,
                              bool fresh) {
    run(stream, move_, before_,
        {.from = rows.template address_as<std::uint32_t, shared::OldRows>(),
         .to = spare.template address_as<std::uint32_t, shared::NewRows>(),
         .action = action.address(),
         .n_rows = n_rows.address(),
         .starts = starts.address(),
         .n_surfels = before_,
         .stride = stride,
         .fresh = fresh ? 1u : 0u});
    std::swap(rows, spare);
}

void Rearrangement::move(Stream& stream, SurfelArrays& set, bool fresh, std::uint32_t n_surfels_after) {
    for (const ParameterGroup& group : list_parameter_groups(set.parameters()))
        move_rows(stream, group.mutable_device(set), group.mutable_device(spare_), group.floats(), fresh);
    set.n = n_surfels_after;
}

void Rearrangement::move_statistics(Stream& stream) {
    move_rows<std::uint32_t>(stream, statistics.frames, spare_frames_, statistics.n_words, false);
    reset_gradient_sums(stream);
}

void Rearrangement::reset_gradient_sums(Stream& stream) {
    stream.fill(statistics.gradient_sum);
    stream.fill(statistics.n_seen);
}

}  // namespace relidar
