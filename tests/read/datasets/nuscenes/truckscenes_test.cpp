// SPDX-License-Identifier: Apache-2.0
// TruckScenes and Lyft have nuScenes tables with several LiDARs, without ring numbers.
#include <relidar/read/dataset.hpp>

#include <fmt/format.h>

#include <relidar/scene/scene.hpp>
#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/datasets/nuscenes/truckscenes_folder.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::TruckRay;
using test::TruckScenesFolder;

Log load(const TruckScenesFolder& data, DatasetOptions options = {}) {
    options.max_range_m = 200.0;
    return data.load(options);
}

void expect_truth(const Log& actual, const Frame& frame, const TruckScenesFolder::Lidar& lidar) {
    const std::vector<TruckRay>& truth = lidar.rays[std::size_t(frame.index)];
    const PoseTrack track = actual.lidar_track(frame.lidar);
    const std::size_t n_beams = lidar.elevations_deg.size();
    std::size_t n_returns = 0;
    for (const TruckRay& ray : truth) n_returns += ray.returned;
    EXPECT_EQ(frame.scan.count_returns(), n_returns);
    EXPECT_EQ(frame.scan.rays.size(), truth.size());
    for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
        if (frame.scan.range_m[i] == 0.0f) continue;
        const double fired_s = frame.time_s + double(frame.scan.rays.time_offset_s[i]);
        const auto column = std::size_t(std::lround((fired_s - truth[0].time_s) / 250e-6));
        const TruckRay& ray = truth[column * n_beams + frame.scan.rays.channel[i]];
        ASSERT_TRUE(ray.returned) << i;
        ASSERT_NEAR(fired_s, ray.time_s, 1e-7);
        const auto [origin_m, point_m] = test::place_return(actual, track, frame, i);
        // Tolerance: the interpolated LiDAR moves along chords, less than 2.5 m from the
        // axle, at 20 degrees per second.
        const TrackInterpolation interpolation = track.find_segment(fired_s);
        const double rotation_rad =
            20.0 * kPi / 180.0 * (track.time_s[interpolation.left + 1] - track.time_s[interpolation.left]);
        const double off_m =
            2.5 * rotation_rad * rotation_rad * std::abs(interpolation.s * (interpolation.s - 1.0)) / 2.0 +
            2e-5;
        ASSERT_LT(glm::distance(origin_m, ray.origin_m), off_m) << i;
        ASSERT_LT(glm::distance(point_m, ray.point_m), off_m + 1e-4);
        ASSERT_FLOAT_EQ(frame.scan.intensity[i], 0.2f);
    }
}

TEST(TruckScenes, EveryReturnOfBothLidars) {
    const TruckScenesFolder data("rays");
    EXPECT_EQ(detect_kind(data.folder), "nuscenes");
    const Log actual = load(data);
    EXPECT_EQ(actual.name, "TruckScenes scene-0044384af3d8494e913fb8b14915239e-3");
    ASSERT_EQ(actual.lidars.size(), 2u);
    ASSERT_EQ(actual.frames.size(), std::size_t(2 * TruckScenesFolder::kSweeps - 1))
        << "LIDAR_TOP_FRONT lacks a sweep";
    for (std::size_t l = 0; l < 2; ++l) {
        const Lidar& lidar = actual.lidars[l];
        EXPECT_EQ(lidar.name, data.lidars[l].channel);
        EXPECT_NEAR(lidar.sweep_period_s(), TruckScenesFolder::kSweep_s, 1e-4);
        EXPECT_EQ(lidar.sensor.columns, TruckScenesFolder::kColumns);
        ASSERT_EQ(lidar.sensor.beams.size(), data.lidars[l].elevations_deg.size());
        for (std::size_t b = 0; b < lidar.sensor.beams.size(); ++b)
            EXPECT_NEAR(lidar.sensor.beams[b].elevation_rad * 180.0 / kPi, data.lidars[l].elevations_deg[b],
                        1e-3);
    }
    for (const Frame& frame : actual.frames) {
        EXPECT_NEAR(frame.time_s, frame.index * TruckScenesFolder::kSweep_s, 1e-9)
            << "LiDARs share the time of the first";
        expect_truth(actual, frame, data.lidars[std::size_t(frame.lidar)]);
    }
    EXPECT_THAT(
        actual.notes,
        testing::Contains(test::Names("LiDAR 'LIDAR_TOP_FRONT' ... 24 beams ... 400 columns ... fitted")));
}

