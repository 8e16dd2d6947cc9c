// SPDX-License-Identifier: Apache-2.0
// Checks the limits of growth. The capacity must grow in steps. If the device runs out of
// memory, the scene must stop growing and remain valid.
#include <relidar/diff/densify.hpp>
#include <relidar/diff/optimizer.hpp>
#include <relidar/scene/device_scene.hpp>

#include "../../support/device.hpp"
#include "random_model.hpp"

namespace relidar {
namespace {

class DensifyMemory : public test::DeviceTest {};

struct Growing {
    Device& device;
    Scene scene;
    DeviceScene device_scene;
    Adam adam;
    Densifier densifier;
    Stream stream;

    static Scene make_opaque_scene(std::uint32_t count) {
        Scene scene = test::make_random_model_scene({count}, 2);
        for (float& x : scene.surfels.opacity_logit) x = 2.0f;
        return scene;
    }
    Growing(Device& d, std::uint32_t count)
        : device(d),
          scene(make_opaque_scene(count)),
          device_scene(d, scene),
          adam(d, count, {}),
          densifier(d, scene, {.strategy = DensifyStrategy::adaptive}, 0.0f, 1, 1),
          stream(d) {
        adam.first_moments().upload(scene.surfels);
        adam.second_moments().upload(scene.surfels);
    }
    /// @param share share of the surfels that should grow
    DensifyReport grow(int step, double share, double other_allocation_bytes = 0.0) {
        std::vector<float> sum(device_scene.size(), 0.0f);
        for (std::size_t i = 0; i < std::size_t(share * double(sum.size())); ++i) sum[i] = 1.0f;
        densifier.statistics().gradient_sum.upload(sum);
        densifier.statistics().n_observing_batches.upload(std::vector<std::uint32_t>(sum.size(), 1u));
        return densifier.densify_surfels(stream, device_scene, adam, step, other_allocation_bytes);
    }
    /// Checks that every surfel is a copy of an original surfel, in the original order.
    /// Its Adam moments must be equal to the original moments or zero.
    void expect_valid() {
        const Surfels now = device_scene.surfel_parameters().download(), m = adam.first_moments().download();
        ASSERT_EQ(m.size(), now.size());
        for (std::size_t i = 0; i < now.size(); ++i) {
            const std::uint32_t tag = test::get_tag(now, i);
            ASSERT_LT(tag, scene.surfels.size());
            ASSERT_GE(tag, test::get_tag(now, i > 0 ? i - 1 : 0));
            ASSERT_EQ(now.rotation[i], scene.surfels.rotation[tag]);
            ASSERT_EQ(m.rotation[i],
                      m.opacity_logit[i] != 0.0f ? scene.surfels.rotation[tag] : glm::vec4(0.0f));
        }
    }
};

TEST_F(DensifyMemory, CapacityGrowsInSteps) {
    Growing g(device(), 1000);
    EXPECT_EQ(g.grow(500, 0.1).after, 1100u);
    EXPECT_GE(g.device_scene.surfel_parameters().capacity(), 1500u) << "half as much again";
    const std::uint64_t held = device().allocated_bytes();
    EXPECT_EQ(g.grow(600, 0.1).after, 1210u);
    EXPECT_EQ(g.grow(700, 0.2).after, 1452u);
    EXPECT_EQ(device().allocated_bytes(), held) << "nothing is allocated where there is room";
    EXPECT_EQ(g.grow(800, 1.0).after, 2904u) << "more than half as much again";
    g.expect_valid();
}

TEST_F(DensifyMemory, OutOfMemoryCapsAndContinues) {
    Device limited({.memory_limit_bytes = 12u << 20});
    Growing g(limited, 5000);
    std::string notes;
    std::uint32_t size = 5000;
    for (int step = 500; step < 1500; step += 100) {
        const DensifyReport r = g.grow(step, 1.0);
        EXPECT_GE(r.after, size);
        size = r.after;
        notes += r.note;
        g.expect_valid();
    }
    EXPECT_LE(limited.peak_bytes(), std::uint64_t(12) << 20 | (1u << 20)) << "staging is the host's";
    EXPECT_GT(size, 6000u) << "it grew as far as it could";
    EXPECT_LT(size, 12000u);
    const std::string place = std::to_string(size) + " surfels";
    EXPECT_NE(notes.find(place), std::string::npos) << notes;
    EXPECT_EQ(notes.find(place), notes.rfind(place)) << "said once: " << notes;
}

TEST_F(DensifyMemory, RoomIsLeftForTheOthers) {
    Device limited({.memory_limit_bytes = 16u << 20});
    Growing g(limited, 5000);
    constexpr double kOthers = 1000.0;
    const DensifyReport r = g.grow(500, 1.0, kOthers);
    EXPECT_GT(r.after, 5000u);
    EXPECT_NO_THROW(Buffer(limited, std::size_t(kOthers) * r.after, "the others"));
    g.expect_valid();

    Growing tight(limited, 1000);
    const DensifyReport none = tight.grow(500, 1.0, 1e6);
    EXPECT_EQ(none.after, 1000u);
    EXPECT_FALSE(none.note.empty());
    tight.expect_valid();
}

}  // namespace
}  // namespace relidar
