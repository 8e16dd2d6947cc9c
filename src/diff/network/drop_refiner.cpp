// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <list>
#include <optional>

#include <relidar/diff/network_training.hpp>

#include "base/assert.hpp"
#include "base/fail.hpp"
#include "diff/network/drop_network.hpp"
#include "diff/network/unet.hpp"

namespace relidar {
namespace {

const RayDropNetwork& check_network(const RayDropNetwork& network) {
    if (network.widths.empty() || network.inputs.empty() || (network.taps != 1 && network.taps != 9))
        fail(
            "cannot use the ray-drop network: found {} levels, {} input channels and kernels of {} pixels, "
            "expected at least 1 level, at least 1 input channel, and kernels of 1 or 9 pixels",
            network.widths.size(), network.inputs.size(), network.taps);
    const network::UnetLayout plan(network);
    const auto check = [](const char* text, std::size_t found, std::size_t expected) {
        if (found != expected)
            fail("cannot use the ray-drop network: it has {} {}, but its architecture requires {}", found,
                 text, expected);
    };
    check("parameters", network.parameters.size(), plan.n_parameters);
    check("running moments", network.running.size(), plan.n_running);
    check("normalisation values", network.normalisation.size(), 2 * network.inputs.size());
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

    SizedRayDropNetwork& network_for(Stream& stream, network::ImageBatchSize image_grid) {
        auto cache_entry = std::ranges::find(shaped, image_grid, &SizedRayDropNetwork::grid);
        const bool is_new = cache_entry == shaped.end();
        if (is_new)
            cache_entry = std::ranges::find(shaped, network::ImageBatchSize{}, &SizedRayDropNetwork::grid);
        if (cache_entry == shaped.end() && shaped.size() < kMaxImageSizes)
            cache_entry = shaped.emplace(shaped.end(), device, network);
        if (cache_entry == shaped.end()) {
            // Waits, because the device may still use the arrays of the image size that
            // is replaced below.
            stream.submit_and_wait();
            --cache_entry;
        }
        shaped.splice(shaped.begin(), shaped, cache_entry);
        if (is_new) {
            cache_entry->grid = image_grid;
            cache_entry->unet.allocate(device, image_grid, false);
            cache_entry->probability = {device, image_grid.n_image_pixels(), "drop probabilities"};
            cache_entry->loss.emplace(device, image_grid.n_image_pixels());
        }
        return *cache_entry;
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
    shaped.inputs.fill_batch(stream, {&unrotated_sample, 1}, input_channels.address(),
                             shaped.unet.input_images());
    shaped.unet.run_inference(stream);
    // Computes only probabilities. Without targets, the number of known pixels is 0.
    shaped.loss->record_loss(stream, grid.n_image_pixels(),
                             {.logit = shaped.unet.logits().values.address().cast_tag<shared::DropLogits>(),
                              .start = r.network.residual ? shaped.inputs.rendered_logits().address()
                                                          : Address<float, shared::StartLogits>(),
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
    r.stream.submit_and_wait();
    r.channels.reserve(r.device, image.channels.size(), "input channels of the ray-drop network");
    r.channels.upload(image.channels);
    const auto& probability =
        r.pass.record_drops(r.stream, image.rows, image.columns, image.circular, r.channels);
    r.stream.submit_and_wait();
    return probability.download();
}

}  // namespace relidar
