// SPDX-License-Identifier: Apache-2.0
#include "diff/accel/bvh.hpp"

#include <algorithm>
#include <bit>
#include <limits>
#include <numeric>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"
#include "diff/shared/accel.h"
#include "diff/shared/bvh_build.h"
#include "gpu/radix_sort.hpp"
#include "gpu/stream.hpp"

namespace relidar {

static_assert(sizeof(shared::BvhNode) == 80);

namespace {

using enum SpecialisationConstantId;

constexpr std::uint32_t kWorkgroupSize = RELIDAR_BVH_WORKGROUP;
constexpr SpecialisationConstant kWorkgroupConstant{WORKGROUP_SIZE, kWorkgroupSize};

// Number of threads that refit a tree on a CPU. Each of the n threads processes every
// n-th node, so that all cores have about the same amount of work.
constexpr std::uint32_t kRefitThreadsOfCpu = 1 << 12;

/// Rounds the length of an array in scratch memory up to a multiple of 4 words. The next
/// array is then aligned to 16 bytes.
std::uint32_t round_up_4(std::uint32_t count) { return (count + 3) / 4 * 4; }

std::uint32_t count_workgroups(std::uint32_t n_threads) {
    return (n_threads + kWorkgroupSize - 1) / kWorkgroupSize;
}

std::uint32_t surfel_tiles(std::uint32_t n_surfels) {
    return (n_surfels + RELIDAR_BVH_TILE - 1) / RELIDAR_BVH_TILE;
}

/// @throws DeviceError if the device lacks a feature that the kernels need
std::uint32_t subgroup_size(const Device& device) {
    const DeviceInfo& info = device.info();
    if (!info.software)
        fail<DeviceError>("cannot trace rays in software on {}: the device lacks {}", info.name,
                          info.why_not_software);
    return std::uint32_t(info.subgroup_size);
}

/// Returns the number of nodes of a tree with `n_instances` instances and eight children
/// per node, over all levels.
std::uint32_t count_top_nodes(std::uint32_t n_instances) {
    std::uint32_t n_nodes = 0;
    do {
        n_instances = std::max((n_instances + 7) / 8, 1u);
        n_nodes += n_instances;
    } while (n_instances > 1);
    return n_nodes;
}

}  // namespace

/// Value of `last_surfel` with which compute_node_boxes() processes all models.
constexpr std::uint32_t kAllModels = std::numeric_limits<std::uint32_t>::max();

/// Offsets of arrays in scratch memory. The unit is the number of surfels, rounded up to
/// a multiple of 4. Arrays that are not needed at the same time share an offset.
constexpr std::uint32_t kChildrenAt = 0, kDecisionsAt = 2, kValuesAt = 3, kDemandsAt = 4, kKeysAt = 5,
                        kBoxesAt = 7, kCostsAt = 13, kSparesAt = 20, kOtherEndsAt = 21, kClustersAt = 22,
                        kScratchWords = 23;
constexpr std::uint32_t kOffsetsAt = kKeysAt, kWideNodeIndicesAt = kBoxesAt, kSlotsAt = kBoxesAt + 1,
                        kSecondKeysAt = kCostsAt, kSecondValuesAt = kCostsAt + 2;

/// Array in scratch memory. Has the type that a kernel parameter expects.
struct ScratchArray {
    const Array<std::uint32_t>& memory;
    std::size_t first_word;

