// SPDX-License-Identifier: Apache-2.0
// Asking a trained network.
#include <optional>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/measure/refine.hpp>

#include "refine/drop_inputs.hpp"
#include "refine/drop_loss.hpp"
#include "refine/drop_network.hpp"
#include "refine/unet.hpp"

namespace relidar {
namespace {

const DropNetwork& checked(const DropNetwork& network) {
    if (network.widths.empty() || network.inputs.empty() || (network.taps != 1 && network.taps != 9))
        throw DataError("a ray-drop network: found no channels or inputs, expected those it was trained with");
    const refine::UnetPlan plan(network);
    const auto check = [](const char* what, std::size_t found, std::size_t expected) {
        if (found != expected)
            throw DataError(fmt::format("a ray-drop network: found {} {}, expected {} for its channels", found, what, expected));
    };
    check("parameters", network.parameters.size(), plan.n_parameters);
    check("running moments", network.running.size(), plan.n_running);
    check("numbers of the normalisation", network.normalisation.size(), 2 * network.inputs.size());
    return network;
}

}  // namespace

void compile_drop_network(Device& device, const RefineOptions& options) {
    DropNetwork network = refine::shape_of(options);
    const refine::UnetPlan plan(network);
    refine::initialise(network, plan, 0);
    network.normalisation.assign(2 * network.inputs.size(), 0.0f);
    const refine::Storage storage = refine::find_storage(options.storage);
    const refine::DropInputs inputs(device, network, storage);
    const refine::Unet unet(device, network, refine::find_precision(options.precision), storage);
    const refine::DropLoss loss(device, 1, storage);
}

struct DropRefiner::Impl {
    Device& device;
    DropNetwork network;
    refine::DropInputs inputs;
    refine::Unet unet;
    Stream stream;
    std::optional<refine::DropLoss> loss;
    Array<float, shared::DropProbabilities> probability;

    Impl(Device& d, const DropNetwork& n, refine::Precision precision)
        : device(d), network(checked(n)), inputs(d, n), unet(d, n, precision), stream(d, d.info().timestamps) {}
};

DropRefiner::DropRefiner(Device& device, const DropNetwork& network, const std::string& precision)
    : impl_(new Impl(device, network, refine::find_precision(precision))) {}
DropRefiner::~DropRefiner() = default;
DropRefiner::DropRefiner(DropRefiner&&) noexcept = default;
DropRefiner& DropRefiner::operator=(DropRefiner&&) noexcept = default;

const DropNetwork& DropRefiner::network() const { return impl_->network; }
const KernelTimes& DropRefiner::times() const { return impl_->stream.times(); }

std::vector<float> DropRefiner::refine(const DropImage& image) {
    Impl& r = *impl_;
    refine::check_image(r.network, image, "refining ray-drop");
    const refine::Grid grid{1, std::uint32_t(image.rows), std::uint32_t(image.columns)};
    r.unet.reserve(r.device, grid, false);
    if (r.probability.size() != grid.pixels()) {
        r.probability = {r.device, grid.pixels(), "drop probabilities"};
        r.loss.emplace(r.device, grid.pixels());
    }
    r.inputs.keep(r.device, {&image, 1});
    const refine::DropInputs::Chosen whole{};
    r.inputs.make(r.stream, {&whole, 1}, r.unet.inputs());
    r.unet.evaluate(r.stream);
    r.loss->run(r.stream, grid.pixels(),
                {.logit = r.unet.logit().address().as<shared::DropLogits>(),
                 .start = r.network.residual ? r.inputs.start().address() : Address<float, shared::StartLogits>(),
                 .probability = r.probability.address()},
                0);
    r.stream.finish();
    return r.probability.download();
}

}  // namespace relidar
