// SPDX-License-Identifier: Apache-2.0
// Binding of train/split_beams, train/join_beams and their derivatives.
#include "train/footprints.hpp"

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/sensor.hpp>

#include "core/assert.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

std::vector<glm::vec2> checked_pattern(int n) {
    if (n != 5 && n != 9) throw UsageError(fmt::format("setting train.sub_rays: found {}, expected 1, 5 or 9", n));
    const std::vector<glm::dvec2> exact = footprint_pattern(n);
    return {exact.begin(), exact.end()};
}

}  // namespace

Footprints::Footprints(Device& device, int n_parts, std::uint32_t n_beams, double unexplained)
    : pattern_(checked_pattern(n_parts)),
      unexplained_(static_cast<float>(unexplained)),
      rays_(device, pattern_.size() * n_beams, "rays of footprints"),
      targets_(device, pattern_.size() * n_beams, "targets of footprints"),
      rendered_(device, n_beams, "rendered beams"),
      upstream_(device, n_beams, "loss gradients of beams"),
      geometry_(device, n_beams),
      ray_gradients_(device, std::size_t(6) * n_beams, "ray gradients of beams"),
      split_(device, "train/split_beams"),
      split_vjp_(device, "train/split_beams_vjp"),
      join_(device, "train/join_beams"),
      join_vjp_(device, "train/join_beams_vjp") {}

RayBatch Footprints::split(Stream& stream, const RayBatch& beams, double divergence_rad) {
    RELIDAR_ASSERT_LE(std::size_t(beams.n_rays), rendered_.size());
    n_beams_ = beams.n_rays;
    run(stream, split_, n_beams_ * n_parts(),
        {.beams = beams.rays->address(),
         .beam_targets = beams.targets->address(),
         .offsets = impl_of(stream).values(pattern_),
         .parts = rays_.address(),
         .part_targets = targets_.address(),
         .half_divergence = static_cast<float>(0.5 * divergence_rad),
         .n_beams = n_beams_,
         .first_beam = beams.first,
         .beam_stride = beams.stride,
         .n_parts = n_parts()});
    return {&rays_, 0, 1, n_beams_ * n_parts(), beams.columns * n_parts(), &targets_};
}

shared::JoinBeamsParams Footprints::join_params(const RenderedBatch& parts) const {
    RELIDAR_ASSERT_EQ(parts.rays.n_rays, n_beams_ * n_parts());
    shared::JoinBeamsParams params{.parts = parts.rendered->address(),
                                   .part_geometry = {},
                                   .beams = rendered_.address(),
                                   .beam_geometry = {},
                                   .d_beams = upstream_.address(),
                                   .d_beam_geometry = {},
                                   .d_parts = parts.upstream->address(),
                                   .d_part_geometry = {},
                                   .unexplained = unexplained_,
                                   .n_beams = n_beams_,
                                   .n_parts = n_parts()};
    if (!parts.geometry) return params;
    params.part_geometry = parts.geometry->rendered.address();
    params.beam_geometry = geometry_.rendered.address();
    params.d_beam_geometry = geometry_.gradient.address();
    params.d_part_geometry = parts.geometry->gradient.address();
    return params;
}

RenderedBatch Footprints::join(Stream& stream, const RayBatch& beams, const RenderedBatch& parts) {
    run(stream, join_, n_beams_, join_params(parts));
    return {beams, &rendered_, &upstream_, nullptr, parts.geometry ? &geometry_ : nullptr};
}

void Footprints::spread(Stream& stream, const RenderedBatch& parts) {
    run(stream, join_vjp_, std::size_t(n_beams_) * n_parts(), join_params(parts));
}

void Footprints::sum_ray_gradients(Stream& stream, const Array<float>& d_rays) {
    run(stream, split_vjp_, std::size_t(6) * n_beams_,
        {.d_parts = d_rays.address_as<float, shared::PartRayGradients>(), .d_beams = ray_gradients_.address(),
         .n_beams = n_beams_, .n_parts = n_parts()});
    stream.copy(ray_gradients_.buffer(), d_rays.buffer(), std::size_t(6) * n_beams_ * sizeof(float));
}

}  // namespace relidar
