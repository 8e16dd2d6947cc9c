// SPDX-License-Identifier: Apache-2.0
// Trains on a street in the format of SemanticKITTI and compares the channel `class` of
// held-out scans with the exact classes of the street.

#include <fmt/format.h>
#include <cstring>
#include <filesystem>
#include <map>
#include <string>
#include <utility>

#include <relidar/read/dataset.hpp>
#include <relidar/score/evaluation.hpp>
#include <relidar/simulate/render.hpp>
#include <relidar/train/train.hpp>

#include "../support/device.hpp"
#include "read/datasets/kitti/kitti_drive.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

std::uint32_t get_label(SurfaceClass surface) {
    switch (surface) {
        case SurfaceClass::vehicle: return 10;
        case SurfaceClass::road: return 40;
        case SurfaceClass::sidewalk: return 48;
        case SurfaceClass::building: return 50;
        case SurfaceClass::vegetation: return 70;
        case SurfaceClass::pole: return 80;
        default: return 0;
    }
}

void write_scan(const fs::path& folder, int frame, const Scan& scan) {
    std::string points, labels;
    const int columns = scan.rays.columns;
    for (int row = 0; row < scan.rays.rows; ++row)
        for (int k = 0; k < columns; ++k) {
            // Columns are sorted by decreasing azimuth from +180 degrees.
            const auto ray = std::size_t(row * columns + (columns / 2 - 1 - k + columns) % columns);
            if (scan.range_m[ray] == 0.0f) continue;
            const glm::vec4 point(scan.return_point(ray), scan.intensity[ray]);
            const std::uint32_t label = get_label(scan.classes[ray]) | 77u << 16;
            points.append(reinterpret_cast<const char*>(&point), sizeof point);
            labels.append(reinterpret_cast<const char*>(&label), sizeof label);
        }
    test::write_text(folder / "velodyne" / fmt::format("{:06d}.bin", frame), points);
    test::write_text(folder / "labels" / fmt::format("{:06d}.label", frame), labels);
}

/// Writes a street without moving objects as a KITTI odometry sequence with labels. All
/// rays of a scan start at the same pose.
void write_semantic_kitti(const fs::path& folder, const StreetOptions& options) {
    const Log street = make_street_log(options);
    std::string poses, times;
    for (const Frame& frame : street.frames) {
        const Pose pose = street.world_from_vehicle.pose[street.find_pose_index(frame)];
        const glm::dmat4 m = to_matrix(pose);
        for (int i = 0; i < 12; ++i) poses += fmt::format("{}{}", m[i % 4][i / 4], i == 11 ? "\n" : " ");
        times += fmt::format("{}\n", frame.time_s);
        RayTable rays = make_rays(street.lidars[0].sensor);
        std::fill(rays.time_offset_s.begin(), rays.time_offset_s.end(), 0.0f);
        write_scan(folder, frame.index,
                   cast_street_rays(options, rays, {{frame.time_s}, {pose}}, frame.time_s));
    }
    test::write_text(folder / "calib.txt", "Tr: 1 0 0 0 0 1 0 0 0 0 1 0\n");
    test::write_text(folder / "poses.txt", poses);
    test::write_text(folder / "times.txt", times);
}

class TrainedClasses : public test::DeviceTest {};

TEST_F(TrainedClasses, OfHeldOutScansAreThoseOfTheStreet) {
    const fs::path folder = fs::path(testing::TempDir()) / "relidar_semantic_kitti/sequences/00";
    write_semantic_kitti(folder, {.n_frames = 7, .rows = 64, .columns = 200, .moving_cars = false});
    const Log log = load_log(folder.string(), {});
    fs::remove_all(folder.parent_path().parent_path());
    const Split split = split_frames(log, 0, "3");
    Config config = make_preset("quick");
    config.init.voxel_m = 0.4;
    config.train.iterations = 60;
    config.train.rays_per_iteration = 0;
    const TrainResult result = train(device(), log, split, config);

    ScanRenderer renderer(device(), result.scene, config, log);
    EXPECT_FALSE(evaluate_frames(renderer, config, log, split.test).mean.contains("classes/accuracy"));
    renderer.use_classes(result.classes);
    const MetricValues scores = evaluate_frames(renderer, config, log, split.test).mean;
    EXPECT_GT(scores.at("classes/accuracy"), 0.9);
    EXPECT_GT(scores.at("classes/mean_iou"), 0.7);
}

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
