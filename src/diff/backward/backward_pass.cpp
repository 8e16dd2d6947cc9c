// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/backward.hpp>

#include <algorithm>
#include <bit>
#include <cstddef>

#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>

#include "base/assert.hpp"
#include "base/fail.hpp"
#include "diff/backward/pose_gradients.hpp"
#include "diff/traversal/trace_scene.hpp"
#include "gpu/prefix_sum.hpp"
#include "gpu/radix_sort.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

using enum SpecialisationConstantId;

constexpr std::uint32_t kMostHitsPerRay = 4096;

/// Returns true if the kernels write one record per hit and sum the records without
/// atomics. This is faster if spherical harmonics are evaluated per hit (64 atomics
/// instead of 16), or if the device has no float atomics.
bool uses_hit_records(const Device& device, GradientReduction reduction, ShDirection sh_direction) {
    if (reduction != GradientReduction::automatic) return reduction == GradientReduction::gather;
    return sh_direction == ShDirection::ray || !device.info().float_atomics;
}

/// Returns the specialisation constants of kernel diff/backward/trace: those of the
/// forward pass, and how the gradients of hits are added to surfels.
TraceConstants backward_constants(const Device& device, const ImageModel& model, ProxyShape proxy,
                                  const TraceOptions& options, const BackwardOptions& backward) {
    TraceConstants constants = trace_constants(device, proxy, options, model);
    const bool writes_records = uses_hit_records(device, backward.reduction, model.sh_direction);
    constants.push_back({GATHER, writes_records ? 1u : 0u});  // 0: atomic additions
    // With coalesced atomics, the threads of a subgroup collect gradients in shared
    // memory before the atomics. This reduces memory traffic, but needs
    // VK_KHR_shader_maximal_reconvergence.
    const bool can_coalesce = should_coalesce(device) && lanes_reconverge(device);
    const bool coalesces = !writes_records && backward.coalesced_atomics.value_or(can_coalesce);
    constants.push_back({COALESCED_ATOMICS, coalesces ? 1u : 0u});
    // The collection needs subgroup barriers. lavapipe (a CPU driver) executes them as
    // barriers of the full workgroup. Therefore each workgroup has only one subgroup.
    if (coalesces) constants.push_back({WORKGROUP_SIZE, std::uint32_t(device.info().subgroup_size)});
    return constants;
}

/// Sort keys and values of hit records: the row of a hit's gradient, and the index of its
/// record.
struct HitSortArrays {
    Array<std::uint32_t, shared::HitRows> rows;
    Array<std::uint32_t, shared::HitSlots> slots;

    SortBuffers buffers() const {
        return {.keys = rows.address().cast_tag<shared::SortKeys>(),
                .order = slots.address().cast_tag<shared::SortOrder>()};
    }
};

/// Sums the gradients of hits by surfel without atomics. The backward pass writes one
/// record per hit. Then kernels sort the records by surfel and sum them.
class HitGather {
public:
    /// @param constants of the tracing kernels
    /// @param hits_per_ray number of hits for which memory is allocated
    HitGather(Device& device, const TraceConstants& constants, ShDirection sh_direction,
              std::uint32_t hits_per_ray);
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
    Kernel<shared::GatherParams> sum_blocks_, join_blocks_;
    Array<std::uint32_t, shared::MostHits> most_hits_{device_, std::vector<std::uint32_t>{0u},
                                                      "largest number of hits in a batch"};
    Array<std::uint32_t, shared::HitCount> n_hits_{device_, 1, "hits of a batch"};
    Array<std::uint32_t, shared::FirstHits> first_hit_;
    Array<shared::HitRecord> hits_;
    Array<float, shared::RowParts> parts_;
    /// Each pass of the sort reads one of these and writes the other.
    HitSortArrays unsorted_, sorted_;
    PrefixSum prefix_sum_{device_};    ///< counts the hits of earlier rays
    std::unique_ptr<RadixSort> sort_;  ///< sorts the hits by row
};

HitGather::HitGather(Device& device, const TraceConstants& constants, ShDirection sh_direction,
                     std::uint32_t hits_per_ray)
    : device_(device),
      hits_per_ray_(hits_per_ray),
      part_floats_(sh_direction == ShDirection::surfel ? 16u : 16u + RELIDAR_SH_FLOATS),
      sum_blocks_(device, "diff/backward/gather", atomic_variant(device), constants),
      join_blocks_(device, "diff/backward/gather_heads", atomic_variant(device), constants) {}

void HitGather::reserve_records(std::uint64_t n_hits) {
    constexpr std::uint64_t kMaxRecords = 1ull << 31;  // record indices have 32 bits
    const auto capacity = std::uint32_t(std::min(n_hits, kMaxRecords));
    if (sort_ && capacity <= sort_->capacity()) return;
    sort_.reset();
    sort_ = std::make_unique<RadixSort>(device_, capacity, 1);
    for (HitSortArrays* arrays : {&unsorted_, &sorted_}) {
        arrays->rows = {device_, capacity, "rows of hits"};
        arrays->slots = {device_, capacity, "sorted hits"};
    }
    hits_ = Array<shared::HitRecord>(device_, capacity, "gradients of hits");
    // A block stores up to two sums: of its first row and of its last row.
    parts_ = {device_, 2 * std::size_t(part_floats_) * (capacity / RELIDAR_GATHER_BLOCK + 1),
              "sums of hit records"};
}

