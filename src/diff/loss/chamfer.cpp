// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/loss.hpp>

#include <relidar/diff/traversal.hpp>

#include "base/assert.hpp"
#include "diff/shared/loss.h"
#include "gpu/stream.hpp"

namespace relidar {

namespace {

/// Size of an image (rows, columns), counted in three units: points (one per pixel),
/// tiles of points, and groups of tiles.
struct ImageTileLevels {
    glm::uvec2 tile{4, 8};  ///< number of points per tile, and of tiles per group
    glm::uvec2 points, tiles, groups;

    explicit ImageTileLevels(const TargetBatch& batch) {
        const bool image = batch.image.is_image();
        if (!image) tile = {1, 32};
        points = image ? glm::uvec2(batch.image.rows, batch.image.columns) : glm::uvec2(1, batch.n_rays);
        tiles = (points + tile - 1u) / tile;
        groups = (tiles + tile - 1u) / tile;
    }
};

/// Has enough tiles and groups for any image with `count` points. An image with one
/// column needs the most: a tile then has only 4 points, and a group only 4 tiles.
struct TiledPointCloud {
    Device& device;
    std::size_t count;
    Array<glm::vec3, shared::CloudPoints> points{device, count, "points of a cloud"};
    Array<glm::vec3, shared::TileLows> tile_low{device, count / 4 + 1, "tiles of a cloud"};
    Array<glm::vec3, shared::TileHighs> tile_high{device, count / 4 + 1, "tiles of a cloud"};
    Array<glm::vec3, shared::GroupLows> group_low{device, count / 16 + 2, "groups of a cloud"};
    Array<glm::vec3, shared::GroupHighs> group_high{device, count / 16 + 2, "groups of a cloud"};
};

}  // namespace

struct ChamferLoss::Impl {
    Device& device;
    LossWeights weights;
    std::size_t count;
    TiledPointCloud simulated{device, count}, measured{device, count};
    Array<std::uint32_t, shared::NearestMeasured> nearest_measured{device, count, "nearest measured points"};
    Array<std::uint32_t, shared::NearestSimulated> nearest_simulated{device, count,
                                                                     "nearest simulated points"};
    Array<std::uint32_t, shared::FoundGradients> d_nearest_simulated{device, 2 * count,
                                                                     "gradients of nearest points"};
    Array<float, shared::PointCounts> counts{device, 2, "points"};
    Kernel<shared::ChamferPointsParams> points{device, "diff/loss/chamfer_points", atomic_variant(device)};
    Kernel<shared::ChamferBoxesParams> boxes{device, "diff/loss/chamfer_boxes"};
    Kernel<shared::ChamferNearestParams> nearest{device, "diff/loss/chamfer_nearest"};
    Kernel<shared::ChamferParams> chamfer{device, "diff/loss/chamfer", atomic_variant(device)};
    Kernel<shared::ChamferParams> vjp{device, "diff/loss/chamfer_vjp"};
    std::uint32_t n_rays = 0;  ///< number of rays of the last batch

