// SPDX-License-Identifier: Apache-2.0
// Asking a trained network.
#include <optional>

#include <fmt/format.h>

#include <relidar/error.hpp>
#include <relidar/measure/refine.hpp>
#include <relidar/stages/refine.hpp>

#include "core/assert.hpp"
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

struct DropPass::Impl {
    Device& device;
    DropNetwork network;
    refine::DropInputs inputs;
    refine::Unet unet;
    std::optional<refine::DropLoss> loss;
    Array<float, shared::DropProbabilities> probability;
    refine::Grid grid{};   ///< of the last image

    Impl(Device& d, const DropNetwork& n, refine::Precision precision)
        : device(d), network(checked(n)), inputs(d, n), unet(d, n, precision) {}

    void reserve(Stream& stream, const refine::Grid& of_image) {
        if (loss && of_image.rows == grid.rows && of_image.columns == grid.columns) return;
        stream.finish();   // what is there may be in use
        grid = of_image;
        unet.reserve(device, grid, false);
        probability = {device, grid.pixels(), "drop probabilities"};
        loss.emplace(device, grid.pixels());
    }
};

DropPass::DropPass(Device& device, const DropNetwork& network, const std::string& precision)
    : impl_(new Impl(device, network, refine::find_precision(precision))) {}
DropPass::~DropPass() = default;

const DropNetwork& DropPass::network() const { return impl_->network; }

const Array<float, shared::DropProbabilities>& DropPass::run(Stream& stream, int rows, int columns,
                                                             const Array<float, shared::DropSamples>& channels) {
    Impl& r = *impl_;
    if (const int side = r.network.smallest_side(); rows < side || columns < side)
        throw DataError(fmt::format("refining ray-drop: found {} x {} pixels, expected at least {} of each", rows, columns, side));
    const refine::Grid grid{1, std::uint32_t(rows), std::uint32_t(columns)};
    RELIDAR_ASSERT_LE(r.network.inputs.size() * grid.pixels(), channels.size());
    r.reserve(stream, grid);
    const refine::DropInputs::Chosen whole{};
    r.inputs.make(stream, {&whole, 1}, channels.address(), r.unet.inputs());
    r.unet.evaluate(stream);
    r.loss->run(stream, grid.pixels(),
                {.logit = r.unet.logit().address().as<shared::DropLogits>(),
                 .start = r.network.residual ? r.inputs.start().address() : Address<float, shared::StartLogits>(),
                 .probability = r.probability.address()},
                0);
    return r.probability;
}

struct DropRefiner::Impl {
    Device& device;
    DropPass pass;
    Stream stream;
    Array<float, shared::DropSamples> channels;

    Impl(Device& d, const DropNetwork& n, const std::string& precision)
        : device(d), pass(d, n, precision), stream(d, d.info().timestamps) {}
};

DropRefiner::DropRefiner(Device& device, const DropNetwork& network, const std::string& precision)
    : impl_(new Impl(device, network, precision)) {}
DropRefiner::~DropRefiner() = default;
DropRefiner::DropRefiner(DropRefiner&&) noexcept = default;
DropRefiner& DropRefiner::operator=(DropRefiner&&) noexcept = default;

const DropNetwork& DropRefiner::network() const { return impl_->pass.network(); }
const KernelTimes& DropRefiner::times() const { return impl_->stream.times(); }
DropPass& DropRefiner::pass() { return impl_->pass; }

std::vector<float> DropRefiner::refine(const DropImage& image) {
    Impl& r = *impl_;
    refine::check_image(network(), image, "refining ray-drop");
    r.stream.finish();
    r.channels.reserve(r.device, image.channels.size(), "a scan to refine");
    r.channels.upload(image.channels);
    const auto& probability = r.pass.run(r.stream, image.rows, image.columns, r.channels);
    r.stream.finish();
    return probability.download();
}

}  // namespace relidar
