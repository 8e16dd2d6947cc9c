// SPDX-License-Identifier: Apache-2.0
// Binding of loss/chamfer_points, chamfer_boxes, chamfer_nearest, chamfer and chamfer_vjp (Eq. 11).
#include <relidar/stages/loss.hpp>

#include <relidar/stages/traversal.hpp>

#include "core/assert.hpp"
#include "gpu/stream.hpp"
#include "shared/loss.h"

namespace relidar {

namespace {

/// Points, tiles of points and groups of tiles, each as a rectangle of rows and columns.
struct Levels {
    glm::uvec2 tile{4, 8};   ///< points of a tile, tiles of a group
    glm::uvec2 points, tiles, groups;

    explicit Levels(const TargetBatch& batch) {
        const bool image = batch.image.is_image();
        if (!image) tile = {1, 32};
        points = image ? glm::uvec2(batch.image.rows, batch.image.columns) : glm::uvec2(1, batch.n_rays);
        tiles = (points + tile - 1u) / tile;
        groups = (tiles + tile - 1u) / tile;
    }
};

/// A cloud and the boxes over it.
struct Cloud {
    Array<glm::vec3> points, tile_low, tile_high, group_low, group_high;

    /// Most tiles has an image of one column: ceil(n / 4); so have groups of tiles.
    Cloud(Device& device, std::size_t n, const std::string& what)
        : points(device, n, what + " points"),
          tile_low(device, n / 4 + 1, what + " tiles"),
          tile_high(device, n / 4 + 1, what + " tiles"),
          group_low(device, n / 16 + 2, what + " groups"),
          group_high(device, n / 16 + 2, what + " groups") {}
    shared::ChamferCloud pointers() const { return {points.address(), tile_low.address(), tile_high.address(), group_low.address(), group_high.address()}; }
};

}  // namespace

struct ChamferLoss::Impl {
    LossWeights weights;
    Cloud simulated, measured;
    Array<std::uint32_t> nearest_measured, nearest_simulated, d_found;
    Array<float> counts;
    Kernel<shared::ChamferPointsParams> points;
    Kernel<shared::ChamferBoxesParams> boxes;
    Kernel<shared::ChamferNearestParams> nearest;
    Kernel<shared::ChamferParams> chamfer, vjp;
    std::uint32_t n_rays = 0;   ///< of the last batch

    Impl(Device& device, const LossWeights& w, std::size_t n)
        : weights(w),
          simulated(device, n, "simulated"),
          measured(device, n, "measured"),
          nearest_measured(device, n, "nearest measured"),
          nearest_simulated(device, n, "nearest simulated"),
          d_found(device, 2 * n, "gradients of found points"),
          counts(device, 2, "points"),
          points(device, accumulating_variant(device, "loss/chamfer_points@")),
          boxes(device, "loss/chamfer_boxes"),
          nearest(device, "loss/chamfer_nearest"),
          chamfer(device, accumulating_variant(device, "loss/chamfer@")),
          vjp(device, "loss/chamfer_vjp") {}

    void bound_tiles(Stream& stream, const Cloud& cloud, const Levels& l) const {
        RELIDAR_ASSERT_LE(std::size_t(l.tiles.x) * l.tiles.y, cloud.tile_low.size());
        relidar::run(stream, boxes, std::size_t(l.tiles.x) * l.tiles.y,
                     {cloud.points.address(), cloud.points.address(), cloud.tile_low.address(), cloud.tile_high.address(), l.points.x, l.points.y, l.tile.x, l.tile.y});
    }
    void bound_groups(Stream& stream, const Cloud& cloud, const Levels& l) const {
        RELIDAR_ASSERT_LE(std::size_t(l.groups.x) * l.groups.y, cloud.group_low.size());
        relidar::run(stream, boxes, std::size_t(l.groups.x) * l.groups.y,
                     {cloud.tile_low.address(), cloud.tile_high.address(), cloud.group_low.address(), cloud.group_high.address(), l.tiles.x, l.tiles.y, l.tile.x, l.tile.y});
    }
    void search(Stream& stream, const Cloud& from, const Cloud& to, const Array<std::uint32_t>& found, const Levels& l) const {
        relidar::run(stream, nearest, n_rays, {from.points.address(), to.pointers(), found.address(), l.points.x, l.points.y, l.tile.x, l.tile.y});
    }
    /// Nearest points, both ways: neither cloud waits for the other.
    void search(Stream& stream, const Levels& l) const {
        {
            const Concurrent both(stream);
            bound_tiles(stream, simulated, l);
            bound_tiles(stream, measured, l);
        }
        {
            const Concurrent both(stream);
            bound_groups(stream, simulated, l);
            bound_groups(stream, measured, l);
        }
        const Concurrent both(stream);
        search(stream, simulated, measured, nearest_measured, l);
        search(stream, measured, simulated, nearest_simulated, l);
    }
};

ChamferLoss::ChamferLoss(Device& device, const LossWeights& weights, std::uint32_t n_rays) : impl_(new Impl(device, weights, n_rays)) {}
ChamferLoss::~ChamferLoss() = default;

void ChamferLoss::compare(Stream& stream, const RenderedBatch& batch_rendered, const TargetBatch& batch, const TermRow& terms) {
    Impl& c = *impl_;
    const RayBatch& rays = batch_rendered.rays;
    const Array<float>& rendered = *batch_rendered.rendered;
    Array<float>& upstream = *batch_rendered.upstream;
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays), c.simulated.points.size());
    RELIDAR_ASSERT_LE(std::size_t(batch.n_rays) * kUpstreamFloats, upstream.size());
    c.n_rays = batch.n_rays;
    const Levels levels(batch);
    const std::uint32_t normalised = c.weights.normalised_depth ? 1u : 0u;
    {
        const Concurrent zeros(stream);
        stream.fill(c.counts);
        stream.fill(c.d_found);
    }
    relidar::run(stream, c.points, batch.n_rays,
                 {rays.rays->address(), rendered.address(), batch.targets->address(), c.simulated.points.address(), c.measured.points.address(), c.counts.address(), batch.n_rays,
                  batch.first, batch.stride, normalised});
    c.search(stream, levels);
    const shared::ChamferParams chamfer{rays.rays->address(), rendered.address(), c.simulated.points.address(), c.measured.points.address(), c.nearest_measured.address(),
                                        c.nearest_simulated.address(), c.counts.address(), c.d_found.address(), upstream.address(), terms.address(), c.weights.chamfer,
                                        batch.n_rays, batch.first, batch.stride, normalised};
    relidar::run(stream, c.chamfer, batch.n_rays, chamfer);
    relidar::run(stream, c.vjp, batch.n_rays, chamfer);
}

std::array<std::vector<std::uint32_t>, 2> ChamferLoss::nearest() const {
    std::array<std::vector<std::uint32_t>, 2> result{impl_->nearest_measured.download(), impl_->nearest_simulated.download()};
    for (std::vector<std::uint32_t>& indices : result) indices.resize(impl_->n_rays);
    return result;
}

}  // namespace relidar
