// SPDX-License-Identifier: Apache-2.0
#include "diff/network/measured_network.hpp"

#include <random>
#include <vector>

#include "diff/network/drop_network.hpp"
#include "diff/network/drop_training.hpp"
#include "diff/network/unet.hpp"

namespace relidar {
namespace {

std::vector<RayDropImage> make_noise_images(const RayDropNetworkOptions& options, int rows, int columns) {
    const std::size_t n = std::size_t(rows) * std::size_t(columns);
    std::mt19937 random(1);
    const RayDropImage empty{rows, columns,
                             std::vector<float>(list_network_input_channels(options).size() * n),
                             std::vector<float>(n)};
    std::vector<RayDropImage> images(std::size_t(refine::get_batch_size(options)), empty);
    for (RayDropImage& image : images) {
        for (float& x : image.channels) x = float(random() % 1024) / 512.0f - 1.0f;
        for (float& x : image.dropped) x = float(random() % 2);
    }
    return images;
}

double count_network_inference_flops(const RayDropNetwork& network, refine::ImageBatchSize grid) {
    const refine::UnetParameterLayout plan(network);
    double sum = 0.0;
    const auto add = [&](const refine::ConvParameterOffsets& layer) {
        sum += 2.0 * double(layer.n_in) * double(layer.n_out) * double(layer.taps) *
               double(grid.count_pixels_per_image());
    };
    add(plan.first_conv);
    add(plan.last_conv);
    for (std::size_t level = 0; level < network.widths.size(); ++level, grid = refine::halve_image_size(grid))
        for (std::size_t k = 0; k < 2; ++k) {
            if (level > 0) add(plan.down[2 * level - 2 + k].conv);
            if (2 * level + k < plan.up.size()) add(plan.up[2 * level + k].conv);
            if (level + 1 < network.widths.size() || network.heads == 0 || k == 1) continue;
            add(plan.query->conv);
            add(plan.project);
            sum += 4.0 * double(grid.count_pixels_per_image()) * double(grid.count_pixels_per_image()) *
                   double(network.widths[level]);
        }
    return sum;
}

}  // namespace

struct RayDropNetworkBenchmark::Impl {
    std::vector<RayDropImage> images;
    refine::RayDropTraining training;
    RayDropRefiner refiner;
    std::vector<refine::RayDropInputs::RotatedSample> chosen;
    int steps = 0;

    Impl(Device& device, const RayDropNetworkOptions& options, int rows, int columns)
        : images(make_noise_images(options, rows, columns)),
          training(device, images, options, 1, device.info().timestamps),
          refiner(device, training.download_network()) {
        for (std::uint32_t i = 0; i < images.size(); ++i) chosen.push_back({i, 7 * i});
    }
};

RayDropNetworkBenchmark::RayDropNetworkBenchmark(Device& device, const RayDropNetworkOptions& options,
                                                 int rows, int columns)
    : impl_(std::make_unique<Impl>(device, options, rows, columns)) {}
RayDropNetworkBenchmark::~RayDropNetworkBenchmark() = default;

void RayDropNetworkBenchmark::run_training_step() {
    impl_->training.train_on_batch(impl_->chosen, ++impl_->steps, 1000);
}
void RayDropNetworkBenchmark::run_inference() { impl_->refiner.predict_drop_probabilities(impl_->images[0]); }
double RayDropNetworkBenchmark::count_inference_flops() const {
    const RayDropImage& image = impl_->images[0];
    return count_network_inference_flops(impl_->refiner.network(),
                                         {1, std::uint32_t(image.rows), std::uint32_t(image.columns)});
}
const KernelTimes& RayDropNetworkBenchmark::times() const { return impl_->training.times(); }

}  // namespace relidar
