// SPDX-License-Identifier: Apache-2.0
#include <map>
#include <utility>

#include <relidar/read/dataset.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"

namespace relidar {
namespace {

class People : public test::DeviceTest {};

template <class Returned>
int list_returns_in(const Log& street, const Frame& frame, const BoxTrack& box,
                    const std::vector<float>& range_m, const Returned& returned) {
    int n = 0;
    for (std::size_t i = 0; i < range_m.size(); ++i) {
        if (!returned(i)) continue;
        const WorldRay ray =
            make_world_ray(street.world_from_vehicle, frame.time_s, frame.scan.rays, i, true);
        n += box.contains_point(ray.origin_m + double(range_m[i]) * ray.direction,
                                frame.time_s + double(frame.scan.rays.time_offset_s[i]), 0.1);
    }
    return n;
}

/// Compares median ranges, because mean ranges would lie behind such a narrow object for
/// up to a quarter of the points.
TEST_F(People, ReturnOnHeldOutFramesAsOftenAsTheyDid) {
    const Log street = make_street_log({.seed = 3,
                                        .n_frames = 20,
                                        .rows = 64,
                                        .columns = 512,
                                        .range_noise_m = 0.01,
                                        .speed_mps = 5.0,
                                        .people = true});
    const Split split = split_frames(street, 6);
    Config config = make_preset("quick");
    config.train.iterations = 110;
    config.train.rays_per_iteration = 4096;
    config.train.refine_poses = "none";
    const TrainResult result = train(device(), street, split, config);
    ScanRenderer renderer(device(), result.scene, config, street);
    std::map<std::string, std::pair<int, int>> counts;  // number of real and simulated returns
    for (const int position : split.test) {
        const Frame& frame = street.frames[std::size_t(position)];
        const RenderedScan scan = renderer.render({frame.scan.rays, std::nullopt}, frame.time_s);
        for (BoxTrack box : street.boxes) {
            if (box.category == "Car") continue;
            for (Pose& pose : box.world_from_box.pose) pose.translation.z += 0.15;  // above the ground
            const int real =
                list_returns_in(street, frame, box, to_vector(frame.scan.range_m),
                                [&](std::size_t index) { return frame.scan.range_m[index] > 0.0f; });
            const int simulated =
                list_returns_in(street, frame, box, scan.median_range_m, [&](std::size_t index) {
                    return scan.median_range_m[index] > 0.0f && scan.image.drop_prob[index] < 0.5f;
                });
            counts[box.category].first += real;
            counts[box.category].second += simulated;
        }
    }
    for (const auto& [category, count] : counts) {
        EXPECT_GT(count.first, 100) << category;
        EXPECT_NEAR(count.second, count.first, 0.25 * count.first) << category;
    }
}

TEST_F(People, MaskedBoxesAreReported) {
    const Log street = make_street_log({.n_frames = 12, .rows = 16, .columns = 256, .people = true});
    Config config = make_preset("quick");
    config.init.voxel_m = 0.4;
    config.init.actor_classes = "Car";
    config.train.iterations = 1;
    std::vector<std::string> notes;
    TrainSession session;
    session.note = [&](const std::string& line) { notes.push_back(line); };
    train(device(), street, split_frames(street, 0), config, {}, session);
    ASSERT_EQ(notes.size(), 1u);
    EXPECT_NE(notes[0].find("2 (Pedestrian), 3 (Pedestrian), 4 (Pedestrian), 5 (Cyclist)"),
              std::string::npos);
}

}  // namespace
}  // namespace relidar
