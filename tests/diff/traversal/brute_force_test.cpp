// SPDX-License-Identifier: Apache-2.0
// Hits that the reference finds in float must be the hits that it finds in double, except
// on boundaries. The double reference computes poses of moving models with a different
// formula (sine and cosine).
#include <gtest/gtest.h>

#include "../../support/surfels.hpp"
#include "cases.hpp"
#include "hit_comparison.hpp"

namespace relidar {
namespace {

constexpr std::uint64_t kSeed = 20261121;

TEST(BruteForce, FloatDiffersFromDoubleOnlyOnBoundaries) {
    std::vector<test::TraversalCase> cases = test::make_conformance_cases(kSeed, 3000);
    for (test::TraversalCase& c : test::make_moving_cases(kSeed, 3000)) cases.push_back(std::move(c));
    for (const test::TraversalCase& c : cases) {
        const reference::World world = to_world(c);
        const reference::BruteForce exact(world, {}, reference::Precision::double_record),
            rounded(world, {}, reference::Precision::float_record);
        const std::vector<reference::Ray> rays = test::to_reference(c.rays);
        test::HitDifferences d;
        for (std::size_t i = 0; i < rays.size(); ++i)
            compare_hits(world, {}, rays[i], i, exact.list_hits(rays[i]), rounded.list_hits(rays[i]), d);
        EXPECT_EQ(d.n_errors, 0u) << c.name << ", seed " << kSeed << ": " << d.first_error;
        EXPECT_LE(double(d.n_flips), 1e-3 * double(d.n_hits) + 1.0) << d.summary(c.name);
    }
}

}  // namespace
}  // namespace relidar
