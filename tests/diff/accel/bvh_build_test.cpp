// SPDX-License-Identifier: Apache-2.0
// Checks the trees over the surfels (diff/accel/bvh_bounds, bvh_keys, bvh_cluster,
// bvh_wide_mark, bvh_wide_count, bvh_wide_scan, bvh_wide_place, bvh_wide_emit, bvh_refit,
// bvh_cost).
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include <relidar/base/error.hpp>

#include "../../support/device.hpp"
#include "bvh_walk.hpp"

namespace relidar {
namespace {

using test::DeviceBvh;
using test::make_scene_of_sizes;

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();
constexpr float kInf = std::numeric_limits<float>::infinity();

Surfels make_random_surfels(std::uint32_t count, std::uint32_t seed = 1) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> unit(0.0f, 1.0f);
    std::normal_distribution<float> normal;
    Surfels s;
    s.resize(count);
    for (std::uint32_t i = 0; i < count; ++i) {
        s.mean[i] = {40.0f * unit(random), 20.0f * unit(random), 5.0f * unit(random)};
        s.rotation[i] = {normal(random), normal(random), normal(random), normal(random)};
        s.log_scale[i] = {-4.0f + 4.0f * unit(random) * unit(random), -4.0f + 3.0f * unit(random)};
        s.opacity_logit[i] = 3.0f * normal(random);
    }
    std::fill(s.sh.begin(), s.sh.end(), 0.0f);
    return s;
}

class BvhBuild : public test::DeviceTest {
protected:
    static double compute_cost(DeviceBvh& built) {
        built.bvh.measure_cost(built.stream);
        built.stream.submit_commands();
        return built.bvh.read_cost(built.stream).value();
    }

    static void expect_valid_tree(const HostBvhCopy& host, const Scene& layout,
                                  const std::string& description) {
        std::vector<int> node_visit_counts(host.nodes.size(), 0);
        std::uint32_t n = 0;
        for (std::size_t m = 0; m < layout.models.size(); ++m) {
            const SurfelModel& model = layout.models[m];
            n += model.count;
            if (model.count == 0) {
                EXPECT_EQ(host.roots[m], RELIDAR_BVH_NO_NODE) << description;
                ++node_visit_counts[m];  // an empty model does not use its root node
                continue;
            }
            EXPECT_EQ(test::find_fault_of_tree(host, host.roots[m], model, node_visit_counts), "")
                << description << ", model " << m;
        }
        EXPECT_EQ(std::count(node_visit_counts.begin(), node_visit_counts.end(), 1),
                  std::ptrdiff_t(node_visit_counts.size()))
            << description << ": nodes that no root reaches";
        EXPECT_LE(host.nodes.size(), Bvh::max_node_count(n, std::uint32_t(layout.models.size())))
            << description;
    }

