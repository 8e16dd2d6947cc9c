// SPDX-License-Identifier: Apache-2.0
#include "diff/network/measured_network.hpp"

#include <random>
#include <vector>

#include "diff/network/drop_network.hpp"
#include "diff/network/drop_training.hpp"
#include "diff/network/unet.hpp"

namespace relidar {
namespace {

std::vector<DropImage> make_noise_images(const RefineOptions& options, int rows, int columns) {
    const std::size_t n = std::size_t(rows) * std::size_t(columns);
    std::mt19937 random(1);
    const DropImage empty{rows, columns, std::vector<float>(list_drop_channels(options).size() * n),
                          std::vector<float>(n)};
    std::vector<DropImage> images(std::size_t(refine::get_batch_size(options)), empty);
    for (DropImage& image : images) {
        for (float& x : image.channels) x = float(random() % 1024) / 512.0f - 1.0f;
        for (float& x : image.dropped) x = float(random() % 2);
    }
    return images;
}

double count_operations(const DropNetwork& network, refine::Grid grid) {
    const refine::UnetPlan plan(network);
    double sum = 0.0;
    const auto add = [&](const refine::ConvLayer& layer) {
        sum += 2.0 * double(layer.n_in) * double(layer.n_out) * double(layer.taps) * double(grid.pixels());
    };
    add(plan.head), add(plan.tail);
    for (std::size_t level = 0; level < network.widths.size(); ++level, grid = refine::halve_grid(grid))
        for (std::size_t k = 0; k < 2; ++k) {
            if (level > 0) add(plan.down[2 * level - 2 + k].conv);
            if (2 * level + k < plan.up.size()) add(plan.up[2 * level + k].conv);
            if (level + 1 < network.widths.size() || network.heads == 0 || k == 1) continue;
            add(plan.query->conv), add(plan.project);
            sum += 4.0 * double(grid.pixels()) * double(grid.pixels()) * double(network.widths[level]);
        }
    return sum;
}

}  // namespace

struct MeasuredDropNetwork::Impl {
    std::vector<DropImage> images;
    refine::DropTraining training;
    DropRefiner refiner;
    std::vector<refine::DropInputs::Chosen> chosen;
    int steps = 0;

    Impl(Device& device, const RefineOptions& options, int rows, int columns)
        : images(make_noise_images(options, rows, columns)),
          training(device, images, options, 1, device.info().timestamps),
          refiner(device, training.download()) {
        for (std::uint32_t i = 0; i < images.size(); ++i) chosen.push_back({i, 7 * i});
    }
};

MeasuredDropNetwork::MeasuredDropNetwork(Device& device, const RefineOptions& options, int rows, int columns)
    : impl_(std::make_unique<Impl>(device, options, rows, columns)) {}
MeasuredDropNetwork::~MeasuredDropNetwork() = default;

void MeasuredDropNetwork::step() { impl_->training.step(impl_->chosen, ++impl_->steps, 1000); }
void MeasuredDropNetwork::infer() { impl_->refiner.refine(impl_->images[0]); }
double MeasuredDropNetwork::operations() const {
    const DropImage& image = impl_->images[0];
    return count_operations(impl_->refiner.network(),
                            {1, std::uint32_t(image.rows), std::uint32_t(image.columns)});
}
const KernelTimes& MeasuredDropNetwork::times() const { return impl_->training.times(); }

}  // namespace relidar
