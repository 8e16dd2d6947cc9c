// SPDX-License-Identifier: Apache-2.0
// Tests the methods to find hits on the host. Embree with bounding triangles (M3) must
// return the same ordered ids as a test of all surfels in float, for 1 to 32 hits at a
// time.
#include <gtest/gtest.h>

#include <cstdio>

#include "../../support/surfels.hpp"
#include "cases.hpp"
#include "hit_comparison.hpp"
#include "scene/benchmark_street.hpp"

namespace relidar {
namespace {

using namespace reference;
using test::HitDifferences;
using test::TraversalCase;

constexpr std::uint64_t kSeed = 20261121;
constexpr int kAll = 1 << 30;

HitDifferences compare(const TraversalCase& test_case, const HitProvider& expected, const HitProvider& actual,
                       const ImageModel& model = {}) {
    const World world = to_world(test_case);
    HitDifferences differences;
    const std::vector<Ray> rays = test::to_reference(test_case.rays);
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const int chunk = 1 + int(i % 32);
        compare_hits(world, model, rays[i], i, list_all_hits(expected, rays[i], kAll),
                     list_all_hits(actual, rays[i], chunk), differences);
    }
    std::printf("  %s\n", differences.summary(test_case.name).c_str());
    return differences;
}

HitDifferences compare_embree(const TraversalCase& test_case, ProxyMargin margin = {}) {
    const World world = to_world(test_case);
    return compare(test_case, BruteForce(world, {}, Precision::float_record),
                   EmbreeFilter(world, {}, margin));
}

void expect_identical(const HitDifferences& differences, const TraversalCase& test_case) {
    EXPECT_EQ(differences.n_different_rays, 0u)
        << test_case.name << ", seed " << kSeed << ": " << differences.first_error;
}

TEST(HostProviders, EmbreeAgreesOnAllCases) {
    for (const TraversalCase& c : test::make_conformance_cases(kSeed, 6000)) {
        const HitDifferences d = compare_embree(c);
        EXPECT_EQ(d.n_errors, 0u) << c.name << ", seed " << kSeed << ": " << d.first_error;
        if (!c.grazing) expect_identical(d, c);
        EXPECT_LE(double(d.n_different_rays), 1e-3 * double(d.n_rays)) << c.name;
    }
}

/// Hits of models that move during the sweep must agree. The double reference computes
/// each pose with a different formula (sine and cosine).
TEST(HostProviders, AgreeOnModelsThatMove) {
    for (const TraversalCase& c : test::make_moving_cases(kSeed, 3000)) {
        const World world = to_world(c);
        ImageModel model;
        model.primitive = c.surfels.primitive;
        const BruteForce brute(world, model, Precision::float_record);
        const HitDifferences d = compare(c, BruteForce(world, model, Precision::double_record), brute);
        EXPECT_EQ(d.n_errors, 0u) << c.name << ", seed " << kSeed << ": " << d.first_error;
        EXPECT_LE(double(d.n_flips), 1e-3 * double(d.n_hits) + 1.0) << c.name;
        if (!properties_of(c.surfels.primitive).third_scale)
            expect_identical(compare(c, brute, EmbreeFilter(world, model)), c);
    }
}

TEST(HostProviders, EmbreeAgreesOn100000RandomRays) {
    const TraversalCase c = test::make_random_case(kSeed, 600, 100000);
    const HitDifferences d = compare_embree(c);
    expect_identical(d, c);
    EXPECT_GT(d.n_hits, 400000u);
}

TEST(HostProviders, EmbreeAgreesInTheStreet) {
    const TraversalCase c =
        test::make_street_test_case(make_street_surfels(100000), make_street_rays("waymo"), 6.0, 9);
    const HitDifferences d = compare_embree(c);
    expect_identical(d, c);
    EXPECT_GT(d.n_hits, d.n_rays);
}

TEST(HostProviders, GrazingRaysAreExactWithWiderProxies) {
    const TraversalCase c = test::make_grazing_case(kSeed + 5, 20000);
    expect_identical(compare_embree(c, {1.01, 1e-2}), c);
}

TEST(HostProviders, DoubleAndFloatDifferOnlyOnBoundaries) {
    for (const TraversalCase& c : test::make_conformance_cases(kSeed, 3000)) {
        const World world = to_world(c);
        const HitDifferences d = compare(c, BruteForce(world, {}, Precision::double_record),
                                         BruteForce(world, {}, Precision::float_record));
        EXPECT_EQ(d.n_errors, 0u) << c.name << ", seed " << kSeed << ": " << d.first_error;
        EXPECT_LE(double(d.n_flips), 1e-3 * double(d.n_hits) + 1.0) << c.name;
    }
}

TEST(HostProviders, EveryChunkSizeGivesTheSameList) {
    const TraversalCase c = test::make_random_case(kSeed + 3, 800, 50);
    const World world = to_world(c);
    const BruteForce brute(world, {}, Precision::float_record);
    const EmbreeFilter embree(world, {});
    for (const Ray& ray : test::to_reference(c.rays)) {
        const std::vector<Hit> expected = list_all_hits(brute, ray, kAll);
        for (int chunk = 1; chunk <= 32; ++chunk) {
            EXPECT_EQ(list_all_hits(brute, ray, chunk), expected);
            EXPECT_EQ(list_all_hits(embree, ray, chunk), expected);
        }
    }
}

TEST(HostProviders, TiesAreOrderedByInstanceAndSurfel) {
    const TraversalCase c = test::make_equal_depth_case();
    const World world = to_world(c);
    const std::vector<Hit> hits =
        list_all_hits(EmbreeFilter(world, {}), test::to_reference(c.rays).back(), 4);
    ASSERT_EQ(hits.size(), 7u + 7u + 2u + 7u);
    constexpr unsigned kInstances[] = {0, 2, 3};
    for (std::size_t i = 0; i < 16; ++i) {
        EXPECT_EQ(hits[i].t, 5.0);
        EXPECT_EQ(hits[i].instance, kInstances[i / 7]);
        EXPECT_EQ(hits[i].surfel, i < 14 ? i % 7 : i - 14 + 3);
    }
}

TEST(HostProviders, DegenerateSurfelsAreNeverReported) {
    const TraversalCase c = test::make_degenerate_case();
    const World world = to_world(c);
    const BruteForce brute(world, {}, Precision::float_record);
    const EmbreeFilter embree(world, {});
    std::size_t n_hits = 0;
    for (const Ray& ray : test::to_reference(c.rays))
        for (const HitProvider* provider :
             {static_cast<const HitProvider*>(&brute), static_cast<const HitProvider*>(&embree)})
            for (const Hit& hit : list_all_hits(*provider, ray, 3)) {
                EXPECT_TRUE(hit.surfel == 2 || hit.surfel == 9 || hit.surfel == 14 || hit.surfel == 15)
                    << "surfel " << hit.surfel;
                EXPECT_EQ(hit.instance, 0u);
                ++n_hits;
            }
    EXPECT_GT(n_hits, 100u);
}

TEST(HostProviders, HugeSurfelsAndFarOriginsStayFinite) {
    std::vector<Surfel> surfels(2);
    surfels[0].mean = {5, 0, 0};
    surfels[0].rotation = {0.5, 0.5, 0.5, 0.5};
    surfels[0].log_scale = {11.0, 60.0};  // 60 km and 1e26 m
    surfels[0].opacity_logit = 1.0;
    surfels[1] = surfels[0];
    surfels[1].mean = {1e30, 0, 0};
    const World world{surfels, {{0, 2, {}}}};
    const EmbreeFilter embree(world, {});
    const Ray ray{{0, 0.25, 0.5}, {1, 0, 0}};
    const std::vector<Hit> hits = list_all_hits(embree, ray, 16);
    ASSERT_EQ(hits.size(), 1u);
    EXPECT_EQ(hits[0].surfel, 0u);
    EXPECT_EQ(hits[0].t, 5.0);
    for (const Hit& hit : list_all_hits(embree, {{1e8, 0, 0}, {-1, 1e-20, 0}}, 16))
        EXPECT_TRUE(std::isfinite(hit.t));
}

}  // namespace
}  // namespace relidar
