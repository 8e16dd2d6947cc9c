// SPDX-License-Identifier: Apache-2.0
// Compares two methods of the forward pass: hit lists (diff/forward/append, sort_hits,
// blend) and chunks (diff/forward/trace).
#include <algorithm>
#include <cmath>
#include <cstring>

#include <relidar/base/error.hpp>
#include <relidar/diff/forward.hpp>
#include "gpu/forced.hpp"

#include "../../support/device.hpp"
#include "../../support/surfels.hpp"
#include "../traversal/cases.hpp"
#include "diff/forward/hit_lists.hpp"

namespace relidar {
namespace {

using test::TraversalCase;

constexpr std::uint32_t kUntouched = 0xabababab;

struct Provider {
    const char* name;
    ProxyShape proxy = ProxyShape::automatic;
    BvhTraversalMode traversal_mode = BvhTraversalMode::automatic;
    bool brute_force = false;
};

std::vector<Provider> list_providers(const Device& device) {
    const Provider brute{.name = "brute force", .brute_force = true};
    if (device.backend() == RayTracingBackend::software)
        return {{.name = "lane", .traversal_mode = BvhTraversalMode::lane},
                {.name = "subgroup", .traversal_mode = BvhTraversalMode::subgroup},
                brute};
    return {{.name = "triangles", .proxy = ProxyShape::triangles},
            {.name = "boxes", .proxy = ProxyShape::boxes},
            brute};
}

struct Placed {
    test::SceneAndPoses placed;
    ImageModel model;
    Stream stream;
    DeviceScene scene;
    AccelerationStructure accel;
    Array<DeviceRay> rays;

    Placed(Device& device, const TraversalCase& test_case, const Provider& provider)
        : placed(test::to_scene(test_case.surfels, test_case.instances)),
          stream(device),
          scene(device, placed.scene),
          accel(device, scene, {.proxy = provider.proxy}),
          rays(device, to_device_rays(test_case.rays), "rays") {
        model.primitive = test_case.surfels.primitive;
        scene.upload_poses(placed.world_from_instance);
        scene.activate(stream, model, glm::vec3(0.0f));
        accel.record_refit(stream, scene);
        stream.submit_and_wait();
    }

    RayBatch batch() const { return {&rays, 0, 1, std::uint32_t(rays.size())}; }

    std::vector<shared::RenderedRay> render(const TraceOptions& options, StoredRayHits* kept = nullptr) {
        ForwardPass forward(stream.device(), model, accel.proxy_shape(), options);
        Array<shared::RenderedRay> rendered(stream.device(), rays.size(), "rendered rays");
        forward.record_forward(stream, scene, accel, batch(), rendered, kept);
        stream.submit_and_wait();
        EXPECT_EQ(forward.consume_truncated(), 0u);
        return rendered.download();
    }

    shared::ForwardParams make_params(const Array<shared::RenderedRay>& rendered,
                                      const Array<std::uint32_t, shared::PassCapCount>& pass_cap) const {
        shared::ForwardParams params{};
        params.scene = trace_params(scene, accel, batch(), model, {}, pass_cap.address());
        params.rendered = rendered.address();
        return params;
    }