TEST(TruckScenes, PosesGoByTheirOwnTimesAndBoxesBySamples) {
    const TruckScenesFolder data("poses");
    const Log actual = load(data);
    ASSERT_EQ(actual.world_from_vehicle.time_s.size(), std::size_t(TruckScenesFolder::kSweeps));
    for (std::size_t i = 0; i < actual.world_from_vehicle.time_s.size(); ++i) {
        const Pose truth = TruckScenesFolder::compute_vehicle_pose(actual.world_from_vehicle.time_s[i]);
        test::expect_pose(actual, actual.world_from_vehicle.pose[i], truth, 1e-6, 1e-9);
    }
    ASSERT_EQ(actual.boxes.size(), 1u);
    const BoxTrack& box = actual.boxes[0];
    EXPECT_EQ(box.category, "vehicle.other");
    EXPECT_EQ(parse_kind(box.category), ObjectKind::vehicle);
    EXPECT_EQ(box.size_m, glm::dvec3(5.5, 2.1, 2.4));
    ASSERT_EQ(box.world_from_box.pose.size(), std::size_t(TruckScenesFolder::kSweeps))
        << "the first and last label are near their sweeps";
    for (std::size_t i = 0; i < box.world_from_box.pose.size(); ++i) {
        const Pose truth = TruckScenesFolder::box_at(box.world_from_box.time_s[i]);
        EXPECT_LT(
            glm::distance(box.world_from_box.pose[i].translation + actual.world_offset_m, truth.translation),
            1e-6);
    }
}

TEST(TruckScenes, LidarsFramesAndKeyframes) {
    const TruckScenesFolder data("choice");
    const Log top = load(data, {.frames = {3, 6}, .lidars = {"LIDAR_TOP_FRONT"}});
    ASSERT_EQ(top.lidars.size(), 1u);
    EXPECT_EQ(top.lidars[0].name, "LIDAR_TOP_FRONT");
    ASSERT_EQ(top.frames.size(), 2u);
    EXPECT_EQ(top.frames[0].index, 3);
    EXPECT_EQ(top.frames[1].index, 5) << "numbers are those of LIDAR_LEFT";
    for (const Frame& frame : top.frames) expect_truth(top, frame, data.lidars[1]);
    EXPECT_THAT(top.notes, testing::Contains(test::Names("LiDARs ... read: LIDAR_LEFT")));
    data.expect_error("LiDAR 'LIDAR_REAR' ... LIDAR_LEFT", {.lidars = {"LIDAR_REAR"}});
    EXPECT_EQ(load(data, {.sequence = "0044"}).frames.size(),
              std::size_t(2 * TruckScenesFolder::kSweeps - 1));
    fs::remove_all(data.folder / "sweeps");
    fs::remove(data.table("sample_annotation"));
    const Log keyframes = load(data);
    ASSERT_EQ(keyframes.frames.size(), 6u);
    EXPECT_NEAR(keyframes.lidars[0].sweep_period_s(), TruckScenesFolder::kSweep_s, 1e-4)
        << "a turn, not the time between keyframes";
    EXPECT_EQ(keyframes.lidars[1].sensor.beams.size(), 24u);
    EXPECT_TRUE(keyframes.boxes.empty());
}

TEST(TruckScenes, SaysWhatIsWrong) {
    const TruckScenesFolder data("errors");
    EXPECT_THROW(load(data, {.sequence = "scene-"}), UsageError) << "two begin so";
    EXPECT_THROW(load(data, {.sequence = "ef1a"}), DataError) << "a scene without files";
    fs::remove(data.sweep("LIDAR_LEFT", 3));
    data.expect_error("LIDAR_LEFT_3.pcd ... use dataset.skip_broken=true");
    EXPECT_EQ(load(data, {.skip_broken = true}).frames.size(),
              std::size_t(2 * TruckScenesFolder::kSweeps - 2));
}

std::string replace_all(std::string text, const std::string& from, const std::string& to) {
    for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size())
        text.replace(at, from.size(), to);
    return text;
}

/// As distributed on Kaggle: tables in train_data, `lidar/NAME.bin` in train_lidar with 5
/// columns, of which the last two are constant, and time stamps with a fraction.
/// @return ranges of the points by file
std::map<std::string, std::vector<float>> make_lyft(const TruckScenesFolder& data) {
    std::map<std::string, std::vector<float>> ranges;
    for (const TruckScenesFolder::Lidar& lidar : data.lidars)
        for (int s = 0; s < TruckScenesFolder::kSweeps; ++s) {
            const fs::path file = data.sweep(lidar.channel, s);
            if (!fs::exists(file)) continue;
            const std::string pcd = test::read_text(file), name = fmt::format("{}_{}.bin", lidar.channel, s);
            std::string bytes;
            for (std::size_t at = pcd.find("DATA binary\n") + 12; at < pcd.size(); at += 24) {
                float values[5];
                std::memcpy(values, pcd.data() + at, 12);
                values[3] = 100.0f;
                values[4] = 1.0f;
                bytes.append(reinterpret_cast<const char*>(values), sizeof values);
                ranges[name].push_back(std::hypot(values[0], values[1], values[2]));
            }
            test::write_text(data.folder / "train_lidar" / name, bytes);
        }
    std::string files = test::read_text(data.table("sample_data"));
    for (const char* folder : {"samples", "sweeps"})
        for (const char* channel : {"LIDAR_LEFT", "LIDAR_TOP_FRONT"})
            files = replace_all(files, fmt::format("{}/{}/", folder, channel), "lidar/");
    files = replace_all(replace_all(files, ".pcd\"", ".bin\""), "000, \"is_key_frame\"",
                        "000.25, \"is_key_frame\"");
    test::write_text(data.table("sample_data"), files);
    const std::string sensors = test::read_text(data.table("sensor"));
    test::write_text(data.table("sensor"),
                     replace_all(sensors, "\"channel\": \"LIDAR_TOP_FRONT\"", "\"channel\": \"LIDAR_TOP\""));
    fs::rename(data.folder / "v1.2-trainval", data.folder / "train_data");
    for (const char* folder : {"samples", "sweeps"}) fs::remove_all(data.folder / folder);
    return ranges;
}

