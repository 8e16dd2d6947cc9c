// SPDX-License-Identifier: Apache-2.0
// Tests the reference's structural similarity against scipy's separable correlation,
// central differences, and cases computed by hand.
#include <gtest/gtest.h>

#include "../support/gradient_check.hpp"
#include "ssim.hpp"

namespace relidar::reference {
namespace {

Image make_waves(bool circular) {
    Image image{12, 15, circular, {}, {}, {}};
    for (int i = 0; i < 12; ++i)
        for (int j = 0; j < 15; ++j) {
            image.x.push_back(0.5 + 0.4 * std::sin(0.7 * i + 0.3 * j * j / 4));
            image.y.push_back(0.5 + 0.4 * std::sin(0.6 * i + 0.3 * j * j / 4 + 0.5));
            image.is_known.push_back((3 * i + 5 * j) % 7 != 0);
        }
    return image;
}

/// Compares with scipy. The expected values are the mean of 1 - S over pixels with a
/// known value, with scipy.ndimage.correlate1d over columns ("wrap" or "constant") and
/// rows ("constant"). The moments are divided by the mask after the same filter.
TEST(ReferenceSsim, AgreesWithScipy) {
    EXPECT_NEAR(compute_ssim_loss(make_waves(true)), 0.0632199605965267, 1e-12);
    EXPECT_NEAR(compute_ssim_loss(make_waves(false)), 0.06353378196252815, 1e-12);
}

TEST(ReferenceSsim, KnownCases) {
    Image image = make_waves(true);
    image.x = image.y;
    EXPECT_NEAR(compute_ssim_loss(image), 0.0, 1e-12) << "equal images";
    image.is_known.assign(image.is_known.size(), false);
    EXPECT_EQ(compute_ssim_loss(image), 0.0) << "nothing known";
    image.is_known[20] = true;
    image.x[20] = 0.2;
    image.y[20] = 0.6;
    EXPECT_NEAR(compute_ssim_loss(image), 1.0 - (2 * 0.12 + 1e-4) / (0.04 + 0.36 + 1e-4), 1e-12)
        << "one pixel: its luminance alone";
}

TEST(ReferenceSsim, DerivativesAgreeWithDifferences) {
    for (const bool circular : {true, false}) {
        Image image = make_waves(circular);
        std::vector<double> d;
        compute_ssim_loss(image, &d);
        test::GradientTable table;
        for (std::size_t i = 0; i < image.x.size(); ++i)
            table.add_row("x",
                          test::compute_central_differences(
                              &image.x[i], 1, [&] { return std::vector<double>{compute_ssim_loss(image)}; }),
                          {d[i]});
        table.print("structural similarity");
        EXPECT_LE(table.compute_worst_error(), test::kReferenceGradient);
        EXPECT_EQ(table.groups().at("x").count_missing_rows(), 0u);
    }
}

}  // namespace
}  // namespace relidar::reference
