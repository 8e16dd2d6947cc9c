// SPDX-License-Identifier: Apache-2.0
// Losses and their derivatives with respect to what a ray renders (Eq. 10-11). Weights are config fields; a term of weight 0 costs
// nothing. Terms are means over their pixels, points or surfels, so that weights do not depend on the size of a batch.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/shared/rays.h>
#include <relidar/stages/gpu.hpp>

namespace relidar {

struct RayBatch;
struct RayGeometry;
struct SurfelArrays;
class DeviceScene;

using shared::DeviceTarget;

/// How the rays of a batch lie as an image, row by row. rows = 0: they do not.
struct ImageShape {
    std::uint32_t rows = 0;
    std::uint32_t columns = 0;
    bool circular = false;   ///< a whole turn: the first column follows the last one

    bool is_image() const { return rows > 0; }
};

/// Targets of a batch of rays: those of ray k are entry first + k * stride.
struct TargetBatch {
    const Array<DeviceTarget>* targets = nullptr;
    std::uint32_t first = 0;
    std::uint32_t stride = 1;
    std::uint32_t n_rays = 0;
    double n_returned = 0.0;   ///< known rays of the batch that returned: what depth and intensity are averaged over
    double n_known = 0.0;      ///< known rays of the batch: what ray-drop is averaged over
    ImageShape image{};        ///< of the rays, where the batch is an image
};

/// Weights of the terms; each is a mean over its pixels.
struct LossWeights {
    float depth = 0.1f;             ///< L1 on returned rays, metres
    float intensity = 0.1f;         ///< (1 - intensity_ssim) L1 + intensity_ssim (1 - SSIM) on returned rays
    float intensity_ssim = 0.0f;    ///< share of structural similarity, 11 x 11 Gaussian window of 1.5 pixels (0 = paper's text)
    float drop = 0.01f;             ///< cross-entropy on all known rays
    float opacity = 0.0f;           ///< (1 - W)^2 on returned rays (not in the paper)
    bool normalised_depth = false;  ///< compare D / W instead of D (paper)
    float chamfer = 0.01f;          ///< squared distances both ways between simulated and measured points, m^2
    float distortion = 0.0f;        ///< spread of each returned ray's hits, metres (not in the paper)
    float normal = 0.0f;            ///< disagreement of surfel normals with the normals of the rendered range image (not in the paper)
    float box = 0.0f;               ///< actors' surfels outside their box, or larger than box_scale_share of it
    float box_scale_share = 0.2f;   ///< standard deviation an actor's surfel may have, over half the diagonal of its box
    float opacity_entropy = 0.0f;   ///< entropy of opacities: drives them to 0 or 1 (not in the paper)

    bool uses_geometry() const { return distortion > 0.0f || normal > 0.0f; }
    bool uses_surfels() const { return box > 0.0f || opacity_entropy > 0.0f; }
};

inline constexpr int kLossTerms = 10;
inline constexpr std::array<const char*, kLossTerms> kLossTermNames{"depth", "intensity", "drop", "opacity", "ssim", "box", "entropy", "chamfer", "distortion", "normal"};

/// Where the terms of a batch are added up: a row of an array that may hold those of several batches.
struct TermRow {
    const Array<float>& terms;   ///< [rows, kLossTerms] weighted
    std::uint32_t row = 0;

