// SPDX-License-Identifier: Apache-2.0
// Runs inference with a trained ray-drop network, which predicts the rays that have no
// return.
#include <algorithm>
#include <list>
#include <optional>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/network_training.hpp>

#include "base/assert.hpp"
#include "diff/network/drop_inputs.hpp"
#include "diff/network/drop_loss.hpp"
#include "diff/network/drop_network.hpp"
#include "diff/network/unet.hpp"

namespace relidar {
namespace {

const DropNetwork& check_network(const DropNetwork& network) {
    if (network.widths.empty() || network.inputs.empty() || (network.taps != 1 && network.taps != 9))
        throw DataError(
            "cannot use the ray-drop network: its list of channels or inputs is empty or its kernel "
            "size is invalid");
    const refine::UnetPlan plan(network);
    const auto check = [](const char* description, std::size_t found, std::size_t expected) {
        if (found != expected)
            throw DataError(
                fmt::format("cannot use the ray-drop network: found {} {}, expected {} for its channels",
                            found, description, expected));
    };
    check("parameters", network.parameters.size(), plan.n_parameters);
    check("running moments", network.running.size(), plan.n_running);
    check("normalisation values", network.normalisation.size(), 2 * network.inputs.size());
    return network;
}

}  // namespace

void compile_drop_network(Device& device, const RefineOptions& options) {
    DropNetwork network = refine::make_network_shape(options);
    const refine::UnetPlan plan(network);
    refine::initialise(network, plan, 0);
    network.normalisation.assign(2 * network.inputs.size(), 0.0f);
    const refine::DropInputs inputs(device, network);
    const refine::Unet unet(device, network);
    const refine::DropLoss loss(device, 1);
}

namespace {

/// The network with memory for images of one size.
struct ShapedNetwork {
    refine::Grid grid{};
    refine::DropInputs inputs;
    refine::Unet unet;
    std::optional<refine::DropLoss> loss = {};
    Array<float, shared::DropProbabilities> probability = {};

    ShapedNetwork(Device& device, const DropNetwork& network)
        : inputs(device, network), unet(device, network) {}

    void reserve(Device& device, const refine::Grid& image_grid) {
        grid = image_grid;
        unet.reserve(device, grid, false);
        probability = {device, grid.pixels(), "drop probabilities"};
        loss.emplace(device, grid.pixels());
    }
};

}  // namespace

struct DropPass::Impl {
    // Number of image sizes for which memory is kept. Two, because a vehicle may have a
    // large and a small LiDAR that are rendered alternately.
    static constexpr std::size_t kShapes = 2;

    Device& device;
    DropNetwork network;
    std::list<ShapedNetwork> shaped;  ///< most recently used first

    Impl(Device& d, const DropNetwork& n) : device(d), network(check_network(n)) {
        shaped.emplace_front(device, network);
    }

    ShapedNetwork& get_network_for_shape(Stream& stream, const refine::Grid& image) {
        auto place = std::ranges::find(shaped, image, &ShapedNetwork::grid);
        const bool is_new = place == shaped.end();
        if (is_new) place = std::ranges::find(shaped, refine::Grid{}, &ShapedNetwork::grid);
        if (place == shaped.end() && shaped.size() < kShapes)
            place = shaped.emplace(shaped.end(), device, network);
        if (place == shaped.end()) {
            // The device may still use the arrays of the size that is replaced below.
            stream.finish();
            --place;
        }
        shaped.splice(shaped.begin(), shaped, place);
        if (is_new) place->reserve(device, image);
        return *place;
    }
};

DropPass::DropPass(Device& device, const DropNetwork& network) : impl_(new Impl(device, network)) {}
DropPass::~DropPass() = default;

const DropNetwork& DropPass::network() const { return impl_->network; }

const Array<float, shared::DropProbabilities>& DropPass::run(
    Stream& stream, int rows, int columns, const Array<float, shared::DropSamples>& channels) {
    Impl& r = *impl_;
    if (const int side = r.network.smallest_side(); rows < side || columns < side)
        throw DataError(fmt::format(
            "cannot apply the ray-drop network: the image has {} x {} pixels, expected at least {} "
            "rows and columns",
            rows, columns, side));
    const refine::Grid grid{1, std::uint32_t(rows), std::uint32_t(columns)};
    RELIDAR_ASSERT_LE(r.network.inputs.size() * grid.pixels(), channels.size());
    ShapedNetwork& shaped = r.get_network_for_shape(stream, grid);
    const refine::DropInputs::Chosen whole{};
    shaped.inputs.make(stream, {&whole, 1}, channels.address(), shaped.unet.inputs());
    shaped.unet.evaluate(stream);
    shaped.loss->run(stream, grid.pixels(),
                     {.logit = shaped.unet.logit().values.address().as<shared::DropLogits>(),
                      .start = r.network.residual ? shaped.inputs.start().address()
                                                  : Address<float, shared::StartLogits>(),
                      .probability = shaped.probability.address()},
                     0);
    return shaped.probability;
}

struct DropRefiner::Impl {
    Device& device;
    DropPass pass;
    Stream stream;
    Array<float, shared::DropSamples> channels;

    Impl(Device& d, const DropNetwork& n) : device(d), pass(d, n), stream(d, d.info().timestamps) {}
};

DropRefiner::DropRefiner(Device& device, const DropNetwork& network) : impl_(new Impl(device, network)) {}
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
