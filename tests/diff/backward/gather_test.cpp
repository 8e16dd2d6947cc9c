// SPDX-License-Identifier: Apache-2.0
// Checks the kernels that sum gradients per surfel (diff/backward/gather and
// gather_heads).
#include <algorithm>

#include <relidar/base/error.hpp>

#include "passes.hpp"

namespace relidar {
namespace {

using reference::PixelGradient;
using test::Passes;

std::vector<float> collect_all_gradients(const DeviceGradients& gradients) {
    std::vector<float> all;
    const std::initializer_list<const Array<float>*> arrays{&gradients.records,
                                                            &gradients.surfels.mean,
                                                            &gradients.surfels.rotation,
                                                            &gradients.surfels.log_scale,
                                                            &gradients.surfels.opacity_logit,
                                                            &gradients.surfels.log_scale_w,
                                                            &gradients.surfels.sh,
                                                            &gradients.rays,
                                                            &gradients.poses,
                                                            &gradients.sensor};
    for (const Array<float>* array : arrays)
        for (const float x : array->download()) all.push_back(x);
    return all;
}

class Gather : public test::DeviceTest {
protected:
    test::RandomScene make_crowded_scene(const reference::Settings& settings) {
        test::RandomSceneOptions options{.seed = 51,
                                         .background_surfels = 20,
                                         .actor_surfels = 6,
                                         .rays = 20,
                                         .primitive = settings.image.primitive};
        test::RandomScene scene = test::make_random_scene(options, settings);
        const std::vector<reference::Ray> once = scene.rays;
        for (int i = 1; i < 100; ++i) scene.rays.insert(scene.rays.end(), once.begin(), once.end());
        return scene;
    }
};

TEST_F(Gather, SameBitsInEveryRunAndTraversal) {
    using enum ShDirection;
    for (const auto& [direction, primitive] : {std::pair{ray, PrimitiveType::surfel},
                                               {surfel, PrimitiveType::surfel},
                                               {surfel, PrimitiveType::gaussian}}) {
        const reference::Settings settings{.image = {.sh_direction = direction, .primitive = primitive}};
        const test::RandomScene scene = make_crowded_scene(settings);
        const std::vector<PixelGradient> upstream = test::make_random_upstream(scene.rays.size(), 5);
        RendererOptions options = test::make_options(settings.image);
        Passes passes(device(), settings.image, scene, upstream, options,
                      {.reduction = GradientReduction::gather});
        passes.run();
        const std::vector<float> first = collect_all_gradients(passes.gradients());
        for (int i = 0; i < 3; ++i) {
            passes.run();
            EXPECT_EQ(collect_all_gradients(passes.gradients()), first);
        }
        options.accel.proxy = ProxyShape::triangles;
        Passes triangles(device(), settings.image, scene, upstream, options,
                         {.reduction = GradientReduction::gather});
        triangles.run();
        EXPECT_EQ(collect_all_gradients(triangles.gradients()), first) << "the same hits found another way";
    }
}

/// A CPU processes only the surfels that a hit has marked, if the gradient rows of all
/// other surfels need not be zeroed. Gathered sums must be equal in every bit. Sums with
/// atomics must mark the same surfels.
TEST_F(Gather, SurfelsThatAreHitAreAllThatCount) {
    for (const ShDirection direction : {ShDirection::surfel, ShDirection::ray}) {
        reference::Settings settings;
        settings.image.sh_direction = direction;
        const test::RandomSceneOptions options{
            .seed = 52, .background_surfels = 400, .actor_surfels = 9, .rays = 30};
        const test::RandomScene scene = test::make_random_scene(options, settings);
        const std::vector<PixelGradient> upstream = test::make_random_upstream(scene.rays.size(), 5);
        std::vector<std::uint32_t> touched;
        for (const GradientReduction reduction : {GradientReduction::gather, GradientReduction::atomics}) {
            Passes passes(device(), settings.image, scene, upstream, test::make_options(settings.image),
                          {.reduction = reduction});
            passes.run();
            DeviceGradients& gradients = passes.gradients();
            const std::vector<float> first = collect_all_gradients(gradients);
            if (touched.empty()) touched = gradients.touched.download();
            EXPECT_EQ(gradients.touched.download(), touched);
            EXPECT_GT(std::ranges::count(touched, 0u), 100);
            EXPECT_GT(std::ranges::count(touched, 1u), 20);
            Stream stream(device());
            gradients.surfels.fill_zero(stream);  // rows that are not written keep this value
            stream.submit_and_wait();
            gradients.zero_untouched = false;
            passes.run();
            EXPECT_EQ(gradients.touched.download(), touched);
            if (reduction == GradientReduction::gather) {
                EXPECT_EQ(collect_all_gradients(gradients), first);
            }
        }
    }
}

/// Renders the same twenty rays a hundred times. The gathered gradient must be 100 times
/// the gradient of the twenty rays, which is summed with atomics.
TEST_F(Gather, SumsRowsOverManyBlocks) {
    for (const ShDirection direction : {ShDirection::ray, ShDirection::surfel}) {
        reference::Settings settings;
        settings.image.sh_direction = direction;
        test::RandomScene scene = make_crowded_scene(settings);
        std::vector<PixelGradient> upstream = test::make_random_upstream(20, 6);
        for (int i = 1; i < 100; ++i)
            upstream.insert(upstream.end(), upstream.begin(), upstream.begin() + 20);
        Passes many(device(), settings.image, scene, upstream, test::make_options(settings.image),
                    {.reduction = GradientReduction::gather});
        many.run();
        scene.rays.resize(20);
        Passes once(device(), settings.image, scene, upstream, test::make_options(settings.image),
                    {.reduction = GradientReduction::atomics});
        once.run();
        test::GradientTable table;
        const auto add = [&](const char* name, const Array<float>& expected, const Array<float>& actual,
                             std::size_t count) {
            const std::vector<float> e = expected.download(), a = actual.download();
            for (std::size_t i = 0; i < e.size(); i += count) {
                std::vector<double> row = test::lanes(e.data() + i, int(count));
                for (double& x : row) x *= 100.0;
                table.add_row(name, row, test::lanes(a.data() + i, int(count)));
            }
        };
        add("records", once.gradients().records, many.gradients().records, 16);
        if (direction == ShDirection::ray)
            add("sh", once.gradients().surfels.sh, many.gradients().surfels.sh, 16);
        add("poses", once.gradients().poses, many.gradients().poses, 3);
        add("sensor", once.gradients().sensor, many.gradients().sensor, 3);
        for (const auto& [name, group] : table.groups()) {
            EXPECT_LE(group.compute_worst_error(), test::kKernelGradient) << name;
            EXPECT_EQ(group.count_missing_rows(), 0u) << name;
        }
        const test::GatheredHits hits = test::download_gathered_hits(many);
        EXPECT_EQ(hits.capacity, 64u * many.rays.size());
        std::uint64_t n_hits = 0;
        for (const std::uint32_t n : to_ray_values(many.renderer.last_batch().rendered->download()).hits)
            n_hits += n;
        EXPECT_EQ(hits.most, n_hits);
        EXPECT_GT(n_hits, 5000u);
        EXPECT_EQ(test::download_gathered_hits(many).most, 0u);
    }
}

/// The slots of rays without a gradient must remain empty. A small batch must not read
/// data of an earlier, larger batch.
TEST_F(Gather, EmptySlotsAndSmallerBatches) {
    reference::Settings settings;
    const test::RandomScene scene = make_crowded_scene(settings);
    std::vector<PixelGradient> upstream = test::make_random_upstream(scene.rays.size(), 7);
    for (std::size_t i = 0; i < upstream.size(); ++i)
        if (i >= 20) upstream[i] = {};
    Passes many(device(), settings.image, scene, upstream, test::make_options(settings.image),
                {.reduction = GradientReduction::gather});
    many.run();
    test::RandomScene few = scene;
    few.rays.resize(20);
    Passes once(device(), settings.image, few, upstream, test::make_options(settings.image),
                {.reduction = GradientReduction::gather});
    once.run();
    EXPECT_EQ(many.gradients().records.download(), once.gradients().records.download());
    many.renderer.record_forward({&many.rays, 0, 1, 20});
    many.differentiable.record_backward();
    many.renderer.stream().submit_and_wait();
    EXPECT_EQ(many.gradients().records.download(), once.gradients().records.download());
    many.differentiable.backward_pass().reserve_hits(many.renderer.stream(), 1u << 20);
    many.run();
    EXPECT_EQ(many.gradients().records.download(), once.gradients().records.download())
        << "room does not matter";
    EXPECT_EQ(test::download_gathered_hits(many).capacity, 1u << 20);
}

TEST_F(Gather, RoomForNothingIsRefused) {
    EXPECT_THROW(BackwardPass(device(), {}, ProxyShape::boxes, {},
                              {.reduction = GradientReduction::gather, .hits_per_ray = 0}),
                 UsageError);
}

}  // namespace
}  // namespace relidar