    TermRow(const Array<float>& array, std::uint32_t at = 0) : terms(array), row(at) {}
    Address<float> address() const { return terms.address(std::size_t(row) * kLossTerms); }
};

/// Depth, intensity and ray-drop, pixel by pixel, and the structural similarity of intensity.
class ImageLoss {
public:
    /// @param n_rays  most rays of a batch; used by structural similarity only
    ImageLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays = 0);
    ~ImageLoss();
    /// Records the loss of a batch, which must be an image where intensity_ssim > 0. A window of structural similarity holds its
    /// known, returned pixels only: what rendered and measured intensity are at dropped or unknown pixels plays no part.
    /// @param rendered    [n_rays] input
    /// @param upstream    [n_rays] output
    /// @param terms       accumulated
    void run(Stream& stream, const TargetBatch& batch, const Array<shared::RenderedRay>& rendered,
             Array<shared::RayGradient>& upstream, const TermRow& terms);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Chamfer distance between the simulated points A and the measured points B of a batch (docs/method.md section 5), exact:
///   chamfer ( sum_A min_B |a - b|^2 + sum_B min_A |a - b|^2 ) / min(|A|, |B|);  0 where a cloud is empty
/// A: origin + range * direction of known rays with ray-drop below 0.5 and W > 0.1, range D / W or D (normalised_depth). B: the same
/// of known rays that returned. The derivative goes to the range of a, as query and as the point found, with the pairs, the choice
/// of A and the rays themselves held fixed. Points are found through boxes over tiles of neighbouring rays and over groups of tiles,
/// in image order where the batch is an image, else along the list; the order decides how fast a search is, never what it finds.
class ChamferLoss {
public:
    /// @param n_rays  most rays of a batch
    ChamferLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays);
    ~ChamferLoss();
    /// Records the loss of a batch; to follow ImageLoss::run.
    /// @param rendered  [n_rays] input
    /// @param upstream  [n_rays] accumulated
    /// @param terms     accumulated
    void run(Stream& stream, const RayBatch& rays, const TargetBatch& batch, const Array<shared::RenderedRay>& rendered,
             Array<shared::RayGradient>& upstream, const TermRow& terms);
    /// Of the last batch, by ray: the nearest measured point of each simulated one and the reverse, ~0 where there is none. Blocks.
    std::array<std::vector<std::uint32_t>, 2> nearest() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Geometric losses of "2D Gaussian Splatting for Geometrically Accurate Radiance Fields" (2024), means over returned rays:
///   distortion  sum over pairs of hits of a ray, each pair once, of w_i w_j |t_i - t_j|   (half of that paper's Eq. 13), metres
///   normal      sum_i w_i (1 - n_i . N) = W - B . N   (its Eq. 14), n_i and N turned to face the sensor
/// N is the normal of the plane through the points of the pixels beside, and those above and below, in the rendered range image
/// (range D / W or D, normalised_depth). A pixel has one where all five returned and render a W above 0.5, where the inverse ranges
/// r / r_left + r / r_right, and above and below, differ from 2 by less than 0.1 (a plane has 2), and where the two chords are not
/// nearly parallel; others have no normal term. The derivative goes to B, W and, through N, to the ranges of the pixels beside and to
/// their rays; which pixels have a normal is held fixed.
class GeometryLoss {
public:
    /// @param n_rays  most rays of a batch
    GeometryLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays);
    ~GeometryLoss();
    /// Records the loss of a batch, which must be an image where normal > 0; to follow ImageLoss::run.
    /// @param rendered  [n_rays] input
    /// @param geometry  of the same ForwardPass::run; its gradient is output
    /// @param upstream  [n_rays] accumulated
    /// @param terms     accumulated
    void run(Stream& stream, const RayBatch& rays, const TargetBatch& batch, const Array<shared::RenderedRay>& rendered,
             RayGeometry& geometry, Array<shared::RayGradient>& upstream, const TermRow& terms);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Gradients of a scene's parameters, as the backward pass leaves them.
struct SurfelGradients {
    SurfelArrays* d_surfels = nullptr;               ///< accumulated
    const Array<std::uint32_t>* touched = nullptr;   ///< rows that hold a gradient; null = all do
};

/// Terms of the parameters themselves, with mu the mean in the box frame, h the Model::half_size_m, s a standard deviation and sigma an opacity:
///   box      mean over actors' surfels of  sum_xyz max(0, |mu| / h - 1) + sum_uv max(0, s / (box_scale_share |h|) - 1)
///   entropy  mean over all surfels of  -sigma ln sigma - (1 - sigma) ln(1 - sigma)
class SurfelLoss {
public:
    SurfelLoss(Device& device, const LossWeights& weights);
    ~SurfelLoss();
    /// Records both terms; to follow the backward pass.
    /// @param terms  accumulated
    void run(Stream& stream, const DeviceScene& scene, const SurfelGradients& gradients, const TermRow& terms);

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
