// SPDX-License-Identifier: Apache-2.0
// Common interface of the acceleration structures of the Vulkan driver and of relidar.
// Decides whether an update rebuilds a structure or only refits its boxes.
#include <relidar/diff/accel.hpp>

#include "diff/accel/bvh.hpp"
#include "diff/accel/hardware.hpp"

namespace relidar {

ProxyShape resolve_proxy(ProxyShape requested_shape, const Device& device) {
    if (device.backend() == RayTracingBackend::software) return ProxyShape::boxes;
    if (requested_shape != ProxyShape::automatic) return requested_shape;
    // GPUs intersect triangles faster than boxes, because they do so in hardware.
    return device.info().type == "CPU" ? ProxyShape::boxes : ProxyShape::triangles;
}

struct AccelerationStructure::Impl {
    AccelOptions options;
    ProxyShape proxy;
    std::unique_ptr<RayQueryAccel> hardware;  ///< exactly one of `hardware` and `software` is not null
    std::unique_ptr<Bvh> software;
    bool built = false;
    /// True if the traversal cost of the tree has grown too much since the last build.
    /// The next update then rebuilds the tree.
    bool outgrown = false;
    int refits = 0;                ///< number of refits since the last build
    bool measured = false;         ///< true if the cost was measured after the last build
    double cost_when_built = 0.0;  ///< cost after the last build, or 0 if it was not measured yet
    std::uint64_t n_updates = 0;

    Impl(Device& d, const DeviceScene& s, const AccelOptions& o) : options(o) {
        proxy = resolve_proxy(o.proxy, d);
        if (d.backend() == RayTracingBackend::software) software = std::make_unique<Bvh>(d, s);
        else hardware = std::make_unique<RayQueryAccel>(d, s, proxy);
    }

    void build_tree(Stream& stream, const DeviceScene& scene) {
        if (hardware) hardware->record_build(stream, scene, options, {{0, scene.size()}}, BuildMode::build);
        else software->build_trees(stream, scene, options);
    }
    void refit_tree(Stream& stream, const DeviceScene& scene, const SurfelRanges& ranges) {
        if (hardware) hardware->record_build(stream, scene, options, ranges, BuildMode::refit);
        else software->refit_trees(stream, scene, options, ranges);
    }
};

namespace {

/// Returns the surfel ranges of all models that walk (have a length of stride), because
/// their shape changes. Joins adjacent ranges.
SurfelRanges animated_ranges(const std::vector<SurfelModel>& models) {
    SurfelRanges ranges;
    for (const SurfelModel& model : models) {
        const bool walks = model.stride_m > 0.0f;
        if (!walks || model.count == 0) continue;
        const bool is_adjacent = !ranges.empty() && ranges.back().first + ranges.back().count == model.first;
        if (is_adjacent) ranges.back().count += model.count;
        else ranges.push_back({model.first, model.count});
    }
    return ranges;
}

}  // namespace

AccelerationStructure::AccelerationStructure(Device& d, const DeviceScene& scene, const AccelOptions& o) {
    impl_ = std::make_unique<Impl>(d, scene, o);
}
AccelerationStructure::~AccelerationStructure() = default;

void AccelerationStructure::record_refit(Stream& stream, const DeviceScene& scene, bool force_rebuild) {
    Impl& a = *impl_;
    const bool is_old = a.options.rebuild_every > 0 && a.refits >= a.options.rebuild_every;
    const bool must_rebuild = force_rebuild || !a.built || a.outgrown || is_old;
    ++a.n_updates;
    if (!must_rebuild) {
        a.refit_tree(stream, scene, {{0, scene.size()}});
        ++a.refits;
        return;
    }
    a.build_tree(stream, scene);
    a.built = true;
    a.outgrown = false;
    a.refits = 0;
    a.measured = false;
    a.cost_when_built = 0.0;
}

void AccelerationStructure::refit_animated(Stream& stream, const DeviceScene& scene) {
    Impl& a = *impl_;
    if (!a.built) return record_refit(stream, scene);
    // Does not increase `refits`, which triggers rebuilds because refits degrade a tree.
    // A walking actor repeats the same shapes, so its refits do not degrade the tree.
    a.refit_tree(stream, scene, animated_ranges(scene.layout().models));
    ++a.n_updates;
}

void AccelerationStructure::record_top_level(Stream& stream, const DeviceScene& scene) {
    if (impl_->hardware) impl_->hardware->rebuild_top_level(stream, scene);
    else impl_->software->rebuild_top_level(stream, scene);
}

void AccelerationStructure::append_model(Stream& stream, const DeviceScene& scene, const DeviceScene& added) {
    Impl& a = *impl_;
    if (a.hardware) {
        // Builds the tree of this model. The other models keep their trees.
        const SurfelModel& model = scene.layout().models.back();
        a.hardware->append_model(scene);
        a.hardware->record_build(stream, scene, a.options, {{model.first, model.count}}, BuildMode::build);
        stream.submit_and_wait();
        return;
    }
    // Builds a separate tree, then copies it behind the other trees.
    Bvh tree(stream.device(), added);
    tree.build_trees(stream, added, a.options);
    stream.submit_and_wait();
    a.software->append_tree(scene, tree);
}

void AccelerationStructure::append_instances(const DeviceScene& scene) {
    if (impl_->hardware) impl_->hardware->reserve_instances(scene);
    else impl_->software->append_instances(scene);
}

void AccelerationStructure::record_cost(Stream& stream) {
    Impl& a = *impl_;
    if (!a.software || !a.built) return;
    const std::optional<double> cost = a.software->read_cost(stream);
    // `measured` is false if the cost was measured before the last build.
    if (cost && a.measured) {
        if (a.cost_when_built <= 0.0) a.cost_when_built = *cost;
        a.outgrown = *cost > double(a.options.rebuild_growth) * a.cost_when_built;
    }
    a.software->measure_cost(stream);
    a.measured = true;
}

AccelAddresses AccelerationStructure::addresses() const {
    if (impl_->hardware) return impl_->hardware->addresses();
    AccelAddresses addresses;
    addresses.bvh = impl_->software->bvh_addresses();
    return addresses;
}

ProxyShape AccelerationStructure::proxy_shape() const { return impl_->proxy; }
std::uint64_t AccelerationStructure::n_updates() const { return impl_->n_updates; }
int AccelerationStructure::n_refits() const { return impl_->refits; }

}  // namespace relidar
