// SPDX-License-Identifier: Apache-2.0
// Checks when an acceleration structure is rebuilt. It is rebuilt at the first use, on
// request, and after a number of refits (updates of its boxes).
#include <relidar/diff/accel.hpp>
#include <relidar/scene/device_scene.hpp>

#include "../../support/device.hpp"
#include "../../support/surfels.hpp"
#include "../traversal/cases.hpp"

namespace relidar {
namespace {

class Rebuild : public test::DeviceTest {
protected:
    Surfels surfels_ = test::make_random_case(3, 400, 1).surfels;

    int count_refits_after(Stream& stream, DeviceScene& scene, AccelerationStructure& accel,
                           bool rebuild = false) {
        scene.activate(stream, {}, glm::vec3(0.0f));
        accel.record_refit(stream, scene, rebuild);
        stream.submit_and_wait();
        return accel.n_refits();
    }
};

TEST_F(Rebuild, FirstWhenToldAndWhenDue) {
    Stream stream(device());
    DeviceScene scene(device(), wrap_background(surfels_));
    AccelerationStructure accel(device(), scene, {.rebuild_every = 3});
    std::vector<int> refits;
    for (int i = 0; i < 8; ++i) refits.push_back(count_refits_after(stream, scene, accel, i == 6));
    EXPECT_EQ(refits, (std::vector<int>{0, 1, 2, 3, 0, 1, 0, 1}));
    EXPECT_EQ(accel.n_updates(), 8u);
}

TEST_F(Rebuild, NeverDueWhereZero) {
    Stream stream(device());
    DeviceScene scene(device(), wrap_background(surfels_));
    AccelerationStructure accel(device(), scene, {.rebuild_every = 0});
    for (int i = 0; i < 6; ++i) EXPECT_EQ(count_refits_after(stream, scene, accel), i);
}

TEST_F(Rebuild, WhenTheTreeHasOutgrownItsBuild) {
    Stream stream(device());
    DeviceScene scene(device(), wrap_background(surfels_));
    AccelerationStructure accel(device(), scene, {});
    count_refits_after(stream, scene, accel);
    accel.record_cost(stream);
    EXPECT_EQ(count_refits_after(stream, scene, accel), 1) << "nothing has moved";
    accel.record_cost(stream);
    Surfels scattered = surfels_;  // neighbours in the tree are now far apart
    for (std::size_t i = 0; i < scattered.size(); ++i)
        scattered.mean[i] = surfels_.mean[(i * 157) % surfels_.size()];
    scene.surfel_parameters().upload(scattered);
    EXPECT_EQ(count_refits_after(stream, scene, accel), 2);
    accel.record_cost(stream);
    EXPECT_EQ(count_refits_after(stream, scene, accel), 3)
        << "growth is measured by one check and seen by the next";
    accel.record_cost(stream);
    // Drivers do not report the cost of a structure.
    const bool measured = device().backend() == RayTracingBackend::software;
    EXPECT_EQ(count_refits_after(stream, scene, accel), measured ? 0 : 4);
    for (const int refits : {1, 2, 3}) {
        accel.record_cost(stream);
        EXPECT_EQ(count_refits_after(stream, scene, accel), measured ? refits : 4 + refits)
            << "a new build is its own measure";
    }
}

}  // namespace
}  // namespace relidar