    template <class T, class Meaning>
    operator Address<T, Meaning>() const {
        return memory.address_as<T, Meaning>(first_word);
    }
};

struct Bvh::Impl {
    Device& device;
    std::uint32_t n, n_models, n_instances;
    PrimitiveType primitive;
    std::uint32_t max_nodes = max_node_count(n, n_models);
    std::uint32_t n_refitting = should_coalesce(device)
                                    ? RELIDAR_BVH_WIDTH * max_nodes
                                    : std::min(RELIDAR_BVH_WIDTH * max_nodes, kRefitThreadsOfCpu);
    Kernel<shared::ProxyParams> proxies{
        device, "diff/accel/proxies", {{BOXES, 2u}, {PRIMITIVE, std::uint32_t(primitive)}}};
    Kernel<shared::BvhBoundsParams> bounds_kernel{
        device, "diff/accel/bvh_bounds", {kWorkgroupConstant}, SubgroupRequirement::full};
    Kernel<shared::BvhKeysParams> keys_kernel{device, "diff/accel/bvh_keys"};
    RadixSort sort{device, n, 2};
    Kernel<shared::BvhClusterParams> cluster{device,
                                             "diff/accel/bvh_cluster",
                                             {{WORKGROUP_SIZE, subgroup_size(device)}},
                                             SubgroupRequirement::full};
    Kernel<shared::BvhWideParams> choose_level{device, "diff/accel/bvh_wide_mark"};
    Kernel<shared::BvhWideParams> choose_remaining{
        device, "diff/accel/bvh_wide_mark", {kWorkgroupConstant, {UNTIL_DONE, 1u}}};
    Kernel<shared::BvhWideParams> sum_tiles{
        device, "diff/accel/bvh_wide_count", {kWorkgroupConstant}, SubgroupRequirement::full};
    Kernel<shared::BvhWideParams> sum_earlier_tiles{
        device, "diff/accel/bvh_wide_scan", {kWorkgroupConstant}, SubgroupRequirement::full};
    Kernel<shared::BvhWideParams> number_nodes{device, "diff/accel/bvh_wide_place"};
    Kernel<shared::BvhWideParams> write_nodes{device, "diff/accel/bvh_wide_emit"};
    Kernel<shared::BvhRefitParams> refit_kernel{
        device, "diff/accel/bvh_refit", {{LANES, subgroup_size(device)}}, SubgroupRequirement::full};
    Kernel<shared::BvhTopParams> top{
        device, "diff/accel/bvh_top", {kWorkgroupConstant}, SubgroupRequirement::full};
    Kernel<shared::BvhCostParams> cost_kernel{
        device, "diff/accel/bvh_cost", {kWorkgroupConstant}, SubgroupRequirement::full};
    /// [models] root node of each model's tree. A build numbers the roots like the
    /// models.
    std::vector<std::uint32_t> model_roots;
    /// [n_instances] the same for the model of each instance
    Array<std::uint32_t, shared::ModelRoots> root_of{device, n_instances, "roots of models"};
    Array<float, shared::SurfelBoxes> boxes{device, 6 * std::size_t(n), "surfel boxes"};
    /// [n_models,6] bounds of the box centres
    Array<std::uint32_t, shared::ModelBounds> bounds{device, 6 * std::size_t(n_models), "model bounds"};
    Array<std::uint32_t> scratch{device,
                                 std::max(kScratchWords* std::size_t(round_up_4(n)),
                                          kSlotsAt* std::size_t(round_up_4(n)) + 8 * std::size_t(max_nodes)),
                                 "acceleration structure scratch"};
    /// binary nodes that become wide nodes
    Array<std::uint32_t, shared::BinaryRoots> queue{device, max_nodes, "collapse queue"};
    /// number of queue entries per level
    Array<std::uint32_t, shared::LevelSizes> level_sizes{device, max_levels() + 1, "collapse levels"};
    Array<glm::uvec2, shared::SumsOfTiles> tiles{device, surfel_tiles(n), "collapse sums"};
    Array<shared::BvhNode> nodes{device, max_nodes, "wide nodes"};
    Array<std::uint32_t, shared::LeafOrder> order{device, n, "surfels in leaf order"};
    /// [max_nodes] two indices per node: its parent, and the first surfel of the model
    /// that contains the node
    Array<glm::uvec2, shared::WideLinks> links{device, max_nodes, "wide node links"};
    /// [max_nodes,6] boxes of the nodes before quantisation
    Array<float, shared::WideBoxes> node_boxes{device, 6 * std::size_t(max_nodes), "wide node boxes"};
    /// [max_nodes] number of children whose boxes are finished
    Array<std::uint32_t, shared::Arrivals> arrivals{device, max_nodes, "wide node arrivals"};
    Array<std::uint32_t, shared::WideCount> n_used_nodes{device, 1, "wide node count"};
    /// [n_instances] like `root_of`, but RELIDAR_BVH_NO_NODE for an absent instance
    Array<std::uint32_t, shared::InstanceRoots> roots{device, n_instances, "instance roots"};
    Array<std::uint32_t, shared::TopOrder> top_order{device, n_instances, "instances in leaf order"};
    Array<shared::BvhNode> top_node_array{device, count_top_nodes(n_instances), "top nodes"};
    Array<float, shared::InstanceBoxes> top_boxes{
        device, 6 * (std::size_t(n_instances) + count_top_nodes(n_instances)), "instance boxes"};
    Array<glm::uvec2> top_keys{device, std::bit_ceil(std::max(n_instances, 1u)), "instance keys"};
    Array<float, shared::CostSums> cost_sums{device, count_workgroups(max_nodes), "cost sums"};
    ReadbackBuffer costs{device, count_workgroups(max_nodes) * sizeof(float), "cost sums"};

