// SPDX-License-Identifier: Apache-2.0
// Stripes of an image: incidence within them is that of the whole image, and the frames together see all of it.
#include "train/drops/stripes.hpp"

#include <set>

#include <gtest/gtest.h>

#include <relidar/dataset.hpp>

#include "core/incidence.hpp"

namespace relidar {
namespace {

/// Cosines of the angles of incidence, as the network's channel has them.
DropImage incidences(const RayTable& rays, const std::vector<float>& range_m) {
    const std::vector<glm::vec3> origin(rays.origin.begin(), rays.origin.end()), direction(rays.direction.begin(), rays.direction.end());
    const ImageRays image{rays.rows, rays.columns, origin, direction, range_m};
    DropImage result{rays.rows, rays.columns, {}, {}};
    for (std::size_t i = 0; i < range_m.size(); ++i) result.channels.push_back(float(incidence_cosine(image, i)));
    return result;
}

/// A range that every ray of a table has, whatever its place in the table.
std::vector<float> ranges_of(const RayTable& rays) {
    std::vector<float> range_m;
    for (const glm::vec3& d : rays.direction) range_m.push_back(d.z < -0.02f ? std::min(-1.7f / d.z, 30.0f) : 12.0f + 3.0f * d.x);
    return range_m;
}

TEST(Stripes, HaveTheIncidenceOfTheWholeImage) {
    const Sequence street = make_synthetic_street({.n_frames = 1, .rows = 16, .columns = 1000});
    const RayTable& all = street.frames[0].scan.rays;
    const std::vector<float> whole = incidences(all, ranges_of(all)).channels;
    for (const std::size_t of_frame : {0u, 1u, 2u, 14u, 15u, 31u}) {
        const Stripes stripes(3, all, of_frame);
        const RayTable some = stripes.rays(all);
        const DropImage image = stripes.crop(incidences(some, ranges_of(some)));
        EXPECT_EQ(image.rows, 16);
        EXPECT_EQ(image.columns, 5 * Stripes::kColumns);
        EXPECT_EQ(image.channels, stripes.values(whole)) << "frame " << of_frame;
    }
}

TEST(Stripes, OfAllFramesSeeEveryColumn) {
    const Sequence street = make_synthetic_street({.n_frames = 1, .rows = 4, .columns = 1000});
    const RayTable& all = street.frames[0].scan.rays;
    std::vector<float> number(all.size());
    for (std::size_t i = 0; i < number.size(); ++i) number[i] = float(i);
    std::set<float> seen;
    for (std::size_t of_frame = 0; of_frame < 8; ++of_frame)
        for (const float i : Stripes(3, all, of_frame).values(number)) seen.insert(i);
    EXPECT_EQ(seen.size(), all.size());
}

TEST(Stripes, OfASmallImageAreAllOfIt) {
    const Sequence street = make_synthetic_street({.n_frames = 1, .rows = 16, .columns = 128});
    const RayTable& all = street.frames[0].scan.rays;
    for (const int share : {0, 1, 3}) EXPECT_EQ(Stripes(share, all, 1).rays(all).size(), all.size()) << share;
    EXPECT_LT(stripe_share(all), 2);
}

}  // namespace
}  // namespace relidar