    void compute_points(Stream& stream, const RenderedBatch& rendered_batch, const TargetBatch& batch) const;
    void add_losses(Stream& stream, const RenderedBatch& rendered_batch, const TargetBatch& batch,
                    const LossTermRow& terms) const;
    void tile_bounds(Stream& stream, const TiledPointCloud& cloud, const ImageTileLevels& levels) const {
        RELIDAR_ASSERT_LE(std::size_t(levels.tiles.x) * levels.tiles.y, cloud.tile_low.size());
        // The boxes of single points have equal corners, so both inputs are the points.
        relidar::run(stream, boxes, std::size_t(levels.tiles.x) * levels.tiles.y,
                     {.low = cloud.points.address().cast_tag<shared::LowCorners>(),
                      .high = cloud.points.address().cast_tag<shared::HighCorners>(),
                      .tile_low = cloud.tile_low.address(),
                      .tile_high = cloud.tile_high.address(),
                      .rows = levels.points.x,
                      .columns = levels.points.y,
                      .tile_rows = levels.tile.x,
                      .tile_columns = levels.tile.y});
    }
    void group_bounds(Stream& stream, const TiledPointCloud& cloud, const ImageTileLevels& levels) const {
        // The same kernel joins the boxes of tiles to boxes of groups of tiles.
        RELIDAR_ASSERT_LE(std::size_t(levels.groups.x) * levels.groups.y, cloud.group_low.size());
        relidar::run(stream, boxes, std::size_t(levels.groups.x) * levels.groups.y,
                     {.low = cloud.tile_low.address().cast_tag<shared::LowCorners>(),
                      .high = cloud.tile_high.address().cast_tag<shared::HighCorners>(),
                      .tile_low = cloud.group_low.address().cast_tag<shared::TileLows>(),
                      .tile_high = cloud.group_high.address().cast_tag<shared::TileHighs>(),
                      .rows = levels.tiles.x,
                      .columns = levels.tiles.y,
                      .tile_rows = levels.tile.x,
                      .tile_columns = levels.tile.y});
    }
    void find_nearest(Stream& stream, const TiledPointCloud& from, const TiledPointCloud& to,
                      const Array<std::uint32_t>& result, const ImageTileLevels& levels) const {
        relidar::run(stream, nearest, n_rays,
                     {.queries = from.points.address().cast_tag<shared::QueryPoints>(),
                      .cloud = {.points = to.points.address(),
                                .tile_low = to.tile_low.address(),
                                .tile_high = to.tile_high.address(),
                                .group_low = to.group_low.address(),
                                .group_high = to.group_high.address()},
                      .nearest = result.address(),
                      .rows = levels.points.x,
                      .columns = levels.points.y,
                      .tile_rows = levels.tile.x,
                      .tile_columns = levels.tile.y});
    }
    /// Searches the nearest measured point of each simulated point, and the reverse. Both
    /// searches run concurrently on the device.
    void find_both_ways(Stream& stream, const ImageTileLevels& levels) const {
        {
            const ConcurrentLaunchScope both(stream);
            tile_bounds(stream, simulated, levels);
            tile_bounds(stream, measured, levels);
        }
        {
            const ConcurrentLaunchScope both(stream);
            group_bounds(stream, simulated, levels);
            group_bounds(stream, measured, levels);
        }
        const ConcurrentLaunchScope both(stream);
        find_nearest(stream, simulated, measured, nearest_measured, levels);
        find_nearest(stream, measured, simulated, nearest_simulated, levels);
    }
};

ChamferLoss::ChamferLoss(Device& d, const LossWeights& w, std::uint32_t n) : impl_(new Impl{d, w, n}) {}
ChamferLoss::~ChamferLoss() = default;

/// Records the Chamfer loss (Eq. 11 of the paper) and its gradient: the mean squared
/// distance of simulated points to the nearest measured point, and the reverse.
void ChamferLoss::add_ray_losses(Stream& stream, const RenderedBatch& rendered_batch,
                                 const TargetBatch& batch, const LossTermRow& terms) {
    Impl& loss = *impl_;
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays), loss.simulated.points.size());
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays), rendered_batch.upstream->size());
    loss.n_rays = batch.n_rays;
    {
        // The kernels add to these arrays. One barrier is enough for independent fills.
        const ConcurrentLaunchScope zeros(stream);
        stream.fill(loss.counts);
        stream.fill(loss.d_nearest_simulated);
    }
    loss.compute_points(stream, rendered_batch, batch);
    loss.find_both_ways(stream, ImageTileLevels(batch));
    loss.add_losses(stream, rendered_batch, batch, terms);
}

/// Computes the simulated and the measured point of each ray, if any, and counts both. A
/// point is origin + range * direction, with the rendered or the measured range.
void ChamferLoss::Impl::compute_points(Stream& stream, const RenderedBatch& rendered_batch,
                                       const TargetBatch& batch) const {
    relidar::run(stream, points, batch.n_rays,
                 {.rays = rendered_batch.rays.rays->address(),
                  .rendered = rendered_batch.rendered->address(),
                  .targets = batch.targets->address(),
                  .simulated = simulated.points.address().cast_tag<shared::SimulatedPoints>(),
                  .measured = measured.points.address().cast_tag<shared::MeasuredPoints>(),
                  .counts = counts.address(),
                  .n_rays = batch.n_rays,
                  .first_ray = batch.first,
                  .ray_stride = batch.stride,
                  .normalised_depth = weights.normalised_depth ? 1u : 0u});
}

/// Adds the loss to `terms`, and its derivatives to the upstream gradients of the rays.
void ChamferLoss::Impl::add_losses(Stream& stream, const RenderedBatch& rendered_batch,
                                   const TargetBatch& batch, const LossTermRow& terms) const {
    const shared::ChamferParams params{
        .rays = rendered_batch.rays.rays->address(),
        .rendered = rendered_batch.rendered->address(),
        .simulated = simulated.points.address().cast_tag<shared::SimulatedPoints>(),
        .measured = measured.points.address().cast_tag<shared::MeasuredPoints>(),
        .nearest_measured = nearest_measured.address(),
        .nearest_simulated = nearest_simulated.address(),
        .counts = counts.address(),
        .d_nearest_simulated = d_nearest_simulated.address(),
        .upstream = rendered_batch.upstream->address(),
        .terms = terms.row_address(),
        .weight = weights.chamfer,
        .n_rays = batch.n_rays,
        .first_ray = batch.first,
        .ray_stride = batch.stride,
        .normalised_depth = weights.normalised_depth ? 1u : 0u};
    // A simulated point gets a derivative from its nearest measured point, and from each
    // measured point whose nearest point it is. The first kernel sums the latter in
    // `d_nearest_simulated`, the second adds both.
    relidar::run(stream, chamfer, batch.n_rays, params);
    relidar::run(stream, vjp, batch.n_rays, params);
}

std::array<std::vector<std::uint32_t>, 2> ChamferLoss::nearest_points() const {
    std::array<std::vector<std::uint32_t>, 2> result{impl_->nearest_measured.download(),
                                                     impl_->nearest_simulated.download()};
    for (std::vector<std::uint32_t>& indices : result) indices.resize(impl_->n_rays);
    return result;
}

}  // namespace relidar
