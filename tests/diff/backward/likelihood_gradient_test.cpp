// SPDX-License-Identifier: Apache-2.0
// Tests the likelihood of a measured range (M12) and its gradient in closed form.
// device_gradient_test.cpp compares them with the double reference.
#include <cmath>

#include "passes.hpp"

namespace relidar {
namespace {

class LikelihoodGradient : public test::DeviceTest {};

/// Tests two surfels that are 30 cm apart, at 80 m and at 3 m. The measured range of the
/// ray is the range of the second surfel. In closed form the likelihood is S = w_0 k +
/// w_1 with k = 1 / (1 + (0.3 / s)^2).
TEST_F(LikelihoodGradient, TwoSurfelsInClosedForm) {
    for (const double start : {3.0, 79.0}) {
        const double t[] = {double(float(start)), double(float(start + 0.3))}, opacity[] = {0.6, 0.5};
        test::RandomScene scene;
        for (int i : {0, 1}) {
            reference::Surfel s;
            s.mean = {t[i], 0.0, 0.0};
            s.rotation = {0.70710678118654752, 0.0, 0.70710678118654752, 0.0};
            s.opacity_logit = std::log(opacity[i] / (1.0 - opacity[i]));
            scene.world.surfels.push_back(s);
        }
        scene.world.instances = {{0, 2, {}}};
        scene.rays = {{{0.0, 0.0, 0.0}, {1.0, 0.0, 0.0}, t[1]}};
        std::vector<reference::PixelGradient> upstream(1);
        upstream[0].likelihood = 1.0;
        RendererOptions options = test::make_options({});
        options.trace.likelihood = RangeLikelihoodKernel{0.1f};
        test::Passes passes(device(), {}, scene, upstream, options);
        passes.run();
        const double scale = double(0.1f), d = (t[0] - t[1]) / scale, k = 1.0 / (1.0 + d * d), w0 = 0.6,
                     w1 = 0.4 * 0.5;
        const double slope = -2.0 * d / scale * k * k, resolved = 1.2e-7 * start;
        EXPECT_NEAR(passes.renderer.last_batch().rendered->download()[0].likelihood, w0 * k + w1,
                    1e-6 + w0 * slope * resolved);
        const Surfels device_result = passes.gradients().surfels.download();
        EXPECT_NEAR(device_result.mean[0].x, w0 * slope, 1e-6 + resolved * w0 / (scale * scale))
            << "the nearer one is drawn to the range";
        EXPECT_NEAR(device_result.mean[1].x, 0.0, 1e-6 + 2.0 * w1 * resolved / (scale * scale))
            << "the other is there";
        // S = s_0 k + (1 - s_0) s_1, where s_0 and s_1 are the opacities
        EXPECT_NEAR(device_result.opacity_logit[0], (k - 0.5) * 0.6 * 0.4, 1e-6 + slope * resolved);
        EXPECT_NEAR(device_result.opacity_logit[1], 0.4 * 0.5 * 0.5, 1e-6);
    }
}

}  // namespace
}  // namespace relidar
