// SPDX-License-Identifier: Apache-2.0
// Losses and their derivatives with respect to what a ray renders (Eq. 10-11). Weights
// are config fields; a term of weight 0 costs nothing. Terms are means over their pixels,
// points or surfels, so that weights do not depend on the size of a batch.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/diff/rays.h>
#include <relidar/diff/loss_options.hpp>
#include <relidar/gpu/stream.hpp>

namespace relidar {

struct RenderedBatch;
struct SurfelArrays;
class DeviceScene;

using shared::DeviceTarget;

/// How the rays of a batch lie as an image, row by row. rows = 0: they do not.
struct ImageShape {
    std::uint32_t rows = 0;
    std::uint32_t columns = 0;
    bool circular = false;  ///< a whole sweep: the first column follows the last one

    bool is_image() const { return rows > 0; }
};

/// Targets of a batch of rays: those of ray k are entry first + k * stride.
struct TargetBatch {
    const Array<DeviceTarget>* targets = nullptr;
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_rays = 0;
    /// known rays of the batch that returned: what depth and intensity are averaged over
    double n_returned = 0.0;
    double n_known = 0.0;  ///< known rays of the batch: what ray-drop is averaged over
    ImageShape image{};    ///< of the rays, where the batch is an image
};

namespace shared {  // what arrays hold, as kernels tell them apart
struct LossTerms;
struct TouchedSurfels;
}  // namespace shared

/// Where the terms of a batch are added up: a row of an array that may hold those of
/// several batches.
struct TermRow {
    const Array<float>& terms;  ///< [rows, kLossTerms] weighted
    std::uint32_t row = 0;

    TermRow(const Array<float>& array, std::uint32_t at = 0) : terms(array), row(at) {}
    Address<float, shared::LossTerms> address() const {
        return terms.address_as<float, shared::LossTerms>(std::size_t(row) * kLossTerms);
    }
};

/// Gradients of a scene's parameters, as the backward pass leaves them.
struct SurfelGradients {
    SurfelArrays* d_surfels = nullptr;  ///< accumulated
    /// rows that hold a gradient; null = all do
    const Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
};

/// A loss: one term or several, recorded together. One of your own derives from it,
/// overrides one of the two, and joins the list.
class Loss {
public:
    virtual ~Loss() = default;
    /// Records terms of what rays render; between the forward and the backward pass.
    /// @param rendered  its upstream is accumulated; ImageLoss, which comes first, writes it
    /// @param terms     accumulated
    virtual void compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                         const TermRow& terms);
    /// Records terms of the parameters themselves; after the backward pass.
    /// @param terms     accumulated
    virtual void regularise(Stream& stream, const DeviceScene& scene, const SurfelGradients& gradients,
                            const TermRow& terms);
};

/// The losses that weights ask for, in the order in which they are to be recorded. Always
/// begins with an ImageLoss.
/// @param n_rays  most rays of a batch
std::vector<std::unique_ptr<Loss>> make_losses(Device& device, const LossWeights& weights,
                                               std::uint32_t n_rays);

/// Depth, intensity and ray-drop, pixel by pixel, and the structural similarity of
/// intensity. The batch must be an image where intensity_ssim > 0. A window of structural
/// similarity holds its known, returned pixels only: what rendered and measured intensity
/// are at dropped or unknown pixels plays no part.
class ImageLoss final : public Loss {
public:
    /// @param n_rays  most rays of a batch; used by structural similarity only
    ImageLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays = 0);
    ~ImageLoss() override;
    void compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                 const TermRow& terms) override;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Chamfer distance between the simulated points A and the measured points B of a batch
/// (docs/method.md section 5), exact:
///   chamfer ( sum_A min_B |a - b|^2 + sum_B min_A |a - b|^2 ) / min(|A|, |B|);  0 where a cloud is empty
/// A: origin + range * direction of known rays with ray-drop below 0.5 and W > 0.1, range
/// D / W or D (normalised_depth). B: the same of known rays that returned. The derivative
/// goes to the range of a, as query and as the point found, with the pairs, the choice of
/// A and the rays themselves held fixed. Points are found through boxes over tiles of
/// neighbouring rays and over groups of tiles, in image order where the batch is an
/// image, else along the list; the order decides how fast a search is, never what it
/// finds.
class ChamferLoss final : public Loss {
public:
    /// @param n_rays  most rays of a batch
    ChamferLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays);
    ~ChamferLoss() override;
    void compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                 const TermRow& terms) override;
    /// Of the last batch, by ray: the nearest measured point of each simulated one and
    /// the reverse, ~0 where there is none. Blocks.
    std::array<std::vector<std::uint32_t>, 2> nearest() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Likelihood of the measured ranges (docs/method.md M12), a mean over returned rays:
///   likelihood  -ln(f + (1 - f) S), S = sum_i w_i k(t_i) with the RangeKernel k about the measured range, f the likelihood_floor
/// The batch must be rendered with TraceOptions::likelihood and with the same targets.
class LikelihoodLoss final : public Loss {
public:
    LikelihoodLoss(Device& device, const LossWeights& weights);
    ~LikelihoodLoss() override;
    void compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                 const TermRow& terms) override;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// A term of the parameters themselves, with mu the mean in the box frame, h the
/// Model::half_size_m and s a standard deviation:
///   box      mean over actors' surfels of  sum_xyz max(0, |mu| / h - 1) + sum_uv max(0, s / (box_scale_share |h|) - 1)
class SurfelLoss final : public Loss {
public:
    SurfelLoss(Device& device, const LossWeights& weights);
    ~SurfelLoss() override;
    void regularise(Stream& stream, const DeviceScene& scene, const SurfelGradients& gradients,
                    const TermRow& terms) override;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
