// SPDX-License-Identifier: Apache-2.0
// Checks the tree over the instances (diff/accel/bvh_top) after instances were placed,
// moved and removed.
#include <algorithm>
#include <random>

#include "../../support/device.hpp"
#include "bvh_walk.hpp"

namespace relidar {
namespace {

using test::DeviceBvh;

Surfels make_some_surfels(std::uint32_t count, std::mt19937& random) {
    std::normal_distribution<float> normal;
    Surfels s;
    s.resize(count);
    for (std::uint32_t i = 0; i < count; ++i) {
        s.mean[i] = {2.0f * normal(random), normal(random), normal(random)};
        s.rotation[i] = {normal(random), normal(random), normal(random), normal(random)};
        s.log_scale[i] = {-2.0f + 0.3f * normal(random), -2.0f + 0.3f * normal(random)};
        s.opacity_logit[i] = 1.0f;
    }
    std::fill(s.sh.begin(), s.sh.end(), 0.0f);
    return s;
}

std::vector<InstancePose> make_random_poses(std::size_t count, std::mt19937& random, double spread_m = 30.0) {
    std::normal_distribution<double> normal;
    std::vector<InstancePose> poses(count);
    for (InstancePose& pose : poses) {
        pose.world_from_model.rotation =
            glm::normalize(glm::dquat(normal(random), normal(random), normal(random), normal(random)));
        pose.world_from_model.translation =
            spread_m * glm::dvec3(normal(random), normal(random), normal(random));
    }
    return poses;
}

Scene make_scene_of_instances(std::uint32_t n_instances, std::mt19937& random) {
    Scene scene = wrap_background(make_some_surfels(500, random));
    scene.models = {{"a", 0, 200}, {"b", 200, 0}, {"c", 200, 1}, {"d", 201, 99}, {"e", 300, 200}};
    scene.instances.clear();
    for (std::uint32_t i = 0; i < n_instances; ++i) scene.instances.push_back({i % 5, ""});
    return scene;
}

class BvhTop : public test::DeviceTest {
protected:
    static bool is_there(const DeviceBvh& built, std::size_t index) {
        const Scene& layout = built.scene.layout();
        return built.scene.poses()[index].present && layout.models[layout.instances[index].model].count > 0;
    }

    static void check_node(const DeviceBvh& built, const HostBvhCopy& host, std::uint32_t index,
                           std::vector<int>& visits, test::HostBox& real) {
        ASSERT_LT(index, host.top_nodes.size());
        const auto slots = test::list_slots(host.top_nodes[index]);
        for (int s = 0; s < RELIDAR_BVH_WIDTH; ++s) {
            test::HostBox below;
            if (slots[s].inner) check_node(built, host, slots[s].child, visits, below);
            for (std::uint32_t k = 0; k < slots[s].count; ++k) {
                ASSERT_LT(slots[s].first + k, host.top_order.size());
                const std::uint32_t instance = host.top_order[slots[s].first + k];
                ++visits.at(instance);
                below.add(make_world_box(built, host, instance));
            }
            const test::HostBox box = test::decode_box(host.top_nodes[index], s);
            EXPECT_TRUE(box.holds(below)) << "slot " << s << " of node " << index;
            EXPECT_EQ(box.empty(), below.empty()) << "slot " << s << " of node " << index;
            real.add(below);
        }
    }

    /// Computes the world box of an instance in double. The box contains the corners of
    /// all surfel boxes of the model at the pose of the instance.
    static test::HostBox make_world_box(const DeviceBvh& built, const HostBvhCopy& host,
                                        std::uint32_t instance) {
        const Scene& layout = built.scene.layout();
        const SurfelModel& model = layout.models[layout.instances[instance].model];
        test::HostBox box;
        for (std::uint32_t i = model.first; i < model.first + model.count; ++i) {
            const test::HostBox b = test::compute_surfel_box(host, i);
            for (int corner = 0; corner < 8; ++corner) {
                const glm::dvec3 p =
                    built.scene.poses()[instance].world_from_model *
                    glm::dvec3(corner & 1 ? b.low.x : b.high.x, corner & 2 ? b.low.y : b.high.y,
                               corner & 4 ? b.low.z : b.high.z);
                box.add({p, p});
            }
        }
        return box;
    }

    static void expect_valid_tree(const DeviceBvh& built, const HostBvhCopy& host,
                                  const std::string& description) {
        SCOPED_TRACE(description);
        std::vector<int> instance_visit_counts(host.top_order.size(), 0);
        test::HostBox real;
        check_node(built, host, 0, instance_visit_counts, real);
        for (std::size_t i = 0; i < instance_visit_counts.size(); ++i) {
            EXPECT_EQ(instance_visit_counts[i], is_there(built, i) ? 1 : 0) << "instance " << i;
            EXPECT_EQ(host.roots[i] == RELIDAR_BVH_NO_NODE, !is_there(built, i)) << "instance " << i;
        }
    }
};

TEST_F(BvhTop, EveryInstanceIsWhereItStands) {
    std::mt19937 random(1);
    for (const std::uint32_t n : {1u, 2u, 8u, 9u, 64u, 65u, 200u, 1000u}) {
        DeviceBvh built(device(), make_scene_of_instances(n, random));
        built.build();
        expect_valid_tree(built, built.move(make_random_poses(n, random)), std::to_string(n) + " instances");
        expect_valid_tree(built, built.move(make_random_poses(n, random, 1e5)),
                          std::to_string(n) + " instances, far away");
        std::vector<InstancePose> poses = make_random_poses(n, random);
        for (InstancePose& pose : poses) pose.present = random() % 2;
        expect_valid_tree(built, built.move(poses), std::to_string(n) + " instances, half of them absent");
        for (InstancePose& pose : poses) pose.present = false;
        expect_valid_tree(built, built.move(poses), std::to_string(n) + " instances, all of them absent");
        expect_valid_tree(built, built.move(std::vector<InstancePose>(n)),
                          std::to_string(n) + " instances in one place");
    }
}

TEST_F(BvhTop, MovesAreRepeatable) {
    std::mt19937 random(2);
    DeviceBvh built(device(), make_scene_of_instances(100, random));
    built.build();
    const std::vector<InstancePose> poses = make_random_poses(100, random);
    const HostBvhCopy a = built.move(poses);
    built.move(make_random_poses(100, random));
    const HostBvhCopy b = built.move(poses);
    EXPECT_TRUE(test::are_equal(a.top_nodes, b.top_nodes));
    EXPECT_EQ(a.top_order, b.top_order);
}

}  // namespace
}  // namespace relidar
