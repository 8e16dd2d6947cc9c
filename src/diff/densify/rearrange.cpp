// SPDX-License-Identifier: Apache-2.0
#include "diff/densify/rearrange.hpp"

#include <algorithm>
#include <utility>

#include "base/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {

/// Allocates all arrays for `n` surfels with the parameters `used`. The statistics are 0.
/// The kernels compute the new order of the surfels, and copy rows to it.
SurfelReorderer::SurfelReorderer(Device& device, std::uint32_t n, std::uint32_t n_frames,
                                 SurfelParameterSet used)
    : device_(device), count_rows_(device, "diff/densify/allot"), copy_rows_(device, "diff/densify/move") {
    scratch_surfels_.primitive = used.primitive;
    scratch_surfels_.bends = used.bends;
    // The frames in which a surfel was visible, one bit per frame, in words of 32 bits.
    statistics.n_words = std::max(1u, (n_frames + 31) / 32);
    reserve_surfels(n);
    Stream stream(device);
    stream.fill(statistics.frames);
    reset_sums(stream);
    stream.submit_and_wait();
}

void SurfelReorderer::reserve_surfels(std::uint32_t n_surfels) {
    // Arrays that are kept between densifications.
    const std::size_t n_words = std::size_t(n_surfels) * statistics.n_words;
    statistics.gradient_sum.reserve(device_, n_surfels, "gradient statistics");
    statistics.n_observing_batches.reserve(device_, n_surfels, "numbers of batches with a surfel");
    statistics.frames.reserve(device_, n_words, "frames in which surfels were visible");
    // Arrays of one densification.
    prefix_sum_.reserve_scratch(device_, n_surfels);
    scratch_surfels_.reserve(device_, n_surfels, "copy of surfels");
    scratch_frames_.reserve(device_, n_words, "copy of frames");
    for (Array<std::uint32_t>* array :
         std::initializer_list<Array<std::uint32_t>*>{&action, &weight, &starts, &n_rows})
        array->reserve(device_, n_surfels, "densification");
}

std::uint32_t SurfelReorderer::capacity() const {
    const std::size_t n = std::min({action.size(), weight.size(), starts.size(), n_rows.size(),
                                    statistics.gradient_sum.size(), statistics.n_observing_batches.size()});
    const std::size_t n_frames =
        std::min(statistics.frames.size(), scratch_frames_.size()) / statistics.n_words;
    return std::min(scratch_surfels_.capacity(), std::uint32_t(std::min(n, n_frames)));
}

/// Returns the size of all arrays of this object, 4 bytes per word. They are the spare
/// parameters, `frames` and its spare array, and six arrays with one word per surfel.
std::size_t SurfelReorderer::bytes_per_surfel() const {
    return 4 * (floats_per_surfel(scratch_surfels_.parameters_used()) + 6 + 2 * statistics.n_words);
}

/// Submits the kernels that compute the new array index of each surfel. A surfel and its
/// copies are consecutive rows of the new arrays. So the index of a surfel is the number
/// of rows of all earlier surfels.
void SurfelReorderer::compute_indices(Stream& stream, const GrowthPlan& plan, std::uint32_t n_before) {
    RELIDAR_ASSERT_LE(std::max(n_before, plan.size()), capacity());
    n_before_ = n_before;
    // First uses `starts` for the sums of the weights of all earlier surfels.
    prefix_sum_.run(stream, {.address = weight.address().cast_tag<shared::ScanCounts>()},
                    starts.address().cast_tag<shared::ScanPrefix>(), n_before);
    // Distributes `n_new` copies in proportion to the weights. Writes the number of rows
    // of each surfel: 0 if it is dropped, otherwise 1 plus its copies.
    run(stream, count_rows_, n_before,
        {.weight = weight.address(),
         .cumulative = starts.address().cast_tag<shared::WeightsBefore>(),
         .action = action.address(),
         .n_rows = n_rows.address(),
         .n_surfels = n_before,
         .n_new = plan.n_new,
         .total_weight = plan.total_weight,
         .phase = plan.phase});
    // The final `starts`: number of rows of all earlier surfels.
    prefix_sum_.run(stream, {.address = n_rows.address().cast_tag<shared::ScanCounts>()},
                    starts.address().cast_tag<shared::ScanPrefix>(), n_before);
}

/// Copies the row of each surfel to its new index and to its copies. With NewRows::zero,
/// the copies of cloned surfels and all parts of split surfels get zeros instead.
/// @param rows [surfels, stride], receives the new order
/// @param spare array of the same size, receives the old order
template <class T>
void SurfelReorderer::move_rows(Stream& stream, Array<T>& rows, Array<T>& spare, std::uint32_t stride,
                                NewRows new_rows) {
    run(stream, copy_rows_, n_before_,
        {.from = rows.template address_as<std::uint32_t, shared::OldRows>(),
         .to = spare.template address_as<std::uint32_t, shared::NewRows>(),
         .action = action.address(),
         .n_rows = n_rows.address(),
         .starts = starts.address(),
         .n_surfels = n_before_,
         .stride = stride,
         .zero_new = new_rows == NewRows::zero ? 1u : 0u});
    std::swap(rows, spare);
}

void SurfelReorderer::move_surfels(Stream& stream, SurfelArrays& surfels, NewRows new_rows,
                                   std::uint32_t n_after) {
    for (const SurfelParameterGroup& group : list_groups(surfels.parameters_used()))
        move_rows(stream, group.mutable_device(surfels), group.mutable_device(scratch_surfels_),
                  group.count_floats(), new_rows);
    surfels.n = n_after;
}

void SurfelReorderer::move_statistics(Stream& stream) {
    move_rows<std::uint32_t>(stream, statistics.frames, scratch_frames_, statistics.n_words, NewRows::copy);
    reset_sums(stream);
}

void SurfelReorderer::reset_sums(Stream& stream) {
    stream.fill(statistics.gradient_sum);
    stream.fill(statistics.n_observing_batches);
}

}  // namespace relidar
