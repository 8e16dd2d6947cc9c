// SPDX-License-Identifier: Apache-2.0
#include "train/drops/stripes.hpp"

#include <numeric>
#include <set>

#include <gtest/gtest.h>

#include <relidar/read/dataset.hpp>

namespace relidar {
namespace {

TEST(Stripes, HaveTheRaysOfTheirPixels) {
    RayTable all = make_street_log({.n_frames = 1, .rows = 16, .columns = 1000}).frames[0].scan.rays;
    std::vector<float> number(all.size());
    std::iota(number.begin(), number.end(), 0.0f);
    std::copy(number.begin(), number.end(), all.time_offset_s.begin());
    for (const std::size_t of_frame : {0u, 1u, 2u, 14u, 15u, 31u}) {
        const ImageStripes stripes(3, all, of_frame);
        const RayTable some = stripes.stripe_rays(all);
        EXPECT_EQ(some.rows, 16);
        EXPECT_EQ(some.columns, 5 * ImageStripes::kStripeColumns);
        EXPECT_EQ(to_vector(some.time_offset_s), stripes.stripe_values(number)) << "frame " << of_frame;
    }
}

TEST(Stripes, OfAllFramesSeeEveryColumn) {
    const Log street = make_street_log({.n_frames = 1, .rows = 4, .columns = 1000});
    const RayTable& all = street.frames[0].scan.rays;
    std::vector<float> number(all.size());
    for (std::size_t i = 0; i < number.size(); ++i) number[i] = float(i);
    std::set<float> sampled_indices;
    for (std::size_t of_frame = 0; of_frame < 8; ++of_frame)
        for (const float i : ImageStripes(3, all, of_frame).stripe_values(number)) sampled_indices.insert(i);
    EXPECT_EQ(sampled_indices.size(), all.size());
}

TEST(Stripes, OfASmallImageAreAllOfIt) {
    const Log street = make_street_log({.n_frames = 1, .rows = 16, .columns = 128});
    const RayTable& all = street.frames[0].scan.rays;
    for (const int share : {0, 1, 3})
        EXPECT_EQ(ImageStripes(share, all, 1).stripe_rays(all).size(), all.size()) << share;
    EXPECT_LT(choose_interval(all), 2);
}

}  // namespace
}  // namespace relidar
