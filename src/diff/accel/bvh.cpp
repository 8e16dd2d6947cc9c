// SPDX-License-Identifier: Apache-2.0
// Submits the kernels that build and refit the software BVH (bounding volume hierarchy),
// including its top-level tree over the instances.
#include "diff/accel/bvh.hpp"

#include <algorithm>
#include <bit>
#include <limits>
#include <numeric>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "diff/shared/accel.h"
#include "diff/shared/bvh_build.h"
#include "gpu/radix_sort.hpp"
#include "gpu/stream.hpp"

namespace relidar {

static_assert(sizeof(shared::BvhNode) == 80);

namespace {

constexpr std::uint32_t kWorkgroup = RELIDAR_BVH_WORKGROUP;
// Workgroup size of the kernels whose threads exchange data in shared memory.
constexpr Constant kShares{ConstantId::WORKGROUP_SIZE, kWorkgroup};

// Number of threads of a refit on a CPU. The driver runs a contiguous part of them on
// each core. Each thread processes every n-th node, so all cores have a similar amount of
// work.
constexpr std::uint32_t kRefitThreadsOfCpu = 1 << 12;

/// Rounds the length of an array in scratch memory up to a multiple of 4 words, so that
/// the array after it is aligned to 16 bytes.
std::uint32_t pad_count(std::uint32_t count) { return (count + 3) / 4 * 4; }

std::uint32_t count_workgroups(std::uint32_t n_threads) { return (n_threads + kWorkgroup - 1) / kWorkgroup; }
std::uint32_t count_tiles(std::uint32_t count) { return (count + RELIDAR_BVH_TILE - 1) / RELIDAR_BVH_TILE; }

/// Returns the number of lanes in a subgroup of the device.
/// @throws DeviceError if the device lacks a feature that the kernels need
std::uint32_t get_subgroup_size(const Device& device) {
    const DeviceInfo& info = device.info();
    if (!info.software)
        throw DeviceError(fmt::format("cannot use software traversal on {}: the device lacks {}", info.name,
                                      info.why_not_software));
    return static_cast<std::uint32_t>(info.subgroup_size);
}

std::vector<std::uint32_t> list_instance_models(const DeviceScene& scene) {
    std::vector<std::uint32_t> models;
    for (const Instance& instance : scene.layout().instances) models.push_back(instance.model);
    return models;
}

/// Returns the number of nodes of a tree with `count` instances and eight children per
/// node.
std::uint32_t count_top_nodes(std::uint32_t count) {
    std::uint32_t n_nodes = 0;
    do {
        count = std::max((count + 7) / 8, 1u);
        n_nodes += count;
    } while (count > 1);
    return n_nodes;
}

}  // namespace

/// Selects the models of all surfels in compute_node_boxes(), and also models without
/// surfels.
constexpr std::uint32_t kAllModels = std::numeric_limits<std::uint32_t>::max();

/// Positions of the arrays in scratch memory, in words per surfel. The last build step
/// (conversion to wide nodes) reuses the memory of keys, boxes and costs.
constexpr std::uint32_t kChildrenAt = 0, kDecisionsAt = 2, kValuesAt = 3, kDemandsAt = 4, kKeysAt = 5,
                        kBoxesAt = 7, kCostsAt = 13, kSparesAt = 20, kOtherEndsAt = 21, kClustersAt = 22,
                        kScratchWords = 23;
constexpr std::uint32_t kOffsetsAt = kKeysAt, kPlacesAt = kBoxesAt, kSlotsAt = kBoxesAt + 1;

struct Bvh::Impl {
    std::uint32_t n, n_models, n_instances, bound, n_refitting;
    Kernel<shared::ProxyParams> proxies;
    Kernel<shared::BvhBoundsParams> bounds_kernel;
    Kernel<shared::BvhKeysParams> keys_kernel;
    RadixSort sort;
    Kernel<shared::BvhClusterParams> cluster;
    Kernel<shared::BvhWideParams> wide_mark, wide_mark_rest, wide_count, wide_scan, wide_place, wide_emit;
    Kernel<shared::BvhRefitParams> refit_kernel;
    Kernel<shared::BvhTopParams> top;
    Kernel<shared::BvhCostParams> cost_kernel;
    Array<std::uint32_t, shared::InstanceModels> model_of;  ///< [n_instances] model of each instance
    Array<float, shared::SurfelBoxes> boxes;                ///< [n,6] boxes of the surfels, in m
    Array<std::uint32_t, shared::ModelBounds> bounds;       ///< [n_models,6] bounds of the box centres
    /// Scratch memory for the arrays of the binary trees and for the keys of the sort.
    Array<std::uint32_t> scratch;
    Array<std::uint32_t, shared::BinaryRoots> queue;       ///< [bound] binary nodes that become wide nodes
    Array<std::uint32_t, shared::LevelSizes> level_sizes;  ///< number of queue entries per level
    Array<glm::uvec2, shared::SumsOfTiles> tiles;
    Array<shared::BvhNode> nodes;                   ///< [bound] wide nodes of all models
    Array<std::uint32_t, shared::LeafOrder> order;  ///< [n] surfels in the order of the leaves
    /// Parent of each node, and first surfel of the node's model [bound].
    Array<glm::uvec2, shared::WideLinks> links;
    Array<float, shared::WideBoxes> node_boxes;  ///< [bound,6] boxes of the nodes before quantisation
    /// [bound] number of children whose boxes are finished
    Array<std::uint32_t, shared::Arrivals> arrivals;
    Array<std::uint32_t, shared::WideCount> count;  ///< [1] number of nodes in use
    /// [n_instances] root node of each instance's model
    Array<std::uint32_t, shared::InstanceRoots> roots;
    /// [n_instances] instances in the order of the leaves
    Array<std::uint32_t, shared::TopOrder> top_order;
    Array<shared::BvhNode> top_node_array;
    Array<float, shared::InstanceBoxes> top_boxes;
    Array<glm::uvec2> top_keys;
    Array<float, shared::CostSums> cost_sums;  ///< sums of accel/bvh_cost, one per workgroup
    Readback costs;

