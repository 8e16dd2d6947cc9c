// SPDX-License-Identifier: Apache-2.0
// Common interface of the two acceleration structures: the driver's and the software
// tree. Decides whether an update rebuilds the structure or only refits its boxes.
#include <relidar/diff/accel.hpp>

#include "diff/accel/bvh.hpp"
#include "diff/accel/hardware.hpp"

namespace relidar {

Proxy choose_proxy(Proxy proxy, const Device& device) {
    if (device.traversal() == Traversal::software) return Proxy::boxes;
    if (proxy != Proxy::automatic) return proxy;
    // Uses triangles on a GPU, which intersects triangles in hardware faster than boxes
    // (docs/performance.md).
    return device.info().type == "CPU" ? Proxy::boxes : Proxy::triangles;
}

struct Accel::Impl {
    AccelOptions options;
    Proxy proxy;
    std::unique_ptr<HardwareAccel> hardware;  ///< exactly one of `hardware` and `software` is not null
    std::unique_ptr<Bvh> software;
    bool built = false;
    /// True if the traversal cost of the tree has grown too much since the last build.
    /// The next update then rebuilds the tree.
    bool outgrown = false;
    int refits = 0;                ///< number of refits since the last build
    bool measured = false;         ///< True if the cost of the tree was measured since the last build.
    double cost_when_built = 0.0;  ///< cost after the last build, 0 if it is not known yet
    std::uint64_t n_updates = 0;

    Impl(Device& device, const DeviceScene& scene, const AccelOptions& o)
        : options(o), proxy(choose_proxy(o.proxy, device)) {
        if (device.traversal() == Traversal::software) software = std::make_unique<Bvh>(device, scene);
        else hardware = std::make_unique<HardwareAccel>(device, scene, proxy);
    }

    bool should_rebuild() const {
        return !built || outgrown || (options.rebuild_every > 0 && refits >= options.rebuild_every);
    }
    void build(Stream& stream, const DeviceScene& scene) {
        if (hardware) hardware->record(stream, scene, options, {{0, scene.size()}}, false);
        else software->build(stream, scene, options);
    }
    void refit(Stream& stream, const DeviceScene& scene, const std::vector<SurfelRange>& ranges) {
        if (hardware) hardware->record(stream, scene, options, ranges, true);
        else software->refit(stream, scene, options, ranges);
    }
};

namespace {

std::vector<SurfelRange> list_animated_surfel_ranges(const std::vector<Model>& models) {
    std::vector<SurfelRange> ranges;
    for (const Model& model : models) {
        if (model.count == 0 || model.stride_m <= 0.0f) continue;
        if (!ranges.empty() && ranges.back().first + ranges.back().count == model.first)
            ranges.back().count += model.count;
        else ranges.push_back({model.first, model.count});
    }
    return ranges;
}

}  // namespace

Accel::Accel(Device& device, const DeviceScene& scene, const AccelOptions& options)
    : impl_(std::make_unique<Impl>(device, scene, options)) {}
Accel::~Accel() = default;

void Accel::update(Stream& stream, const DeviceScene& scene, bool rebuild) {
    Impl& a = *impl_;
    const bool refit = !rebuild && !a.should_rebuild();
    ++a.n_updates;
    if (refit) {
        a.refit(stream, scene, {{0, scene.size()}});
        ++a.refits;
        return;
    }
    a.build(stream, scene);
    a.built = true;
    a.outgrown = false;
    a.refits = 0;
    a.measured = false;
    a.cost_when_built = 0.0;
}

void Accel::refit_animated_actors(Stream& stream, const DeviceScene& scene) {
    Impl& a = *impl_;
    if (!a.built) return update(stream, scene);
    // Refits the trees of walking actors. Such refits do not count towards a rebuild,
    // because walking repeats the same shapes, so the trees do not degrade.
    a.refit(stream, scene, list_animated_surfel_ranges(scene.layout().models));
    ++a.n_updates;
}

void Accel::move(Stream& stream, const DeviceScene& scene) {
    if (impl_->hardware) impl_->hardware->move(stream, scene);
    else impl_->software->move(stream, scene);
}

void Accel::measure_tree_cost(Stream& stream) {
    Impl& a = *impl_;
    if (!a.software || !a.built) return;
    if (const std::optional<double> cost = a.software->read_cost(stream); cost && a.measured) {
        if (a.cost_when_built <= 0.0) a.cost_when_built = *cost;
        a.outgrown = *cost > double(a.options.rebuild_growth) * a.cost_when_built;
    }
    a.software->record_cost_measurement(stream);
    a.measured = true;
}

AccelAddresses Accel::addresses() const {
    AccelAddresses addresses;
    if (impl_->software) addresses.bvh = impl_->software->pointers();
    else impl_->hardware->fill(addresses);
    return addresses;
}

Proxy Accel::proxy() const { return impl_->proxy; }
std::uint64_t Accel::updates() const { return impl_->n_updates; }
int Accel::refits_since_build() const { return impl_->refits; }
std::uint64_t Accel::memory_bytes() const {
    return impl_->hardware ? impl_->hardware->memory_bytes() : impl_->software->memory_bytes();
}

}  // namespace relidar
