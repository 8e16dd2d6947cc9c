// SPDX-License-Identifier: Apache-2.0
// Losses and their derivatives with respect to the rendered values of rays (Eq. 10-11).
// The weights are settings. A term of weight 0 is not computed. Terms are means over
// their pixels, points or surfels, so that the weights do not depend on the batch size.
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

/// Image layout of the rays of a batch, row by row. rows = 0: the rays do not form an
/// image.
struct ImageShape {
    std::uint32_t rows = 0;
    std::uint32_t columns = 0;
    bool circular = false;  ///< True for a full sweep, in which the first column follows the last one.

    bool is_image() const { return rows > 0; }
};

/// Measured targets of a batch of rays. The target of ray k is entry first + k * stride.
struct TargetBatch {
    const Array<DeviceTarget>* targets = nullptr;
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_rays = 0;
    /// Number of known rays of the batch that returned; depth and intensity terms are
    /// averaged over them.
    double n_returned = 0.0;
    /// Number of known rays of the batch; the ray-drop term is averaged over them.
    double n_known = 0.0;
    ImageShape image{};  ///< Image layout of the rays, if the batch is an image.
};

// Content types of device arrays. Kernels use them to distinguish arrays of the same
// element type.
namespace shared {
struct LossTerms;
struct TouchedSurfels;
}  // namespace shared

/// Row of an array in which the loss terms of a batch are summed. The array may have
/// rows for several batches.
struct TermRow {
    const Array<float>& terms;  ///< Weighted loss terms, [rows, kLossTerms].
    std::uint32_t row = 0;

    TermRow(const Array<float>& array, std::uint32_t at = 0) : terms(array), row(at) {}
    Address<float, shared::LossTerms> address() const {
        return terms.address_as<float, shared::LossTerms>(std::size_t(row) * kLossTerms);
    }
};

/// Gradients of a scene's parameters after the backward pass.
struct SurfelGradients {
    SurfelArrays* d_surfels = nullptr;  ///< Gradients of the surfels, to which losses add.
    /// 1 for each row that has a gradient; null = all rows have one.
    const Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
};

/// Base class of a loss that computes one or several terms. A custom loss overrides one
/// of the two functions and is added to the list of losses.
class Loss {
public:
    virtual ~Loss() = default;
    /// Records loss terms that compare rendered and measured rays. Called between the
    /// forward and the backward pass.
    /// @param rendered rays to compare. The loss adds to `upstream`; only ImageLoss,
    /// which is recorded first, overwrites it.
    /// @param terms row to which the loss adds its terms
    virtual void compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                         const TermRow& terms);
    /// Records terms that depend directly on the parameters. Called after the backward
    /// pass.
    /// @param terms accumulated
    virtual void regularise(Stream& stream, const DeviceScene& scene, const SurfelGradients& gradients,
                            const TermRow& terms);
};

/// Creates the losses whose weights are above 0, in the order in which they must be
/// recorded. The first is always an ImageLoss.
/// @param n_rays number of rays of the largest batch
std::vector<std::unique_ptr<Loss>> make_losses(Device& device, const LossWeights& weights,
                                               std::uint32_t n_rays);

/// Depth, intensity and ray-drop losses per pixel, and structural similarity (SSIM) of
/// the intensity. The batch must be an image if intensity_ssim > 0. An SSIM window uses
/// only its known, returned pixels; intensities at dropped or unknown pixels have no
/// effect.
class ImageLoss final : public Loss {
public:
    /// Creates the image loss.
    /// @param n_rays number of rays of the largest batch; used only by structural
    /// similarity
    ImageLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays = 0);
    ~ImageLoss() override;
    void compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                 const TermRow& terms) override;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Exact Chamfer distance between the simulated points A and the measured points B of a
/// batch (docs/method.md section 5):
///
///   chamfer = (sum_A min_B |a - b|^2 + sum_B min_A |a - b|^2) / min(|A|, |B|);
///             0 if a cloud is empty
///
/// A: origin + range * direction of known rays with ray-drop below 0.5 and W > 0.1; the
/// range is D / W, or D (normalised_depth). B: the measured points of known rays that
/// returned. The gradient is with respect to the range of each point a, both as query and
/// as nearest point. The pairs, the selection of A and the rays are constant. Nearest
/// points are searched in boxes over tiles of neighbouring rays, and over groups of
/// tiles. Tiles follow the image if the batch is an image, otherwise the list order. The
/// order affects only the speed.
class ChamferLoss final : public Loss {
public:
    /// Creates the Chamfer loss.
    /// @param n_rays number of rays of the largest batch
    ChamferLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays);
    ~ChamferLoss() override;
    void compare(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                 const TermRow& terms) override;
    /// Returns the nearest measured point of each simulated point of the last batch, and
    /// the reverse, as ray indices; ~0 if there is none. Blocks.
    std::array<std::vector<std::uint32_t>, 2> nearest() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Likelihood of the measured ranges (docs/method.md M12), a mean over returned rays:
///   likelihood = -ln(f + (1 - f) S),  S = sum_i w_i k(t_i)
/// Here k is the RangeKernel about the measured range, and f is the likelihood_floor. The
/// batch must be rendered with TraceOptions::likelihood and with the same targets.
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

/// Loss term of the parameters. mu is the mean in the box frame, h is Model::half_size_m,
/// and s is a standard deviation:
///
///   box  mean over actors' surfels of
///        sum_xyz max(0, |mu| / h - 1) + sum_uv max(0, s / (box_scale_share |h|) - 1)
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