    std::vector<shared::RenderedRay> render_lists(int capacity) {
        Device& device = stream.device();
        const Array<shared::RenderedRay> rendered(device, rays.size(), "rendered rays");
        const Array<std::uint32_t, shared::PassCapCount> pass_cap(device, std::vector<std::uint32_t>{0u},
                                                                  "pass cap count");
        HitListTracer lists(device, kernel_variant(device),
                            trace_constants(device, accel.proxy_shape(), {}, model), capacity);
        shared::ForwardParams params = make_params(rendered, pass_cap);
        stream.fill(rendered, kUntouched);
        lists.render(stream, batch(), params, nullptr);
        stream.submit_and_wait();
        return rendered.download();
    }
};

bool is_near(float first, float second) {
    return std::abs(first - second) <= 1e-5f * std::max(1.0f, std::abs(second));
}

/// Returns true if two rendered rays are equal except for rounding differences between
/// kernels.
bool is_same(const shared::RenderedRay& first, const shared::RenderedRay& second) {
    return first.n_hits == second.n_hits && first.instance == second.instance &&
           is_near(first.depth, second.depth) && is_near(first.weight, second.weight) &&
           is_near(first.intensity, second.intensity) && is_near(first.hit_logit, second.hit_logit) &&
           is_near(first.drop_logit, second.drop_logit) &&
           is_near(first.transmittance, second.transmittance) &&
           is_near(first.median_depth, second.median_depth);
}

std::size_t count_differences(const std::vector<shared::RenderedRay>& first,
                              const std::vector<shared::RenderedRay>& second) {
    std::size_t n = 0;
    for (std::size_t i = 0; i < first.size(); ++i) n += !is_same(first[i], second[i]);
    return n;
}

/// Counts the rays whose stored hits differ in any bit between two buffers with the same
/// capacity per ray.
std::size_t count_different_hits(const StoredRayHits& first, const StoredRayHits& second,
                                 const std::vector<shared::RenderedRay>& rays) {
    const std::vector<shared::Hit> hits_a = first.hits.download(), hits_b = second.hits.download();
    std::size_t n = 0;
    for (std::size_t ray = 0; ray < rays.size(); ++ray)
        for (std::size_t k = 0; k < std::min(rays[ray].n_hits, first.per_ray); ++k) {
            constexpr std::size_t kBeside = RELIDAR_SIDE_BY_SIDE;
            const std::size_t entry = (ray / kBeside * first.per_ray + k) * kBeside + ray % kBeside;
            n += std::memcmp(&hits_a[entry], &hits_b[entry], sizeof(shared::Hit)) != 0;
        }
    return n;
}

class Lists : public test::DeviceTest {
protected:
    void expect_what_chunks_render(const TraversalCase& test_case) {
        for (const Provider& provider : list_providers(device())) {
            const ForcedBehaviourScope forced(device(), {.brute_force = provider.brute_force});
            Placed placed(device(), test_case, provider);
            for (const float least : {1e-4f, 1e-30f}) {  // with 1e-30 nearly all hits are blended
                placed.model.transmittance_min = least;
                const std::vector<shared::RenderedRay> expected = placed.render(
                    {.chunk = 5, .traversal_mode = provider.traversal_mode, .order = HitSortMethod::chunks});
                for (const int list_capacity : {1, 7, 64, 512}) {
                    const std::vector<shared::RenderedRay> actual =
                        placed.render({.chunk = 5,
                                       .traversal_mode = provider.traversal_mode,
                                       .order = HitSortMethod::lists,
                                       .initial_list_capacity = list_capacity});
                    // Allows a few differences, because rounding in a different kernel
                    // can decide whether the transmittance is below its limit T_min.
                    EXPECT_LE(count_differences(actual, expected), test_case.rays.size() / 5000)
                        << test_case.name << ", " << provider.name << ", room " << list_capacity << ", T_min "
                        << least;
                }
            }
        }
    }
};

TEST_F(Lists, ConformanceCases) {
    for (const TraversalCase& c : test::make_conformance_cases(41, 1000)) expect_what_chunks_render(c);
}

TEST_F(Lists, ConformanceCasesOfGaussians) {
    for (const TraversalCase& c : test::make_gaussian_cases(43, 500)) expect_what_chunks_render(c);
}

/// Renders with hit lists only, without diff/forward/trace. The lists must render every
/// ray whose hits fit into its list, and must not write the remaining rays.
TEST_F(Lists, RenderWhatTheyHaveRoomFor) {
    TraversalCase c = test::make_long_list_case();
    for (const TraversalCase& other :
         {test::make_single_case(), test::make_equal_depth_case(), test::make_random_case(44, 300, 500)}) {
        Placed placed(device(), other, {.name = "any"});
        const std::vector<shared::RenderedRay> expected = placed.render({.order = HitSortMethod::chunks});
        EXPECT_EQ(count_differences(placed.render_lists(512), expected), 0u) << other.name;
    }
    for (float& opacity : c.surfels.opacity_logit) opacity = -4.5f;  // no ray stops early
    Placed placed(device(), c, {.name = "any"});
    const std::vector<shared::RenderedRay> expected = placed.render({.order = HitSortMethod::chunks});
    EXPECT_TRUE(std::ranges::any_of(expected, [](const auto& ray) { return ray.n_hits > 60; }));
    for (const int requested_capacity : {1, 60, 512}) {
        const int list_capacity = std::min(requested_capacity, int(max_list_hits(device())));
        const std::vector<shared::RenderedRay> actual = placed.render_lists(requested_capacity);
        for (std::size_t i = 0; i < actual.size(); ++i) {
            if (expected[i].n_hits > std::uint32_t(list_capacity))
                EXPECT_EQ(actual[i].n_hits, kUntouched) << "ray " << i;
            // A ray through the edge between two triangles may report the hit twice,
            // which uses two entries of the list.
            else if (actual[i].n_hits == kUntouched)
                EXPECT_GE(2 * expected[i].n_hits, std::uint32_t(list_capacity)) << "ray " << i;
            else EXPECT_TRUE(is_same(actual[i], expected[i])) << "ray " << i << ", room " << list_capacity;
        }
    }
}

/// Sorting must work for lists of every possible length, including hits at equal
/// distance.
TEST_F(Lists, PutHitsInOrderWhateverTheirNumber) {
    constexpr std::uint32_t kMost = 512;
    for (const int n :
         {1, 2, 3, 7, 8, 9, 16, 17, 31, 32, 33, 63, 64, 65, 100, 128, 129, 200, 256, 257, 400, 512}) {
        Placed placed(device(), test::make_tied_list_case(n), {.name = "any", .proxy = ProxyShape::boxes});
        StoredRayHits expected(device(), placed.rays.size(), kMost),
            actual(device(), placed.rays.size(), kMost);
        const std::vector<shared::RenderedRay> rays =
            placed.render({.order = HitSortMethod::chunks}, &expected);
        placed.render({.order = HitSortMethod::lists, .initial_list_capacity = kMost}, &actual);
        EXPECT_TRUE(
            std::ranges::all_of(rays, [&](const auto& ray) { return ray.n_hits == std::uint32_t(n); }))
            << n << " hits";
        EXPECT_EQ(count_different_hits(actual, expected, rays), 0u) << n << " hits";
    }
}

/// Hits that are stored for the backward pass must be in blending order. Tests lists in
/// the same memory, lists that are longer than the stored hits, and rays that
/// diff/forward/trace renders.
TEST_F(Lists, KeepTheHitsThatTheyBlend) {
    TraversalCase long_lists = test::make_long_list_case();
    for (float& opacity : long_lists.surfels.opacity_logit) opacity = -4.5f;
    for (const TraversalCase& c :
         {long_lists, test::make_equal_depth_case(), test::make_random_case(45, 300, 200)}) {
        Placed placed(device(), c, {.name = "any"});
        for (const std::uint32_t per_ray : {3u, 64u, 128u}) {
            StoredRayHits expected(device(), c.rays.size(), per_ray);
            const std::vector<shared::RenderedRay> rays =
                placed.render({.order = HitSortMethod::chunks}, &expected);
            for (const int list_capacity : {2, 64, 512}) {
                StoredRayHits stored_hits(device(), c.rays.size(), per_ray);
                placed.render({.order = HitSortMethod::lists, .initial_list_capacity = list_capacity},
                              &stored_hits);
                EXPECT_EQ(count_different_hits(stored_hits, expected, rays), 0u)
                    << c.name << ", " << per_ray << " kept, room " << list_capacity;
            }
        }
    }
}

/// An opaque wall must end the search, so that hits behind it are not in the list.
TEST_F(Lists, EndBehindAWall) {
    TraversalCase c = test::make_long_list_case();
    for (float& opacity : c.surfels.opacity_logit) opacity = 8.0f;
    Placed placed(device(), c, {.name = "any", .proxy = ProxyShape::boxes});
    const std::vector<shared::RenderedRay> expected = placed.render({.order = HitSortMethod::chunks});
    EXPECT_EQ(count_differences(placed.render({.order = HitSortMethod::lists}), expected), 0u);
    EXPECT_TRUE(std::ranges::all_of(expected, [](const auto& ray) { return ray.n_hits < 10; }));
    // the order of hits from a driver is unknown
    if (device().backend() != RayTracingBackend::software) return;
    EXPECT_EQ(count_differences(placed.render_lists(64), expected), 0u) << "100 surfels lie along each ray";
}

/// The capacity must double as long as some list is too short, and then stay constant.
TEST_F(Lists, Grow) {
    TraversalCase c = test::make_long_list_case();
    for (float& opacity : c.surfels.opacity_logit) opacity = -4.5f;
    Placed placed(device(), c, {.name = "any", .proxy = ProxyShape::boxes});
    const std::vector<shared::RenderedRay> expected = placed.render({.order = HitSortMethod::chunks});
    const std::uint32_t most = std::ranges::max(expected, {}, &shared::RenderedRay::n_hits).n_hits;
    const Array<std::uint32_t, shared::PassCapCount> pass_cap(device(), std::vector<std::uint32_t>{0u},
                                                              "pass cap count");
    const std::vector<SpecialisationConstant> constants =
        trace_constants(device(), placed.accel.proxy_shape(), {}, placed.model);
    const Kernel<shared::ForwardParams> trace(device(), "diff/forward/trace", kernel_variant(device()),
                                              constants);
    HitListTracer lists(device(), kernel_variant(device()), constants, 3);
    for (int i = 0; i < 30; ++i) {
        const Array<shared::RenderedRay> rendered(device(), c.rays.size(), "rendered rays");
        shared::ForwardParams params = placed.make_params(rendered, pass_cap);
        lists.render(placed.stream, placed.batch(), params, nullptr);
        run(placed.stream, trace, count_threads(placed.batch()), params);
        placed.stream.submit_and_wait();
        EXPECT_EQ(count_differences(rendered.download(), expected), 0u) << "room " << lists.capacity();
    }
    EXPECT_GE(lists.capacity(), std::min(most, max_list_hits(device())));
    EXPECT_LT(lists.capacity(), 4 * most);
}

TEST_F(Lists, RoomThatCannotBeIsRefused) {
    for (const int list_capacity : {0, 513})
        EXPECT_THROW(ForwardPass(device(), {}, ProxyShape::boxes, {.initial_list_capacity = list_capacity}),
                     UsageError);
}

}  // namespace
}  // namespace relidar
