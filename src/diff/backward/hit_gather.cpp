// SPDX-License-Identifier: Apache-2.0
#include "diff/backward/hit_gather.hpp"

#include <algorithm>
#include <bit>
#include <cstddef>

#include "gpu/stream.hpp"

namespace relidar {
namespace {

using enum SpecialisationConstantId;

std::vector<SpecialisationConstant> gather_constants(const ImageModel& model, const TraceOptions& options) {
    return {{SH_PER_SURFEL, model.sh_direction == ShDirection::surfel ? 1u : 0u},
            {SINGLE_DROP_LOGIT, model.single_drop_logit ? 1u : 0u},
            {PRIMITIVE, std::uint32_t(model.primitive)},
            {LIKELIHOOD, options.likelihood ? 1u : 0u}};
}

}  // namespace

HitGather::HitGather(Device& device, const ImageModel& model, std::uint32_t n, const TraceOptions& options)
    : device_(device),
      hits_per_ray_(n),
      part_floats_(model.sh_direction == ShDirection::surfel ? 16u : 16u + RELIDAR_SH_FLOATS),
      gather_(device, "diff/backward/gather", atomic_variant(device), gather_constants(model, options)),
      heads_kernel_(device, "diff/backward/gather_heads", atomic_variant(device),
                    gather_constants(model, options)) {}

void HitGather::reserve_records(std::uint64_t n_hits) {
    constexpr std::uint64_t kMaxRecords = 1ull << 31;  // record indices have 32 bits
    const auto capacity = std::uint32_t(std::min(n_hits, kMaxRecords));
    if (sort_ && capacity <= sort_->capacity()) return;
    sort_.reset();
    sort_ = std::make_unique<RadixSort>(device_, capacity, 1);
    // Each pass of the sort reads one set of arrays and writes the other.
    for (int set : {0, 1}) {
        rows_[set] = {device_, capacity, "rows of hits"};
        slots_[set] = {device_, capacity, "sorted hits"};
    }
    hits_ = Array<shared::HitRecord>(device_, capacity, "gradients of hits");
    // A block stores up to two sums: of its first row and of its last row.
    parts_ = {device_, 2 * std::size_t(part_floats_) * (capacity / RELIDAR_GATHER_BLOCK + 1),
              "sums of hit records"};
}

/// Assigns each ray a range of hit records: a prefix sum of the numbers of hits gives the
/// first record of each ray.
void HitGather::assign_records(Stream& stream, const RenderedBatch& batch) {
    n_rays_ = batch.rays.n_rays;
    if (n_rays_ > first_hit_.size()) {
        stream.submit_and_wait();
        first_hit_ = {device_, n_rays_, "slots of rays"};
        prefix_sum_.reserve_scratch(device_, n_rays_);
        reserve_records(std::uint64_t(n_rays_) * hits_per_ray_);
    }
    const StridedCounts hits{.address = batch.rendered->address_as<std::uint32_t, shared::ScanCounts>(),
                             .offset = offsetof(shared::RenderedRay, n_hits) / 4,
                             .stride = sizeof(shared::RenderedRay) / 4};
    prefix_sum_.run(stream, hits, first_hit_.address().cast_tag<shared::ScanPrefix>(), n_rays_,
                    n_hits_.address().cast_tag<shared::ScanTotal>());
}

void HitGather::set_addresses(shared::BackwardParams& params) const {
    params.first_hit = first_hit_.address();
    params.hits = hits_.address();
    params.rows = rows_[0].address();
    params.capacity = sort_->capacity();
}

/// Sorts the hit records by gradient row and sums the gradients of each row. The sort
/// keeps the order of hits, so that the sums are the same in every run.
void HitGather::sum_gradients(Stream& stream, const shared::BackwardParams& params) {
    const auto set = [&](int index) {
        return SortBuffers{.keys = rows_[index].address().cast_tag<shared::SortKeys>(),
                           .order = slots_[index].address().cast_tag<shared::SortOrder>()};
    };
    const SortBuffers sorted =
        sort_->run(stream, set(0), set(1), std::uint32_t(std::bit_width(params.n_rows)),
                   n_hits_.address().cast_tag<shared::SortCount>());
    const shared::GatherParams gather{.scene = params.scene,
                                      .upstream = params.upstream,
                                      .hits = hits_.address(),
                                      .rows = sorted.keys.cast_tag<shared::HitRows>(),
                                      .slots = sorted.order.cast_tag<shared::HitSlots>(),
                                      .n_hits = n_hits_.address(),
                                      .parts = parts_.address(),
                                      .d_records = params.d_records,
                                      .d_sh = params.d_sh,
                                      .most_hits = most_hits_.address(),
                                      .capacity = sort_->capacity(),
                                      .n_rows = params.n_rows};
    const std::uint32_t n_blocks = sort_->capacity() / RELIDAR_GATHER_BLOCK + 1;
    relidar::run(stream, gather_, n_blocks, gather);
    relidar::run(stream, heads_kernel_, n_blocks, gather);
}

}  // namespace relidar