TEST(Lyft, ReturnsOfBothLidars) {
    const TruckScenesFolder data("lyft");
    auto ranges = make_lyft(data);
    EXPECT_EQ(detect_kind(data.folder), "lyft");
    const Log actual = load(data);
    EXPECT_EQ(actual.name, "Lyft Level 5 scene-0044384af3d8494e913fb8b14915239e-3");
    ASSERT_EQ(actual.lidars.size(), 2u);
    EXPECT_EQ(actual.lidars[0].name, "LIDAR_TOP") << "comes first";
    EXPECT_EQ(actual.lidars[1].name, "LIDAR_LEFT");
    ASSERT_EQ(actual.frames.size(), std::size_t(2 * TruckScenesFolder::kSweeps - 2))
        << "LIDAR_LEFT has a sweep that LIDAR_TOP lacks";
    EXPECT_THAT(actual.notes,
                testing::Contains(test::Names("LIDAR_LEFT ... 1 sweeps ... skipped ... LIDAR_TOP")));
    EXPECT_THAT(actual.notes, testing::Contains(test::Names("LIDAR_LEFT ... times")));
    for (const Lidar& lidar : actual.lidars) {
        EXPECT_NEAR(lidar.sweep_period_s(), 0.1, 1e-9);
        EXPECT_EQ(lidar.sensor.columns, TruckScenesFolder::kColumns);
    }
    EXPECT_EQ(actual.lidars[0].sensor.beams.size(), 24u);
    EXPECT_EQ(actual.lidars[1].sensor.beams.size(), 17u);
    for (const Frame& frame : actual.frames) {
        const int sweep = frame.index < TruckScenesFolder::kMissing ? frame.index : frame.index + 1;
        std::vector<float> read,
            &written =
                ranges[fmt::format("{}_{}.bin", frame.lidar == 0 ? "LIDAR_TOP_FRONT" : "LIDAR_LEFT", sweep)];
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            if (frame.scan.range_m[i] == 0.0f) continue;
            read.push_back(frame.scan.range_m[i]);
            ASSERT_FLOAT_EQ(frame.scan.intensity[i], 100.0f / 255.0f);
        }
        std::ranges::sort(read);
        std::ranges::sort(written);
        ASSERT_EQ(read.size(), written.size());
        for (std::size_t i = 0; i < read.size(); ++i) ASSERT_NEAR(read[i], written[i], 1e-4f);
    }
    const Pose truth = TruckScenesFolder::compute_vehicle_pose(0.507);
    EXPECT_LT(glm::distance(actual.world_from_vehicle.pose_at(0.5).translation + actual.world_offset_m,
                            truth.translation),
              1e-5);
}

TEST(Lyft, PointsThatWereMovedHaveNoColumns) {
    const TruckScenesFolder data("lyft_moved");
    make_lyft(data);
    // The truck moves during the sweep.
    const auto moved_s = [](std::size_t point) { return 0.1 * double(point % 400) / 400.0; };
    for (const fs::directory_entry& file : fs::directory_iterator(data.folder / "train_lidar")) {
        std::string bytes = test::read_text(file.path());
        for (std::size_t i = 0; i * 20 < bytes.size(); ++i) {
            float x = 0.0f;
            std::memcpy(&x, bytes.data() + i * 20, 4);
            x += float(15.2 * moved_s(i));
            std::memcpy(bytes.data() + i * 20, &x, 4);
        }
        test::write_text(file.path(), bytes);
    }
    const Log actual = load(data, {.lidars = {"LIDAR_TOP"}});
    EXPECT_EQ(actual.frames[0].scan.rays.rows, 1) << "rays without order";
    EXPECT_EQ(actual.frames[0].scan.count_returns(), actual.frames[0].scan.rays.size());
    EXPECT_THAT(actual.notes, testing::Contains(test::Names("dropped")));
}

}  // namespace
}  // namespace relidar