    void expect_valid_tree(const Surfels& surfels, const std::string& description) {
        DeviceBvh built(device(), wrap_background(surfels));
        expect_valid_tree(built.build(), built.scene.layout(), description);
    }
};

TEST_F(BvhBuild, EverySizeIsATree) {
    for (const std::uint32_t n : {0u, 1u, 2u, 3u, 4u, 5u, 9u, 33u, 100u, 4096u, 10'007u, 100'000u})
        expect_valid_tree(make_random_surfels(n), std::to_string(n) + " surfels");
}

TEST_F(BvhBuild, HardScenesAreTrees) {
    constexpr std::uint32_t n = 3'001;
    Surfels s = make_random_surfels(n);
    for (glm::vec3& mean : s.mean) mean = {1.0f, 2.0f, 3.0f};
    expect_valid_tree(s, "identical means");
    for (std::uint32_t i = 0; i < n; ++i) s.mean[i] = {0.01f * float(i), 0.0f, 0.0f};
    expect_valid_tree(s, "collinear");
    for (std::uint32_t i = 0; i < n; ++i)
        s.mean[i] = {std::ldexp(1.0f, -int(i % 100)), std::ldexp(1.0f, -int(i % 37)), 0.0f};
    expect_valid_tree(s, "a chain: means that halve");
    s = make_random_surfels(n);
    for (glm::vec3& mean : s.mean) mean += glm::vec3(1e5f, -1e5f, 1e5f);
    expect_valid_tree(s, "far from the origin");
    s = make_random_surfels(n);
    s.mean[77] = {3e37f, -3e38f, 0.0f};
    expect_valid_tree(s, "one far outlier");
    for (glm::vec2& scale : s.log_scale) scale = {-90.0f, -13.0f};
    expect_valid_tree(s, "denormal scales");
    s = make_random_surfels(n);
    for (glm::vec2& scale : s.log_scale) scale = {13.0f, -8.0f};
    expect_valid_tree(s, "needles of a thousand kilometres");
}

TEST_F(BvhBuild, SurfelsThatCannotBeHitAreEmptyAndHarmless) {
    constexpr std::uint32_t n = 5'000;
    Surfels s = make_random_surfels(n);
    for (std::uint32_t i = 0; i < n; i += 3) {
        if (i % 4 == 0) s.mean[i].x = kNaN;
        if (i % 4 == 1) s.log_scale[i].y = kInf;
        if (i % 4 == 2) s.opacity_logit[i] = -30.0f;
        if (i % 4 == 3) s.mean[i].z = -kInf;
    }
    DeviceBvh built(device(), wrap_background(s));
    const HostBvhCopy host = built.build();
    expect_valid_tree(host, built.scene.layout(), "a third is hidden");
    for (std::uint32_t i = 0; i < n; ++i) {
        const bool hidden = i % 3 == 0 || s.opacity_logit[i] < std::log(1.0f / 254.0f);
        EXPECT_EQ(test::compute_surfel_box(host, i).empty(), hidden) << "surfel " << i;
    }
    Surfels gone = s;
    std::fill(gone.opacity_logit.begin(), gone.opacity_logit.end(), -30.0f);
    built.scene.surfel_parameters().upload(gone);
    expect_valid_tree(built.build(), built.scene.layout(), "all are hidden");
    built.scene.surfel_parameters().upload(make_random_surfels(n));
    expect_valid_tree(built.refit({{0, built.scene.size()}}), built.scene.layout(),
                      "all come back with a refit");
}

TEST_F(BvhBuild, ManyModelsOfVeryDifferentSizes) {
    std::vector<std::uint32_t> sizes;
    std::mt19937 random(4);
    for (int m = 0; m < 200; ++m) {
        if (m % 17 == 0) sizes.push_back(0);
        else if (m % 31 == 5) sizes.push_back(3000);
        else sizes.push_back(random() % 12);
    }
    sizes.push_back(0);
    std::uint32_t n = 0;
    for (const std::uint32_t size : sizes) n += size;
    for (const std::vector<std::uint32_t>& some :
         {std::vector<std::uint32_t>{n}, {0, n}, {n - 1, 1}, {1, 0, n - 1, 0}, sizes}) {
        DeviceBvh built(device(), make_scene_of_sizes(make_random_surfels(n), some));
        expect_valid_tree(built.build(), built.scene.layout(), std::to_string(some.size()) + " models");
    }
    // a surfel belongs to no model
    EXPECT_THROW(DeviceBvh(device(), make_scene_of_sizes(make_random_surfels(10), {4, 5})), DataError);
}

TEST_F(BvhBuild, RefitFollowsTheSurfels) {
    constexpr std::uint32_t n = 10'007;
    Surfels s = make_random_surfels(n);
    DeviceBvh built(device(), make_scene_of_sizes(s, {6000, 1, 0, 4006}));
    const HostBvhCopy before = built.build();
    const double cost = compute_cost(built);
    std::mt19937 random(5);
    std::normal_distribution<float> normal;
    for (int step = 0; step < 3; ++step) {
        for (glm::vec3& mean : s.mean) mean += glm::vec3(normal(random), normal(random), normal(random));
        built.scene.surfel_parameters().upload(s);
        const HostBvhCopy after = built.refit({{0, built.scene.size()}});
        expect_valid_tree(after, built.scene.layout(), "refit");
        EXPECT_EQ(after.order, before.order);
        EXPECT_EQ(after.nodes.size(), before.nodes.size());
    }
    const double refitted = compute_cost(built);
    EXPECT_GT(refitted, 1.2 * cost);
    expect_valid_tree(built.build(), built.scene.layout(), "rebuilt");
    EXPECT_LT(compute_cost(built), 0.9 * refitted);
}

TEST_F(BvhBuild, BuildsAreEqualBitForBit) {
    const Scene scene = make_scene_of_sizes(make_random_surfels(20'000), {15'000, 20, 4'980});
    DeviceBvh a(device(), scene), b(device(), scene);
    const HostBvhCopy first = a.build(), second = b.build(), third = a.build(),
                      refitted = a.refit({{0, 20'000}});
    for (const HostBvhCopy& other : {second, third, refitted}) {
        EXPECT_TRUE(test::are_equal(first.nodes, other.nodes));
        EXPECT_EQ(first.order, other.order);
        EXPECT_EQ(first.roots, other.roots);
    }
}

/// Computes the bounding box of a surfel in double precision. Its half size along x is k
/// |(s_u a_u.x, s_v a_v.x)|. At k standard deviations from the mean, the opacity has
/// fallen to 1 / 255: sigma exp(-k^2 / 2) = 1 / 255.
test::HostBox compute_expected_box(const Surfels& surfels, std::size_t index) {
    const double sigma = 1.0 / (1.0 + std::exp(-double(surfels.opacity_logit[index]))),
                 k = std::sqrt(2.0 * std::log(255.0 * sigma));
    const glm::dmat3 r =
        glm::mat3_cast(glm::normalize(glm::dquat(surfels.rotation[index].x, surfels.rotation[index].y,
                                                 surfels.rotation[index].z, surfels.rotation[index].w)));
    const glm::dvec3 u = r[0] * std::exp(double(surfels.log_scale[index].x)) * k,
                     v = r[1] * std::exp(double(surfels.log_scale[index].y)) * k;
    const glm::dvec3 half = glm::sqrt(u * u + v * v);
    return {glm::dvec3(surfels.mean[index]) - half, glm::dvec3(surfels.mean[index]) + half};
}

TEST_F(BvhBuild, SurfelBoxesHoldTheSurfelAndLittleMore) {
    const Surfels s = make_random_surfels(2'000);
    DeviceBvh built(device(), wrap_background(s));
    const HostBvhCopy host = built.build();
    int n_checked = 0;
    for (std::size_t i = 0; i < s.size(); ++i) {
        const test::HostBox box = test::compute_surfel_box(host, i);
        if (box.empty()) continue;
        const test::HostBox expected = compute_expected_box(s, i);
        EXPECT_TRUE(box.holds(expected)) << "surfel " << i;
        const glm::dvec3 excess_size_m = box.high - box.low - 1.005 * (expected.high - expected.low);
        EXPECT_LT(std::max({excess_size_m.x, excess_size_m.y, excess_size_m.z}), 1e-3) << "surfel " << i;
        ++n_checked;
    }
    EXPECT_GT(n_checked, 1'500);
}

}  // namespace
}  // namespace relidar