    Impl(Device& device, const DeviceScene& scene);
    shared::BvhBinary binary() const;
    shared::BvhWide wide() const;
    template <class T, class Meaning>
    Address<T, Meaning> at(std::uint32_t words_a_surfel) const {
        return scratch.address_as<T, Meaning>(words_a_surfel * std::size_t(pad_count(n)));
    }
    /// Returns the position of the sort keys in scratch memory. The sort alternates
    /// between two sets of keys and ends in set 0. Set 1 is overwritten by the costs of
    /// the binary nodes.
    std::uint32_t get_keys_offset(int set) const { return set == 0 ? kKeysAt : kCostsAt; }
    SortSet get_sort_buffers(int set) const;
    std::uint32_t levels() const;
    void collapse_to_wide_tree(Stream& stream, const DeviceScene& scene);
    std::uint32_t get_key_bits() const {
        return 3 * RELIDAR_BVH_MORTON_BITS +
               static_cast<std::uint32_t>(std::bit_width(std::max(n_models, 1u) - 1));
    }
    void make_boxes(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                    const SurfelRange& range);
    SortSet sort_surfels(Stream& stream, const DeviceScene& scene);
    /// Submits kernels that compute the node boxes of some models: those whose first
    /// surfel has an index in [first, last].
    void compute_node_boxes(Stream& stream, std::uint32_t first, std::uint32_t last);
};

Bvh::Impl::Impl(Device& d, const DeviceScene& scene)
    : n(scene.size()),
      n_models(static_cast<std::uint32_t>(scene.layout().models.size())),
      n_instances(static_cast<std::uint32_t>(scene.layout().instances.size())),
      bound(compute_max_nodes(n, n_models)),
      n_refitting(prefers_coalesced_access(d) ? RELIDAR_BVH_WIDTH * bound
                                              : std::min(RELIDAR_BVH_WIDTH * bound, kRefitThreadsOfCpu)),
      proxies(
          d, "diff/accel/proxies",
          {{ConstantId::BOXES, 2u}, {ConstantId::PRIMITIVE, static_cast<std::uint32_t>(scene.primitive())}}),
      bounds_kernel(d, "diff/accel/bvh_bounds", {kShares}, Subgroups::full),
      keys_kernel(d, "diff/accel/bvh_keys"),
      sort(d, n, 2),
      cluster(d, "diff/accel/bvh_cluster", {{ConstantId::WORKGROUP_SIZE, get_subgroup_size(d)}},
              Subgroups::full),
      wide_mark(d, "diff/accel/bvh_wide_mark"),
      wide_mark_rest(d, "diff/accel/bvh_wide_mark", {kShares, {ConstantId::UNTIL_DONE, 1u}}),
      wide_count(d, "diff/accel/bvh_wide_count", {kShares}, Subgroups::full),
      wide_scan(d, "diff/accel/bvh_wide_scan", {kShares}, Subgroups::full),
      wide_place(d, "diff/accel/bvh_wide_place"),
      wide_emit(d, "diff/accel/bvh_wide_emit"),
      refit_kernel(d, "diff/accel/bvh_refit", {{ConstantId::LANES, get_subgroup_size(d)}}, Subgroups::full),
      top(d, "diff/accel/bvh_top", {kShares}, Subgroups::full),
      cost_kernel(d, "diff/accel/bvh_cost", {kShares}, Subgroups::full),
      model_of(d, std::span<const std::uint32_t>(list_instance_models(scene)), "models of the instances"),
      boxes(d, 6 * std::size_t(n), "surfel boxes"),
      bounds(d, 6 * std::size_t(n_models), "model bounds"),
      scratch(d,
              std::max(kScratchWords * std::size_t(pad_count(n)),
                       kSlotsAt * std::size_t(pad_count(n)) + 8 * std::size_t(bound)),
              "acceleration structure scratch"),
      queue(d, bound, "collapse queue"),
      level_sizes(d, levels() + 1, "collapse levels"),
      tiles(d, count_tiles(n), "collapse sums"),
      nodes(d, bound, "wide nodes"),
      order(d, n, "surfels in leaf order"),
      links(d, bound, "wide node links"),
      node_boxes(d, 6 * std::size_t(bound), "wide node boxes"),
      arrivals(d, bound, "wide node arrivals"),
      count(d, 1, "wide node count"),
      roots(d, n_instances, "instance roots"),
      top_order(d, n_instances, "instances in leaf order"),
      top_node_array(d, count_top_nodes(n_instances), "top nodes"),
      top_boxes(d, 6 * (std::size_t(n_instances) + count_top_nodes(n_instances)), "instance boxes"),
      top_keys(d, std::bit_ceil(std::max(n_instances, 1u)), "instance keys"),
      cost_sums(d, count_workgroups(bound), "cost sums"),
      costs(d, count_workgroups(bound) * sizeof(float), "cost sums") {}

/// Returns the number of launches of bvh_wide_mark, which processes one tree level per
/// launch: the number of levels of a full tree with `bound` nodes, plus 4 for uneven
/// trees.
std::uint32_t Bvh::Impl::levels() const {
    std::uint32_t n_levels = 4;
    for (std::uint64_t width = n_models; width < bound; width *= RELIDAR_BVH_WIDTH) ++n_levels;
    return n_levels;
}

shared::BvhBinary Bvh::Impl::binary() const {
    return {.children = at<glm::uvec2, shared::BinaryChildren>(kChildrenAt),
            .boxes = at<float, shared::BinaryBoxes>(kBoxesAt),
            .costs = at<float, shared::BinaryCosts>(kCostsAt),
            .decisions = at<std::uint32_t, shared::BinaryDecisions>(kDecisionsAt),
            .spares = at<std::uint32_t, shared::SpareNodes>(kSparesAt)};
}

shared::BvhWide Bvh::Impl::wide() const {
    return {.nodes = nodes.address(),
            .order = order.address(),
            .links = links.address(),
            .boxes = node_boxes.address(),
            .arrivals = arrivals.address(),
            .count = count.address()};
}

SortSet Bvh::Impl::get_sort_buffers(int set) const {
    return {.keys = at<std::uint32_t, shared::SortKeys>(get_keys_offset(set)),
            .order = at<std::uint32_t, shared::SortOrder>(set == 0 ? kValuesAt : kCostsAt + 2)};
}

void Bvh::Impl::make_boxes(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                           const SurfelRange& range) {
    run(stream, proxies, range.count,
        {.records = scene.records().address(),
         .vertices = {},
         .boxes = boxes.address(),
         .reach = {},
         .alpha_min = scene.alpha_min(),
         .margin_m = options.margin_m,
         .margin_scale = options.margin_scale,
         .first_surfel = range.first,
         .n_surfels = range.count});
}

SortSet Bvh::Impl::sort_surfels(Stream& stream, const DeviceScene& scene) {
    stream.fill(bounds, 0xffffffffu);
    run(stream, bounds_kernel, std::size_t(count_tiles(n)) * kWorkgroup,
        {.boxes = boxes.address(),
         .models = scene.models().address(),
         .bounds = bounds.address(),
         .n_surfels = n,
         .n_models = n_models});
    // Each pass of the sort moves the keys to the other one of two sets. The first set is
    // chosen by the parity of the number of passes, so that the last pass writes set 0.
    const int first_set = static_cast<int>(RadixSort::passes(get_key_bits()) % 2);
    run(stream, keys_kernel, n,
        {.records = scene.records().address(),
         .models = scene.models().address(),
         .bounds = bounds.address(),
         .keys = at<glm::uvec2, shared::MortonKeys>(get_keys_offset(first_set)),
         .other_ends = at<std::uint32_t, shared::OtherEnds>(kOtherEndsAt),
         .demands = at<std::uint32_t, shared::SlotDemands>(kDemandsAt),
         .n_surfels = n,
         .n_models = n_models});
    return sort.run(stream, get_sort_buffers(first_set), get_sort_buffers(1 - first_set), get_key_bits());
}

void Bvh::Impl::collapse_to_wide_tree(Stream& stream, const DeviceScene& scene) {
    stream.fill(level_sizes);
    shared::BvhWideParams params{.tree = binary(),
                                 .wide = wide(),
                                 .queue = queue.address(),
                                 .slots = at<std::uint32_t, shared::WideSlots>(kSlotsAt),
                                 .level_sizes = level_sizes.address(),
                                 .demands = at<std::uint32_t, shared::SlotDemands>(kDemandsAt),
                                 .offsets = at<glm::uvec2, shared::TileOffsets>(kOffsetsAt),
                                 .tiles = tiles.address(),
                                 .places = at<std::uint32_t, shared::WidePlaces>(kPlacesAt),
                                 .surfels = at<std::uint32_t, shared::SortedSurfels>(kValuesAt),
                                 .models = scene.models().address(),
                                 .n_surfels = n,
                                 .n_tiles = count_tiles(n),
                                 .n_models = n_models,
                                 .bound = bound,
                                 .level = 0};
    for (std::uint64_t width = n_models; params.level < levels() - 1;
         ++params.level, width = std::min<std::uint64_t>(width * RELIDAR_BVH_WIDTH, bound))
        run(stream, wide_mark, width, params);
    run(stream, wide_mark_rest, kWorkgroup, params);
    run(stream, wide_count, std::size_t(count_tiles(n)) * kWorkgroup, params);
    run(stream, wide_scan, kWorkgroup, params);
    run(stream, wide_place, bound, params);
    run(stream, wide_emit, bound, params);
}

void Bvh::Impl::compute_node_boxes(Stream& stream, std::uint32_t first, std::uint32_t last) {
    run(stream, refit_kernel, n_refitting,
        {.wide = wide(),
         .boxes = boxes.address(),
         .bound = bound,
         .first_surfel = first,
         .last_surfel = last});
}

Bvh::Bvh(Device& device, const DeviceScene& scene) {
    impl_ = std::make_unique<Impl>(device, scene);
    Stream stream(device);
    for (const Buffer* zero : {&impl_->nodes.buffer(), &impl_->arrivals.buffer(), &impl_->count.buffer()})
        stream.fill(*zero);
    // Sets an initial value that models without surfels keep.
    for (const Buffer* none : {&impl_->links.buffer(), &impl_->queue.buffer()})
        stream.fill(*none, RELIDAR_BVH_NO_NODE);
    stream.finish();
}

Bvh::~Bvh() = default;

void Bvh::build(Stream& stream, const DeviceScene& scene, const AccelOptions& options) {
    Impl& b = *impl_;
    b.make_boxes(stream, scene, options, {0, b.n});
    const SortSet sorted = b.sort_surfels(stream, scene);
    run(stream, b.cluster, b.n,
        {.tree = b.binary(),
         .boxes = b.boxes.address(),
         .keys = b.at<glm::uvec2, shared::MortonKeys>(kKeysAt),
         .surfels = sorted.order.as<shared::SortedSurfels>(),
         .models = scene.models().address(),
         .other_ends = b.at<std::uint32_t, shared::OtherEnds>(kOtherEndsAt),
         .clusters = b.at<std::uint32_t, shared::BinaryClusters>(kClustersAt),
         .roots = b.queue.address(),
         .n_surfels = b.n,
         .n_models = b.n_models});
    b.collapse_to_wide_tree(stream, scene);
    b.compute_node_boxes(stream, 0, kAllModels);
    move(stream, scene);
}

void Bvh::refit(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                const std::vector<SurfelRange>& ranges) {
    for (const auto& [first, count] : ranges) {
        if (count == 0) continue;
        impl_->make_boxes(stream, scene, options, {first, count});
        impl_->compute_node_boxes(stream, first, first + count - 1);
    }
    move(stream, scene);
}

void Bvh::move(Stream& stream, const DeviceScene& scene) {
    Impl& b = *impl_;
    run(stream, b.top, kWorkgroup,
        {.bvh = pointers(),
         .instances = scene.instances().address(),
         .model_of = b.model_of.address(),
         .models = scene.models().address(),
         .model_boxes = b.node_boxes.address(),
         .boxes = b.top_boxes.address(),
         .keys = b.top_keys.address(),
         .n_instances = b.n_instances,
         .n_padded = static_cast<std::uint32_t>(b.top_keys.size())});
}

shared::BvhPointers Bvh::pointers() const {
    const Impl& b = *impl_;
    return {.nodes = b.nodes.address(),
            .order = b.order.address(),
            .roots = b.roots.address(),
            .top_nodes = b.top_node_array.address(),
            .top_order = b.top_order.address()};
}

std::uint64_t Bvh::memory_bytes() const {
    const Impl& b = *impl_;
    std::uint64_t bytes = b.sort.memory_bytes();
    for (const Buffer* buffer :
         {&b.model_of.buffer(), &b.boxes.buffer(), &b.bounds.buffer(), &b.scratch.buffer(), &b.queue.buffer(),
          &b.level_sizes.buffer(), &b.tiles.buffer(), &b.nodes.buffer(), &b.order.buffer(), &b.links.buffer(),
          &b.node_boxes.buffer(), &b.arrivals.buffer(), &b.count.buffer(), &b.roots.buffer(),
          &b.top_order.buffer(), &b.top_node_array.buffer(), &b.top_boxes.buffer(), &b.top_keys.buffer(),
          &b.cost_sums.buffer()})
        bytes += buffer->size_bytes();
    return bytes;
}

BvhOnHost Bvh::download() const {
    const Impl& b = *impl_;
    BvhOnHost host{b.nodes.download(),          b.order.download(),     b.roots.download(),
                   b.top_node_array.download(), b.top_order.download(), b.boxes.download()};
    host.nodes.resize(std::min<std::size_t>(b.count.download().front(), host.nodes.size()));
    return host;
}

void Bvh::record_cost_measurement(Stream& stream) {
    Impl& b = *impl_;
    run(stream, b.cost_kernel, b.bound,
        {.wide = b.wide(), .boxes = b.boxes.address(), .partial = b.cost_sums.address(), .bound = b.bound});
    b.costs.record(stream, b.cost_sums.buffer(), b.cost_sums.size() * sizeof(float));
}

std::optional<double> Bvh::read_cost(Stream& stream) {
    Impl& b = *impl_;
    if (!b.costs.pending()) return std::nullopt;
    const float* sums = static_cast<const float*>(b.costs.wait(stream));
    return std::accumulate(sums, sums + b.cost_sums.size(), 0.0);
}

}  // namespace relidar