/// Assigns each ray a range of hit records: first_hit_[r] is the number of hits of the
/// rays 0 to r - 1 (an exclusive prefix sum), and the index of the first record of ray r.
/// Also writes the total to `n_hits_`. Enlarges all arrays for the largest batch so far.
void HitGather::assign_records(Stream& stream, const RenderedBatch& batch) {
    const std::uint32_t n_rays = batch.rays.n_rays;
    if (n_rays > first_hit_.size()) {
        stream.submit_and_wait();
        first_hit_ = {device_, n_rays, "first hit of each ray"};
        prefix_sum_.reserve_scratch(device_, n_rays);
        reserve_records(std::uint64_t(n_rays) * hits_per_ray_);
    }
    // Sums the member `n_hits` of each RenderedRay: the struct is read as 32-bit words.
    const StridedCounts hit_counts{.address = batch.rendered->address_as<std::uint32_t, shared::ScanCounts>(),
                                   .offset = offsetof(shared::RenderedRay, n_hits) / 4,
                                   .stride = sizeof(shared::RenderedRay) / 4};
    prefix_sum_.run(stream, hit_counts, first_hit_.address().cast_tag<shared::ScanPrefix>(), n_rays,
                    n_hits_.address().cast_tag<shared::ScanTotal>());
}

void HitGather::set_addresses(shared::BackwardParams& params) const {
    params.first_hit = first_hit_.address();
    params.hits = hits_.address();
    params.rows = unsorted_.rows.address();
    params.capacity = sort_->capacity();
}

/// Adds the gradients of all hits to `params.d_records` and `params.d_sh`. Sorts the hit
/// records by gradient row (a row is one surfel of one instance), and sums each row. The
/// sort keeps the order of hits, so that the sums are the same in every run.
void HitGather::sum_gradients(Stream& stream, const shared::BackwardParams& params) {
    // Rows are numbers from 0 to n_rows - 1. Unused records have the row n_rows.
    const auto n_key_bits = std::uint32_t(std::bit_width(params.n_rows));
    const SortBuffers sorted = sort_->run(stream, unsorted_.buffers(), sorted_.buffers(), n_key_bits,
                                          n_hits_.address().cast_tag<shared::SortCount>());
    const shared::GatherParams gather{
        .scene = params.scene,
        .upstream = params.upstream,
        .hits = hits_.address(),  // not moved by the sort
        .rows = sorted.keys.cast_tag<shared::HitRows>(),
        .slots = sorted.order.cast_tag<shared::HitSlots>(),  // indices in `hits`, by row
        .n_hits = n_hits_.address(),
        .parts = parts_.address(),
        .d_records = params.d_records,
        .d_sh = params.d_sh,
        .most_hits = most_hits_.address(),  // over all batches, for max_hits()
        .capacity = sort_->capacity(),
        .n_rows = params.n_rows};
    // A thread sums a block of sorted records, row by row. The first and the last row of
    // a block may extend into its neighbours, so their sums are stored in `parts`. The
    // second kernel adds the parts of each row.
    const std::uint32_t n_blocks = sort_->capacity() / RELIDAR_GATHER_BLOCK + 1;
    relidar::run(stream, sum_blocks_, n_blocks, gather);
    relidar::run(stream, join_blocks_, n_blocks, gather);
}

}  // namespace

struct BackwardPass::Impl {
    Device& device;
    ImageModel model;
    ProxyShape proxy;
    TraceOptions options;
    BackwardOptions backward;
    Kernel<shared::BackwardParams> trace{device, "diff/backward/trace",
                                         atomic_variant(device, kernel_variant(device)),
                                         backward_constants(device, model, proxy, options, backward)};
    PoseGradientKernels poses{device};
    /// null if gradients are added with atomics
    std::unique_ptr<HitGather> gather =
        uses_hit_records(device, backward.reduction, model.sh_direction)
            ? std::make_unique<HitGather>(device, trace_constants(device, proxy, options, model),
                                          model.sh_direction, backward.hits_per_ray)
            : nullptr;
    /// Number of truncated rays. The kernel must write this number, but nothing reads it,
    /// because the forward pass has already counted these rays.
    Array<std::uint32_t, shared::PassCapCount> pass_cap{device, 1, "number of truncated rays"};

    /// True if the kernel marks surfels with a gradient, and activate_vjp() skips others.
    static bool marks_touched(const DeviceScene& scene, const DeviceGradients& gradients) {
        return scene.can_skip_surfels() && !gradients.zero_untouched;
    }
    void zero_gradients(Stream& stream, const DeviceGradients& gradients, bool marks_touched) const;
    shared::BackwardParams make_params(const DeviceScene& scene, const AccelerationStructure& accel,
                                       const RenderedBatch& batch, const DeviceGradients& gradients) const;
};

