// SPDX-License-Identifier: Apache-2.0
// Compares values and derivatives of diff/loss/ssim and diff/loss/ssim_vjp with the
// double reference.
#include <random>

#include <relidar/diff/forward.hpp>
#include <relidar/diff/loss.hpp>

#include "../../reference/ssim.hpp"
#include "../../support/device.hpp"
#include "../../support/gradient_check.hpp"

namespace relidar {
namespace {

using reference::Image;

class Ssim : public test::DeviceTest {};

Image make_random_image(int rows, int columns, bool circular, double known_share) {
    std::mt19937_64 random(std::uint64_t(rows * 1000 + columns));
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    Image image{rows, columns, circular, {}, {}, {}};
    for (int i = 0; i < rows * columns; ++i) {
        // Makes half of the image nearly flat, so that its variances are small.
        const double flat = i % columns < columns / 2 ? 0.3 : 0.3 + 0.4 * unit(random);
        image.y.push_back(float(flat));
        image.x.push_back(float(flat + 0.05 * unit(random)));
        image.is_known.push_back(unit(random) < known_share);
    }
    return image;
}

struct Result {
    double ssim = 0.0, l1 = 0.0;
    std::vector<double> d_x;
};

/// Computes the loss on the device. Pixels without a known value are alternately dropped
/// and unknown, and contain invalid values.
Result compute_device_ssim(Device& device, const Image& image, float share, std::uint32_t stride = 1) {
    const std::size_t n = image.x.size();
    std::vector<shared::RenderedRay> rendered;
    std::vector<DeviceTarget> targets(n * stride);
    double n_known_pixels = 0.0;
    for (std::size_t i = 0; i < n; ++i) {
        n_known_pixels += image.is_known[i];
        shared::RenderedRay& ray = rendered.emplace_back();
        ray.depth = 10.0f;
        ray.weight = 1.0f;
        ray.intensity = image.is_known[i] ? float(image.x[i]) : 7.0f;
        DeviceTarget& target = targets[i * stride];
        target = i % 2 ? DeviceTarget{0.0f, 5.0f, 1.0f} : DeviceTarget{10.0f, 5.0f, 0.0f};
        if (image.is_known[i]) target = {10.0f, float(image.y[i]), 1.0f};
    }
    const LossWeights weights{.intensity = 1.0f, .intensity_ssim = share};
    ImageLoss loss(device, weights, std::uint32_t(n));
    Stream stream(device);
    const Array<shared::RenderedRay> r(device, rendered, "rendered");
    const Array<float> terms(device, std::vector<float>(kLossTerms, 0.0f), "terms");
    const Array<DeviceTarget> t(device, targets, "targets");
    Array<shared::RayGradient> upstream(device, n, "upstream");
    const ImageShape shape{std::uint32_t(image.rows), std::uint32_t(image.columns), image.circular};
    loss.add_ray_losses(stream, {{}, &r, &upstream},
                        {&t, 0, stride, std::uint32_t(n), n_known_pixels, double(n), shape}, terms);
    stream.submit_and_wait();
    Result result{terms.download()[loss_term::ssim], terms.download()[loss_term::intensity], {}};
    for (const shared::RayGradient& g : upstream.download()) result.d_x.push_back(g.intensity);
    return result;
}

TEST_F(Ssim, AgreesWithReference) {
    struct Case {
        int rows, columns;
        bool circular;
        double known_fraction;
        std::uint32_t stride;
    };
    for (const Case& c : {Case{16, 50, true, 0.8, 1}, Case{16, 50, false, 1.0, 3}, Case{1, 40, true, 0.7, 1},
                          Case{3, 7, true, 1.0, 1}, Case{33, 37, true, 0.15, 2}}) {
        const Image image = make_random_image(c.rows, c.columns, c.circular, c.known_fraction);
        std::vector<double> expected;
        const double loss = reference::compute_ssim_loss(image, &expected);
        const Result device_result = compute_device_ssim(device(), image, 1.0f, c.stride);
        EXPECT_NEAR(device_result.ssim, loss, 1e-4 * loss) << c.rows << " x " << c.columns;
        EXPECT_EQ(device_result.l1, 0.0);
        test::GradientTable table;
        table.add_row("image", expected, device_result.d_x);
        EXPECT_EQ(table.groups().at("image").count_missing_rows(), 0u);
        EXPECT_LE(table.compute_worst_error(), test::kKernelGradient) << c.rows << " x " << c.columns;
        for (std::size_t i = 0; i < expected.size(); ++i)
            EXPECT_TRUE(image.is_known[i] || device_result.d_x[i] == 0.0)
                << "pixel " << i << " takes no part";
    }
}

TEST_F(Ssim, SharesTheIntensityTermWithL1) {
    const Image image = make_random_image(8, 20, true, 0.9);
    const Result all = compute_device_ssim(device(), image, 1.0f),
                 none = compute_device_ssim(device(), image, 0.0f),
                 some = compute_device_ssim(device(), image, 0.15f);
    EXPECT_EQ(none.ssim, 0.0);
    EXPECT_NEAR(some.ssim, 0.15 * all.ssim, 1e-6);
    EXPECT_NEAR(some.l1, 0.85 * none.l1, 1e-6);
    for (std::size_t i = 0; i < image.x.size(); ++i)
        EXPECT_NEAR(some.d_x[i], 0.15 * all.d_x[i] + 0.85 * none.d_x[i], 1e-7);
}

}  // namespace
}  // namespace relidar
