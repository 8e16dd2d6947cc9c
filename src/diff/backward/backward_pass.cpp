// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/backward.hpp>

#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>

#include "base/assert.hpp"
#include "base/fail.hpp"
#include "diff/backward/hit_gather.hpp"
#include "diff/backward/pose_gradients.hpp"
#include "diff/traversal/trace_scene.hpp"
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

TraceConstants backward_constants(const Device& device, const ImageModel& model, ProxyShape proxy,
                                  const TraceOptions& options, const BackwardOptions& backward) {
    TraceConstants all = trace_constants(device, proxy, options, model);
    const bool gathered = uses_hit_records(device, backward.reduction, model.sh_direction);
    all.push_back({GATHER, gathered ? 1u : 0u});
    // If `exchanged`, the threads of a subgroup collect gradients in shared memory before
    // the atomics. This reduces memory traffic, but needs
    // VK_KHR_shader_maximal_reconvergence.
    const bool exchanged =
        !gathered && backward.coalesced_atomics.value_or(should_coalesce(device) && lanes_reconverge(device));
    all.push_back({COALESCED_ATOMICS, exchanged ? 1u : 0u});
    // The exchange needs subgroup barriers. lavapipe (a CPU driver) executes them as
    // barriers of the full workgroup. Therefore each workgroup has only one subgroup.
    if (exchanged) all.push_back({WORKGROUP_SIZE, std::uint32_t(device.info().subgroup_size)});
    return all;
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
            ? std::make_unique<HitGather>(device, model, backward.hits_per_ray, options)
            : nullptr;
    /// Number of truncated rays. The kernel must write this number, but nothing reads it,
    /// because the forward pass has already counted these rays.
    Array<std::uint32_t, shared::PassCapCount> pass_cap{device, 1, "number of truncated rays"};
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

/// Records the backward pass: gradients of the surfel records per hit, then of the surfel
/// parameters, and then of the poses (Eq. 9 of the paper).
void BackwardPass::record_backward(Stream& stream, DeviceScene& scene, const AccelerationStructure& accel,
                                   const RenderedBatch& batch, const glm::vec3& view_origin_m,
                                   DeviceGradients& gradients) {
    RELIDAR_ASSERT_LE(std::size_t(batch.rays.n_rays), batch.rendered->size());
    RELIDAR_ASSERT_LE(16 * std::size_t(scene.count_rows()), gradients.records.size());
    const ImageModel& model = impl_->model;
    const bool has_pose_gradients = gradients.poses.size() > 0,
               lists = scene.can_skip_surfels() && !gradients.zero_untouched;
    shared::BackwardParams params{};
    params.scene = trace_params(scene, accel, batch.rays, model, impl_->options, impl_->pass_cap.address());
    params.rendered = batch.rendered->address();
    params.upstream = batch.upstream->address();
    params.d_records = gradients.records.address();
    params.d_sh = gradients.surfels.sh.address();
    if (lists) params.touched = gradients.touched.address();
    params.d_rays = gradients.rays.address();
    if (batch.stored_hits) {
        RELIDAR_ASSERT_EQ(batch.stored_hits->can_store_hits(batch.rays), true);
        params.kept = batch.stored_hits->hits.address();
        params.n_kept = batch.stored_hits->per_ray;
    }
    params.n_rows = scene.count_rows();
    params.with_turn = has_pose_gradients ? 1u : 0u;
    if (impl_->gather) {
        impl_->gather->assign_records(stream, batch);
        impl_->gather->set_addresses(params);
    }
    {
        // The kernels add to these arrays. The fills are independent, so one barrier is
        // enough.
        const ConcurrentLaunchScope zeros(stream);
        stream.fill(gradients.records);
        if (model.sh_direction == ShDirection::ray) stream.fill(gradients.surfels.sh);
        if (lists) stream.fill(gradients.touched);
        if (lists && has_pose_gradients) stream.fill(gradients.pose_sums->d_view);
    }
    relidar::run(stream, impl_->trace, count_threads(batch.rays), params);
    if (impl_->gather) impl_->gather->sum_gradients(stream, params);
    scene.activate_vjp(stream, model, view_origin_m,
                       {.d_records = &gradients.records,
                        .d_surfels = &gradients.surfels,
                        .touched = &gradients.touched,
                        .d_view = has_pose_gradients ? &gradients.pose_sums->d_view : nullptr,
                        .zero_untouched = gradients.zero_untouched,
                        .touched_is_marked = lists});
    if (has_pose_gradients) impl_->poses.reduce(stream, scene, model, view_origin_m, gradients);
}

}  // namespace relidar