BackwardPass::BackwardPass(Device& device, const ImageModel& model, ProxyShape proxy,
                           const TraceOptions& options, const BackwardOptions& backward) {
    if (backward.hits_per_ray < 1 || backward.hits_per_ray > kMostHitsPerRay)
        fail<UsageError>("cannot create the backward pass: found {} hit records per ray, expected 1 to {}",
                         backward.hits_per_ray, kMostHitsPerRay);
    impl_.reset(new Impl{device, model, proxy, options, backward});
}

BackwardPass::~BackwardPass() = default;
void BackwardPass::set_sh_degree(int degree) { impl_->model.sh_degree = degree; }
const Array<std::uint32_t>* BackwardPass::max_hit_count() const {
    return impl_->gather ? &impl_->gather->max_hits() : nullptr;
}
std::uint64_t BackwardPass::hit_capacity() const { return impl_->gather ? impl_->gather->hit_capacity() : 0; }

void BackwardPass::reserve_hits(Stream& stream, std::uint64_t n_hits) {
    if (!impl_->gather) return;
    stream.submit_and_wait();
    impl_->gather->reserve_records(n_hits);
}

/// Returns the parameters of kernel diff/backward/trace, except those of HitGather.
shared::BackwardParams BackwardPass::Impl::make_params(const DeviceScene& scene,
                                                       const AccelerationStructure& accel,
                                                       const RenderedBatch& batch,
                                                       const DeviceGradients& gradients) const {
    const StoredRayHits* stored = batch.stored_hits;  // by the forward pass, or null
    RELIDAR_ASSERT_EQ(!stored || stored->can_store_hits(batch.rays), true);
    return {.scene = trace_params(scene, accel, batch.rays, model, options, pass_cap.address()),
            .rendered = batch.rendered->address(),
            .upstream = batch.upstream->address(),
            .d_records = gradients.records.address(),
            .d_sh = gradients.surfels.sh.address(),
            .touched = address_or_null(marks_touched(scene, gradients) ? &gradients.touched : nullptr),
            .d_rays = gradients.rays.address(),
            .first_hit = {},
            .hits = {},
            .rows = {},
            // Further hits of a ray, or all without stored hits, are searched again.
            .kept = address_or_null(stored ? &stored->hits : nullptr),
            .n_kept = stored ? stored->per_ray : 0,
            .capacity = 0,
            .n_rows = scene.count_rows(),
            // Pose gradients also need the gradient of the viewing direction.
            .with_turn = gradients.poses.size() > 0 ? 1u : 0u};
}

/// Sets the arrays to zero to which the kernels add.
void BackwardPass::Impl::zero_gradients(Stream& stream, const DeviceGradients& gradients,
                                        bool marks_touched) const {
    const ConcurrentLaunchScope zeros(stream);  // the fills need no barriers between them
    stream.fill(gradients.records);
    if (model.sh_direction == ShDirection::ray) stream.fill(gradients.surfels.sh);
    if (!marks_touched) return;
    stream.fill(gradients.touched);
    // activate_vjp() writes `d_view` only for touched surfels.
    if (gradients.poses.size() > 0) stream.fill(gradients.pose_sums->d_view);
}

/// Records the backward pass: gradients of the surfel records (the values that the hits
/// read), then of the surfel parameters, and then of the poses (Eq. 9 of the paper).
void BackwardPass::record_backward(Stream& stream, DeviceScene& scene, const AccelerationStructure& accel,
                                   const RenderedBatch& batch, const glm::vec3& view_origin_m,
                                   DeviceGradients& gradients) {
    RELIDAR_ASSERT_LE(std::size_t(batch.rays.n_rays), batch.rendered->size());
    RELIDAR_ASSERT_LE(16 * std::size_t(scene.count_rows()), gradients.records.size());
    const bool has_pose_gradients = gradients.poses.size() > 0;
    const bool marks_touched = Impl::marks_touched(scene, gradients);
    shared::BackwardParams params = impl_->make_params(scene, accel, batch, gradients);
    if (impl_->gather) {
        impl_->gather->assign_records(stream, batch);
        impl_->gather->set_addresses(params);
    }
    impl_->zero_gradients(stream, gradients, marks_touched);
    relidar::run(stream, impl_->trace, count_threads(batch.rays), params);
    if (impl_->gather) impl_->gather->sum_gradients(stream, params);
    scene.activate_vjp(stream, impl_->model, view_origin_m,
                       {.d_records = &gradients.records,
                        .d_surfels = &gradients.surfels,
                        .touched = &gradients.touched,
                        .d_view = has_pose_gradients ? &gradients.pose_sums->d_view : nullptr,
                        .zero_untouched = gradients.zero_untouched,
                        .touched_is_marked = marks_touched});
    if (has_pose_gradients) impl_->poses.reduce(stream, scene, impl_->model, view_origin_m, gradients);
}

}  // namespace relidar
