// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <iterator>
#include <list>
#include <optional>

#include <relidar/diff/network_training.hpp>

#include "base/assert.hpp"
#include "base/fail.hpp"
#include "diff/network/drop_network.hpp"
#include "diff/network/unet.hpp"

namespace relidar {
namespace {

/// Checks that a network, for example from a file, has the sizes that its architecture
/// requires. Returns the network, so that an initialiser can call this function.
const RayDropNetwork& check_network(const RayDropNetwork& network) {
    if (network.widths.empty() || network.inputs.empty() || (network.taps != 1 && network.taps != 9))
        fail(
            "cannot use the ray-drop network: found {} levels, {} input channels and kernels of {} pixels, "
            "expected at least 1 level, at least 1 input channel, and kernels of 1 or 9 pixels",
            network.widths.size(), network.inputs.size(), network.taps);
    const network::UnetLayout layout(network);
    const auto check_size = [](const char* name, std::size_t found, std::size_t expected) {
        if (found != expected)
            fail("cannot use the ray-drop network: it has {} {}, but its architecture requires {}", found,
                 name, expected);
    };
    check_size("parameters", network.parameters.size(), layout.n_parameters);
    check_size("running moments", network.running.size(), layout.n_running);
    check_size("normalisation values", network.normalisation.size(), 2 * network.inputs.size());
    return network;
}

}  // namespace

void compile_network(Device& device, const RayDropNetworkOptions& options) {
    RayDropNetwork network = network::make_network(options);
    const network::UnetLayout plan(network);
    network::init_parameters(network, plan, 0);
    network.normalisation.assign(2 * network.inputs.size(), 0.0f);
    const network::RayDropInputs inputs(device, network);
    const network::Unet unet(device, network);
    const network::RayDropLoss loss(device, 1);
}

namespace {

/// A ray-drop network with arrays for images of one size. Its `grid` is empty until the
/// arrays are allocated.
struct SizedRayDropNetwork {
    network::ImageBatchSize grid{};
    network::RayDropInputs inputs;
    network::Unet unet;
    std::optional<network::RayDropLoss> loss = {};
    Array<float, shared::DropProbabilities> probability = {};

    SizedRayDropNetwork(Device& d, const RayDropNetwork& n) : inputs(d, n), unet(d, n) {}
};

}  // namespace

struct RayDropInference::Impl {
    // Number of image sizes for which memory is kept. It is two, because a vehicle may
    // have a large and a small LiDAR that are rendered in turn.
    static constexpr std::size_t kMaxImageSizes = 2;

    Device& device;
    RayDropNetwork network;
    std::list<SizedRayDropNetwork> shaped;  ///< most recently used first

    Impl(Device& d, const RayDropNetwork& n) : device(d), network(check_network(n)) {
        shaped.emplace_front(device, network);
    }

    /// Returns the network with arrays for an image size. Allocates missing arrays.
    SizedRayDropNetwork& network_for(Stream& stream, network::ImageBatchSize grid) {
        auto match = std::ranges::find(shaped, grid, &SizedRayDropNetwork::grid);
        const bool is_known = match != shaped.end();
        if (!is_known) match = claim_network(stream);
        shaped.splice(shaped.begin(), shaped, match);  // moves the match to the front
        if (is_known) return *match;
        match->grid = grid;
        match->unet.allocate(device, grid, false);
        match->probability = {device, grid.n_image_pixels(), "drop probabilities"};
        match->loss.emplace(device, grid.n_image_pixels());
        return *match;
    }

    /// Returns a network that can get arrays for another image size: one without a size,
    /// a new one, or the least recently used one.
    std::list<SizedRayDropNetwork>::iterator claim_network(Stream& stream) {
        const auto unsized = std::ranges::find(shaped, network::ImageBatchSize{}, &SizedRayDropNetwork::grid);
        if (unsized != shaped.end()) return unsized;
        if (shaped.size() < kMaxImageSizes) return shaped.emplace(shaped.end(), device, network);
        // Waits, because the device may still use the arrays of the old image size.
        stream.submit_and_wait();
        return std::prev(shaped.end());
    }
};

RayDropInference::RayDropInference(Device& d, const RayDropNetwork& n) : impl_(new Impl(d, n)) {}
RayDropInference::~RayDropInference() = default;

const RayDropNetwork& RayDropInference::network() const { return impl_->network; }

const Array<float, shared::DropProbabilities>& RayDropInference::record_drops(
    Stream& stream, int rows, int columns, bool circular,
    const Array<float, shared::DropSamples>& input_channels) {
    Impl& r = *impl_;
    if (const int side = r.network.min_image_size(); rows < side || columns < side)
        fail(
            "cannot apply the ray-drop network: the image has {} x {} pixels, expected at least {} rows and "
            "columns",
            rows, columns, side);
    const network::ImageBatchSize grid{1, std::uint32_t(rows), std::uint32_t(columns), circular};
    RELIDAR_ASSERT_LE(r.network.inputs.size() * grid.n_image_pixels(), input_channels.size());
    SizedRayDropNetwork& shaped = r.network_for(stream, grid);
    const network::RotatedSample unrotated_sample{};
    shaped.inputs.fill_batch(stream, {&unrotated_sample, 1}, shaped.unet.input_images(),
                             input_channels.address());
    shaped.unet.run_inference(stream);
    // Computes only probabilities. Without targets, the number of known pixels is 0.
    shaped.loss->record_loss(
        stream, grid.n_image_pixels(),
        {.logit = shaped.unet.logits().values.address().cast_tag<shared::DropLogits>(),
         .start = address_or_null(r.network.residual ? &shaped.inputs.rendered_logits() : nullptr),
         .probability = shaped.probability.address()},
        0);
    return shaped.probability;
}

struct RayDropRefiner::Impl {
    Device& device;
    RayDropInference pass;
    Stream stream{device, device.info().timestamps};
    Array<float, shared::DropSamples> channels = {};

    Impl(Device& d, const RayDropNetwork& n) : device(d), pass(d, n) {}
};

RayDropRefiner::RayDropRefiner(Device& d, const RayDropNetwork& n) : impl_(new Impl(d, n)) {}
RayDropRefiner::~RayDropRefiner() = default;
RayDropRefiner::RayDropRefiner(RayDropRefiner&&) noexcept = default;
RayDropRefiner& RayDropRefiner::operator=(RayDropRefiner&&) noexcept = default;

const RayDropNetwork& RayDropRefiner::network() const { return impl_->pass.network(); }
const KernelTimes& RayDropRefiner::times() const { return impl_->stream.times(); }
RayDropInference& RayDropRefiner::inference() { return impl_->pass; }

std::vector<float> RayDropRefiner::predict_drops(const RayDropImage& image) {
    Impl& r = *impl_;
    network::check_image(network(), image, "cannot apply the ray-drop network to a scan");
    r.stream.submit_and_wait();  // waits, because the device may still read `channels`
    r.channels.reserve(r.device, image.channels.size(), "input channels of the ray-drop network");
    r.channels.upload(image.channels);
    const auto& probability =
        r.pass.record_drops(r.stream, image.rows, image.columns, image.circular, r.channels);
    r.stream.submit_and_wait();
    return probability.download();
}

}  // namespace relidar