    Impl(Device& d, const DeviceScene& scene)
        : device(d),
          n(scene.size()),
          n_models(std::uint32_t(scene.layout().models.size())),
          n_instances(std::uint32_t(scene.layout().instances.size())),
          primitive(scene.primitive()),
          model_roots(n_models) {
        std::iota(model_roots.begin(), model_roots.end(), 0u);
        upload_roots(scene.layout());
    }
    void upload_roots(const Scene& layout) {
        std::vector<std::uint32_t> instance_roots;
        for (const ModelInstance& instance : layout.instances)
            instance_roots.push_back(model_roots[instance.model]);
        root_of.upload(instance_roots);
    }
    void allocate_instances(std::size_t capacity);
    void reserve_nodes(std::size_t n_surfels, std::size_t n_nodes);
    void append_nodes(const Impl& added, std::uint32_t first_node, std::uint32_t first_surfel);
    shared::BvhBinary binary_bvh() const;
    shared::BvhWide wide_bvh() const;
    ScratchArray scratch_at(std::uint32_t words_per_surfel) const {
        return {scratch, words_per_surfel * std::size_t(round_up_4(n))};
    }
    std::uint32_t max_levels() const;
    shared::BvhWideParams wide_params(const DeviceScene& scene) const;
    void collapse_tree(Stream& stream, const DeviceScene& scene);
    std::uint32_t n_key_bits() const {
        return 3 * RELIDAR_BVH_MORTON_BITS + std::uint32_t(std::bit_width(std::max(n_models, 1u) - 1));
    }
    void compute_boxes(Stream& s, const DeviceScene& scene, const AccelOptions& o, SurfelRange range) {
        // The software tree needs only boxes, so vertices and reach are null.
        run(s, proxies, range.count,
            {.records = scene.surfel_records().address(),
             .vertices = {},
             .boxes = boxes.address(),
             .reach = {},
             .alpha_min = scene.alpha_min(),
             .margin_m = o.margin_m,
             .margin_scale = o.margin_scale,
             .first_surfel = range.first,
             .n_surfels = range.count});
    }
    void compute_bounds(Stream& stream, const DeviceScene& scene);
    void sort_surfels(Stream& stream, const DeviceScene& scene);
    void compute_node_boxes(Stream& stream, std::uint32_t first_surfel, std::uint32_t last_surfel) {
        run(stream, refit_kernel, n_refitting,
            {.wide = wide_bvh(),
             .boxes = boxes.address(),
             .bound = max_nodes,
             .first_surfel = first_surfel,
             .last_surfel = last_surfel});
    }
};

/// Returns an upper bound of the number of tree levels: the levels of a full tree with
/// `max_nodes` nodes, plus 4 because real trees are uneven.
std::uint32_t Bvh::Impl::max_levels() const {
    std::uint32_t n_levels = 4;
    for (std::uint64_t width = n_models; width < max_nodes; width *= RELIDAR_BVH_WIDTH) ++n_levels;
    return n_levels;
}

shared::BvhBinary Bvh::Impl::binary_bvh() const {
    return {.children = scratch_at(kChildrenAt),
            .boxes = scratch_at(kBoxesAt),
            .costs = scratch_at(kCostsAt),
            .decisions = scratch_at(kDecisionsAt),
            .spares = scratch_at(kSparesAt)};
}

shared::BvhWide Bvh::Impl::wide_bvh() const {
    return {.nodes = nodes.address(),
            .order = order.address(),
            .links = links.address(),
            .boxes = node_boxes.address(),
            .arrivals = arrivals.address(),
            .count = n_used_nodes.address()};
}

/// Computes the bounds of each model. They are minima, which the kernel computes with
/// atomics, so they start at the largest number.
void Bvh::Impl::compute_bounds(Stream& stream, const DeviceScene& scene) {
    stream.fill(bounds, 0xffffffffu);
    run(stream, bounds_kernel, std::size_t(surfel_tiles(n)) * kWorkgroupSize,
        {.boxes = boxes.address(),
         .models = scene.model_table().address(),
         .bounds = bounds.address(),
         .n_surfels = n,
         .n_models = n_models});
}

/// Sorts the surfels by model and by the Morton codes of their means (positions on a
/// curve that fills the bounds of the model). Neighbours in the list are then close in
/// space. Writes the sorted keys to kKeysAt and the surfels in this order to kValuesAt.
void Bvh::Impl::sort_surfels(Stream& stream, const DeviceScene& scene) {
    compute_bounds(stream, scene);
    // Each pass of the radix sort moves the keys from one buffer to the other. An odd
    // number of passes starts in the second, so that the result is in the first.
    const SortBuffers first{.keys = scratch_at(kKeysAt), .order = scratch_at(kValuesAt)};
    const SortBuffers second{.keys = scratch_at(kSecondKeysAt), .order = scratch_at(kSecondValuesAt)};
    const bool starts_in_second = RadixSort::pass_count(n_key_bits()) % 2 == 1;
    // The kernel also initialises `other_ends` and `demands`, which later kernels update.
    run(stream, keys_kernel, n,
        {.records = scene.surfel_records().address(),
         .models = scene.model_table().address(),
         .bounds = bounds.address(),
         .keys = scratch_at(starts_in_second ? kSecondKeysAt : kKeysAt),
         .other_ends = scratch_at(kOtherEndsAt),
         .demands = scratch_at(kDemandsAt),
         .n_surfels = n,
         .n_models = n_models});
    if (starts_in_second) sort.run(stream, second, first, n_key_bits());
    else sort.run(stream, first, second, n_key_bits());
}

/// Returns the parameters that the five kernels of collapse_tree() share.
shared::BvhWideParams Bvh::Impl::wide_params(const DeviceScene& scene) const {
    return {.tree = binary_bvh(),
            .wide = wide_bvh(),
            .queue = queue.address(),
            .slots = scratch_at(kSlotsAt),  // children of each wide node
            .level_sizes = level_sizes.address(),
            .demands = scratch_at(kDemandsAt),  // of a node: wide children, surfels in leaves
            .offsets = scratch_at(kOffsetsAt),  // sums of the demands before a node in its tile
            .tiles = tiles.address(),           // sums of the demands of all earlier tiles
            .places = scratch_at(kWideNodeIndicesAt),
            .surfels = scratch_at(kValuesAt),  // sorted
            .models = scene.model_table().address(),
            .n_surfels = n,
            .n_tiles = surfel_tiles(n),
            .n_models = n_models,
            .bound = max_nodes,
            .level = 0};
}

/// Converts the binary trees of all models to wide trees. A wide node replaces a binary
/// node and some of the nodes below it, and has up to eight children.
void Bvh::Impl::collapse_tree(Stream& stream, const DeviceScene& scene) {
    stream.fill(level_sizes);
    shared::BvhWideParams params = wide_params(scene);
    // Chooses which binary nodes become wide nodes, from the roots down, one level per
    // launch, and lists them in `queue`. The host does not know the number of nodes of a
    // level, so each launch has enough threads for the largest possible level.
    std::uint64_t max_level_nodes = n_models;
    while (params.level < max_levels() - 1) {
        run(stream, choose_level, max_level_nodes, params);
        max_level_nodes = std::min<std::uint64_t>(max_level_nodes * RELIDAR_BVH_WIDTH, max_nodes);
        ++params.level;
    }
    run(stream, choose_remaining, kWorkgroupSize, params);  // deeper levels of uneven trees

    // Numbers the wide nodes by prefix sums of demands in tiles, and writes them.
    run(stream, sum_tiles, std::size_t(surfel_tiles(n)) * kWorkgroupSize, params);
    run(stream, sum_earlier_tiles, kWorkgroupSize, params);
    run(stream, number_nodes, max_nodes, params);
    run(stream, write_nodes, max_nodes, params);
}

/// Makes all trees empty. A build does not change the tree of a model without surfels.
Bvh::Bvh(Device& device, const DeviceScene& scene) : impl_(std::make_unique<Impl>(device, scene)) {
    Stream stream(device);
    stream.fill(impl_->nodes);
    stream.fill(impl_->arrivals);
    stream.fill(impl_->n_used_nodes);
    stream.fill(impl_->links, RELIDAR_BVH_NO_NODE);
    stream.fill(impl_->queue, RELIDAR_BVH_NO_NODE);
    stream.submit_and_wait();
}

Bvh::~Bvh() = default;

/// Submits the kernels of a build: surfel boxes, sort, binary trees (H-PLOC), conversion
/// to wide nodes, boxes of the wide nodes, and the top-level tree.
void Bvh::build_trees(Stream& stream, const DeviceScene& scene, const AccelOptions& options) {
    Impl& bvh = *impl_;
    bvh.compute_boxes(stream, scene, options, {0, bvh.n});
    bvh.sort_surfels(stream, scene);
    run(stream, bvh.cluster, bvh.n,
        {.tree = bvh.binary_bvh(),
         .boxes = bvh.boxes.address(),
         .keys = bvh.scratch_at(kKeysAt),
         .surfels = bvh.scratch_at(kValuesAt),
         .models = scene.model_table().address(),
         .other_ends = bvh.scratch_at(kOtherEndsAt),
         .clusters = bvh.scratch_at(kClustersAt),
         .roots = bvh.queue.address(),
         .n_surfels = bvh.n,
         .n_models = bvh.n_models});
    bvh.collapse_tree(stream, scene);
    bvh.compute_node_boxes(stream, 0, kAllModels);
    rebuild_top_level(stream, scene);
}

void Bvh::refit_trees(Stream& stream, const DeviceScene& scene, const AccelOptions& options,
                      const SurfelRanges& ranges) {
    for (const SurfelRange& range : ranges) {
        if (range.count == 0) continue;
        impl_->compute_boxes(stream, scene, options, range);
        impl_->compute_node_boxes(stream, range.first, range.first + range.count - 1);
    }
    rebuild_top_level(stream, scene);
}

void Bvh::rebuild_top_level(Stream& stream, const DeviceScene& scene) {
    Impl& bvh = *impl_;
    // One workgroup builds the tree over all instances, whose number is small. It sorts
    // them, which needs a power of two of keys (`n_padded`).
    run(stream, bvh.top, kWorkgroupSize,
        {.bvh = bvh_addresses(),
         .instances = scene.instance_table().address(),
         .root_of = bvh.root_of.address(),
         .node_boxes = bvh.node_boxes.address(),
         .boxes = bvh.top_boxes.address(),
         .keys = bvh.top_keys.address(),
         .n_instances = bvh.n_instances,
         .n_padded = std::uint32_t(bvh.top_keys.size())});
}

/// Replaces the arrays of the top-level tree by larger ones.
void Bvh::Impl::allocate_instances(std::size_t capacity) {
    const std::uint32_t n_top = count_top_nodes(std::uint32_t(capacity));
    root_of = {device, capacity, "roots of models"};
    roots = {device, capacity, "instance roots"};
    top_order = {device, capacity, "instances in leaf order"};
    top_node_array = {device, n_top, "top nodes"};
    top_boxes = {device, 6 * (capacity + n_top), "instance boxes"};
    top_keys = {device, std::bit_ceil(capacity), "instance keys"};
}

/// Enlarges the arrays that are read after a build.
void Bvh::Impl::reserve_nodes(std::size_t n_surfels, std::size_t n_nodes) {
    boxes.reserve(device, 6 * n_surfels, "surfel boxes");
    order.reserve(device, n_surfels, "surfels in leaf order");
    nodes.reserve(device, n_nodes, "wide nodes");
    links.reserve(device, n_nodes, "wide node links");
    node_boxes.reserve(device, 6 * n_nodes, "wide node boxes");
    arrivals.reserve(device, n_nodes, "wide node arrivals");
}

/// Copies the nodes of an added tree, and the two links of each node, behind the other
/// nodes. Indices of the added tree count from 0, so the number of earlier nodes or
/// surfels is added to them.
void Bvh::Impl::append_nodes(const Impl& added, std::uint32_t first_node, std::uint32_t first_surfel) {
    std::vector<shared::BvhNode> added_nodes = added.nodes.download(added.max_nodes);
    for (shared::BvhNode& node : added_nodes) {
        node.first_child += first_node;
        node.first_leaf += first_surfel;
    }
    std::vector<glm::uvec2> added_links = added.links.download(added.max_nodes);
    for (glm::uvec2& link : added_links) {
        std::uint32_t &parent_node = link.x, &model_surfel = link.y;
        // A root has no parent, and an unused node has neither link.
        if (parent_node != RELIDAR_BVH_NO_NODE) parent_node += first_node;
        if (model_surfel != RELIDAR_BVH_NO_NODE) model_surfel += first_surfel;
    }
    nodes.upload(added_nodes, first_node);
    links.upload(added_links, first_node);
}

void Bvh::append_tree(const DeviceScene& scene, const Bvh& added) {
    constexpr std::size_t kBoxFloats = 6;  // two corners
    Impl& trees = *impl_;
    const Impl& tree = *added.impl_;
    const std::uint32_t first_node = trees.max_nodes, first_surfel = scene.layout().models.back().first;
    const std::uint32_t n_nodes = first_node + tree.max_nodes, n_surfels = first_surfel + tree.n;
    if (n_surfels > trees.order.size() || n_nodes > trees.nodes.size())
        reserve_spare(n_surfels, [&](std::size_t capacity) {
            const std::size_t n_spare_surfels = capacity - n_surfels;
            trees.reserve_nodes(capacity, n_nodes + n_spare_surfels / 4);  // see max_node_count()
        });
    // Arrays with an entry per node. A refit counts in `arrivals` from 0.
    trees.append_nodes(tree, first_node, first_surfel);
    trees.node_boxes.upload(tree.node_boxes.download(kBoxFloats * tree.max_nodes), kBoxFloats * first_node);
    trees.arrivals.upload(std::vector<std::uint32_t>(tree.max_nodes, 0u), first_node);
    // Arrays with an entry per surfel. `order` counts from the model's first surfel.
    trees.order.upload(tree.order.download(tree.n), first_surfel);
    trees.boxes.upload(tree.boxes.download(kBoxFloats * tree.n), kBoxFloats * first_surfel);

    const std::uint32_t n_added_nodes = tree.n_used_nodes.download().front();
    trees.n_used_nodes.upload(std::vector<std::uint32_t>{first_node + n_added_nodes});
    trees.model_roots.resize(scene.layout().models.size(), RELIDAR_BVH_NO_NODE);
    trees.model_roots.back() = first_node;
    trees.max_nodes = n_nodes;
    trees.n = n_surfels;
}

void Bvh::append_instances(const DeviceScene& scene) {
    Impl& bvh = *impl_;
    const std::size_t n = scene.layout().instances.size();
    if (n > bvh.roots.size())
        reserve_spare(n, [&](std::size_t capacity) { bvh.allocate_instances(capacity); });
    bvh.n_instances = std::uint32_t(n);
    bvh.upload_roots(scene.layout());
}

shared::BvhPointers Bvh::bvh_addresses() const {
    const Impl& bvh = *impl_;
    return {.nodes = bvh.nodes.address(),
            .order = bvh.order.address(),
            .roots = bvh.roots.address(),
            .top_nodes = bvh.top_node_array.address(),
            .top_order = bvh.top_order.address()};
}

HostBvhCopy Bvh::download_bvh() const {
    const Impl& b = *impl_;
    HostBvhCopy host{b.nodes.download(),          b.order.download(),     b.roots.download(),
                     b.top_node_array.download(), b.top_order.download(), b.boxes.download()};
    host.nodes.resize(std::min<std::size_t>(b.n_used_nodes.download().front(), host.nodes.size()));
    return host;
}

/// Submits the kernel that measures how expensive the trees are: the sum of the areas of
/// all boxes, each times the cost of testing the node or the leaf in it. A ray enters a
/// box with a probability proportional to its area. read_cost() returns the result.
void Bvh::measure_cost(Stream& stream) {
    Impl& bvh = *impl_;
    // Each workgroup writes the sum of its nodes. The array of these sums does not grow
    // with appended trees, so the cost does not include their nodes.
    const std::size_t max_measured = kWorkgroupSize * bvh.cost_sums.size();
    const auto n_nodes = std::uint32_t(std::min<std::size_t>(bvh.max_nodes, max_measured));
    run(stream, bvh.cost_kernel, n_nodes,
        {.wide = bvh.wide_bvh(),
         .boxes = bvh.boxes.address(),
         .sums = bvh.cost_sums.address(),
         .bound = n_nodes});
    bvh.costs.record_copy(stream, bvh.cost_sums.buffer(), bvh.cost_sums.size() * sizeof(float));
}

std::optional<double> Bvh::read_cost(Stream& stream) {
    Impl& bvh = *impl_;
    if (!bvh.costs.is_pending()) return std::nullopt;
    const float* sums = static_cast<const float*>(bvh.costs.wait_for_bytes(stream));
    return std::accumulate(sums, sums + bvh.cost_sums.size(), 0.0);
}

}  // namespace relidar
