// SPDX-License-Identifier: Apache-2.0
// Training losses and their derivatives with respect to the rendered values of rays
// (paper, Eq. 10-11). Terms with weight 0 are not computed. Each term is a mean over
// pixels, points or surfels, so the weights do not depend on the batch size.
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

/// Image layout of the rays of a batch, stored row by row. rows = 0 means that the rays
/// do not form an image.
struct ImageShape {
    std::uint32_t rows = 0;
    std::uint32_t columns = 0;
    bool circular = false;  ///< True for a full sweep: the first and the last column are neighbours.

    bool is_image() const { return rows > 0; }
};

/// Measured targets of a batch of rays. The target of ray k is targets[first + k *
/// stride].
struct TargetBatch {
    const Array<DeviceTarget>* targets = nullptr;
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_rays = 0;
    /// Expected number of rays with a known measurement that returned: the mean share of
    /// the frame times n_rays. Depth and intensity terms are divided by this number.
    double n_returned = 0.0;
    /// Expected number of rays with a known measurement, returned or dropped. The
    /// ray-drop term is divided by this number.
    double n_known_rays = 0.0;
    ImageShape image{};  ///< Image layout of the rays, if the batch is an image.
};

namespace shared {
struct LossTerms;
struct TouchedSurfels;
}  // namespace shared

/// Row of a device array to which kernels add the loss terms of a batch.
struct LossTermRow {
    const Array<float>& terms;  ///< Weighted loss terms, [rows, kLossTerms].
    std::uint32_t row = 0;

    LossTermRow(const Array<float>& array, std::uint32_t at = 0) : terms(array), row(at) {}
    Address<float, shared::LossTerms> row_address() const {
        return terms.address_as<float, shared::LossTerms>(std::size_t(row) * kLossTerms);
    }
};

/// Gradients of a scene's parameters after the backward pass.
struct SurfelGradients {
    SurfelArrays* d_surfels = nullptr;  ///< Gradients of the surfels. Losses add to these arrays.
    /// Flags: 1 for each surfel that has a gradient. Null = all surfels have a gradient.
    const Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
};

/// Base class of a loss. A loss computes one or several terms. The loss of a program
/// overrides add_ray_losses() or add_regularisers(), adds its value to the term
/// RELIDAR_CUSTOM_TERM, and is passed to train() in TrainSession::losses. It runs its own
/// kernels (relidar/gpu/kernel.hpp), see tools/examples/robust_loss.hpp.
class Loss {
public:
    virtual ~Loss() = default;
    /// Records GPU commands for the loss terms that compare rendered with measured rays.
    /// The commands run between the forward and the backward pass.
    /// @param rendered rays to compare. The commands add the gradient of the loss to
    /// their array `upstream`. Only ImageLoss, the first loss, overwrites this array
    /// @param terms row of a device array, to which the commands add the loss terms
    virtual void add_ray_losses(Stream& stream, const RenderedBatch& rendered, const TargetBatch& targets,
                                const LossTermRow& terms);
    /// Records GPU commands for the loss terms that depend directly on the surfel
    /// parameters, not on rendered rays. Called after the backward pass.
    /// @param terms row of a device array, to which the commands add the loss terms
    virtual void add_regularisers(Stream& stream, const DeviceScene& scene, const SurfelGradients& gradients,
                                  const LossTermRow& terms);
};

/// Creates the losses whose weights are above 0, in the order in which their commands
/// must be recorded. The first loss is always an ImageLoss.
/// @param n_rays number of rays of the largest batch
std::vector<std::unique_ptr<Loss>> make_losses(Device& device, const LossWeights& w, std::uint32_t n_rays);

/// Computes depth, intensity and ray-drop losses per pixel. If intensity_ssim > 0, also
/// computes the structural similarity (SSIM) of the intensities. Dropped and unknown
/// pixels are left out. For SSIM, the batch must be an image.
class ImageLoss final : public Loss {
public:
    /// Creates the image loss.
    /// @param n_rays number of rays of the largest batch, used only for SSIM
    ImageLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays = 0);
    ~ImageLoss() override;
    void add_ray_losses(Stream&, const RenderedBatch&, const TargetBatch&, const LossTermRow&) override;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Computes the exact Chamfer distance between the simulated points A and the measured
/// points B of a batch (docs/method.md section 5):
///
///   chamfer = (sum_A min_B |a - b|^2 + sum_B min_A |a - b|^2) / min(|A|, |B|);
///             0 if a cloud is empty
///
/// A contains origin + range * direction of each known ray with a ray-drop probability
/// below 0.5 and weight W > 0.1. The range is D / W, or D with normalised_depth. B
/// contains the measured points of known rays that returned. The gradient is with respect
/// to the range of each point in A. The matched pairs, the selection of A and the rays
/// are treated as constant. The search for nearest points uses the bounding boxes of
/// tiles of neighbouring rays. Tiles are image blocks if the batch is an image, otherwise
/// parts of the ray list. The order of the rays affects only the speed.
class ChamferLoss final : public Loss {
public:
    /// Creates the Chamfer loss.
    /// @param n_rays number of rays of the largest batch
    ChamferLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays);
    ~ChamferLoss() override;
    void add_ray_losses(Stream&, const RenderedBatch&, const TargetBatch&, const LossTermRow&) override;
    /// Returns two arrays of ray indices, which stand for the points of these rays. The
    /// first array has the nearest measured point of each simulated point of the last
    /// batch. The second array has the nearest simulated point of each measured point. ~0
    /// means no point. Waits for the GPU.
    std::array<std::vector<std::uint32_t>, 2> nearest_points() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Computes the negative log-likelihood of the measured ranges (docs/method.md M12), as a
/// mean over the rays with a measured return:
///   likelihood = -ln(f + (1 - f) S),  S = sum_i w_i k(t_i)
/// w_i and t_i are the weight and the range of hit i on the ray. k is the
/// RangeLikelihoodKernel around the measured range. f is likelihood_floor. The batch must
/// be rendered with TraceOptions::likelihood and with the same measured ranges.
class LikelihoodLoss final : public Loss {
public:
    LikelihoodLoss(Device& device, const LossWeights& weights);
    ~LikelihoodLoss() override;
    void add_ray_losses(Stream&, const RenderedBatch&, const TargetBatch&, const LossTermRow&) override;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Penalises actor surfels that extend beyond the box of their actor. The loss is the
/// mean over all surfels of actors of
///
///   sum_xyz max(0, |mu| / h - 1) + sum_s max(0, s / (box_scale_share |h|) - 1)
///
/// mu is the centre of the surfel in the box frame. h is the half size of the box
/// (SurfelModel::half_size_m). s is the standard deviation along an axis: two axes of a
/// 2D Gaussian, three of a 3D Gaussian.
class ActorBoxLoss final : public Loss {
public:
    ActorBoxLoss(Device& device, const LossWeights& weights);
    ~ActorBoxLoss() override;
    void add_regularisers(Stream&, const DeviceScene&, const SurfelGradients&, const LossTermRow&) override;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
