// SPDX-License-Identifier: Apache-2.0
// TruckScenes and Lyft have nuScenes tables with several LiDARs, without ring numbers.
// Clouds of TruckScenes are PCD with a time stamp of each point in microseconds, not
// motion-compensated. The vehicle has a pose every 10 ms, and files refer to the nearest.
#include <relidar/read/dataset.hpp>

#include <fmt/format.h>

#include <relidar/scene/scene.hpp>
#include "base/random.hpp"
#include "read/datasets/nuscenes/nuscenes_folder.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::YardRay;

constexpr std::int64_t kFirst_us = 1695473372703000, kPoseStep_us = 10000, kPoseOffset_us = 3000;
const glm::dvec3 kWorld_m(689012.5, 5337123.25, 0.0);

std::int64_t compute_stamp_us(int sweep, double later_s) {
    return kFirst_us + sweep * 100000 + std::llround(later_s * 1e6);
}

glm::dquat make_rotation_about(double degrees, const glm::dvec3& axis) {
    return glm::angleAxis(degrees * kPi / 180.0, axis);
}

struct TruckScenesFolder : test::LogFolder {
    static constexpr int kSweeps = 11;  ///< every fifth sweep is a keyframe
    static constexpr int kMissing = 4;  ///< sweep that LIDAR_TOP_FRONT lacks
    static constexpr int kColumns = 400;
    /// delay of the time stamps of LIDAR_TOP_FRONT relative to LIDAR_LEFT
    static constexpr double kSweep_s = 0.1, kLater_s = 0.007;

    struct Lidar {
        std::string channel;
        Pose mounted;
        std::vector<double> elevations_deg;      ///< highest first
        std::vector<std::vector<YardRay>> rays;  ///< [sweep] column by column, highest beam first
    };

    std::vector<Lidar> lidars;  ///< LIDAR_LEFT, LIDAR_TOP_FRONT

    explicit TruckScenesFolder(const std::string& name);

    fs::path table(const std::string& name) const { return folder / "v1.2-trainval" / (name + ".json"); }
    fs::path sweep(const std::string& channel, int number) const;
    /// Times are relative to the first sweep of LIDAR_LEFT.
    static Pose compute_vehicle_pose(double time_s);
    static Pose box_at(double time_s);

private:
    void write_clouds(Lidar& lidar, double later_s) const;
    void write_tables() const;
};

Pose TruckScenesFolder::compute_vehicle_pose(double time_s) {
    return {make_rotation_about(30.0 - 20.0 * time_s, {0, 0, 1}),
            kWorld_m + time_s * glm::dvec3(14.0, 6.0, 0.0)};
}

Pose TruckScenesFolder::box_at(double time_s) {
    return {make_rotation_about(10.0 + 25.0 * time_s, {0, 0, 1}),
            kWorld_m + glm::dvec3(12.0 + 5.0 * time_s, 3.0, 1.0)};
}

fs::path TruckScenesFolder::sweep(const std::string& channel, int number) const {
    return folder / (number % 5 == 0 ? "samples" : "sweeps") / channel /
           fmt::format("{}_{}.pcd", channel, number);
}

void TruckScenesFolder::write_clouds(Lidar& lidar, double later_s) const {
    const std::size_t n_beams = lidar.elevations_deg.size();
    for (int s = 0; s < kSweeps; ++s) {
        lidar.rays.emplace_back();
        std::string bytes;
        std::size_t n = 0;
        for (int column = 0; column < kColumns; ++column)
            for (std::size_t beam = 0; beam < n_beams; ++beam) {
                const std::int64_t time_us = compute_stamp_us(s, later_s) + column * 250;
                const double time_s = double(time_us - kFirst_us) * 1e-6;
                const glm::dvec3 d = test::direction_at(lidar.elevations_deg[beam] * kPi / 180.0,
                                                        2.5 - 2.0 * kPi * column / kColumns);
                YardRay ray =
                    test::cast_in_yard(time_s, compute_vehicle_pose(time_s) * lidar.mounted, d, kWorld_m);
                const double range_m = glm::distance(ray.origin_m, ray.point_m);
                ray.returned = range_m < 200.0 &&
                               hash_pair(std::uint64_t(column) * n_beams + beam, std::uint64_t(s)) % 8 != 0;
                lidar.rays.back().push_back(ray);
                if (!ray.returned) continue;
                const glm::dvec3 p = range_m * d;
                const float values[4] = {float(p.x), float(p.y), float(p.z), 51.0f};
                const auto t = std::uint64_t(time_us);
                bytes.append(reinterpret_cast<const char*>(values), sizeof values)
                    .append(reinterpret_cast<const char*>(&t), sizeof t);
                ++n;
            }
        test::write_text(
            sweep(lidar.channel, s),
            fmt::format("# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z "
                        "intensity timestamp\nSIZE 4 4 4 4 8\n"
                        "TYPE F F F F U\nCOUNT 1 1 1 1 1\nWIDTH {0}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 "
                        "0\nPOINTS {0}\nDATA binary\n",
                        n) +
                bytes);
    }
}

void TruckScenesFolder::write_tables() const {
    test::write_records(table("scene"),
                        {R"("token": "s0", "name": "scene-0044384af3d8494e913fb8b14915239e-3")",
                         R"("token": "s1", "name": "scene-ef1a21a0a9c14c9a9eb1b1a0c2ff1d10-7")"});
    std::vector<std::string> samples, mounts;
    std::vector<std::string> sensors = {
        R"("token": "radar", "channel": "RADAR_LEFT_FRONT", "modality": "radar")"};
    // The time of a sample differs slightly from the times of its files.
    for (int k = 0; k < kSweeps; k += 5)
        samples.push_back(fmt::format(R"("token": "k{}", "scene_token": "s0", "timestamp": {})", k,
                                      compute_stamp_us(k, 0.0) + (k == 0 ? 900 : -900)));
    std::vector<std::string> files, poses;
    for (const Lidar& lidar : lidars) {
        const bool is_top = &lidar != &lidars[0];
        sensors.push_back(
            fmt::format(R"("token": "{0}", "channel": "{0}", "modality": "lidar")", lidar.channel));
        mounts.push_back(fmt::format(R"("token": "on_{0}", "sensor_token": "{0}", {1})", lidar.channel,
                                     test::format_pose_keys(lidar.mounted)));
        for (int s = 0; s < kSweeps; ++s) {
            if (is_top && s == kMissing) continue;
            const int after = is_top && s + 1 == kMissing ? s + 2 : s + 1;
            const std::int64_t time_us = compute_stamp_us(s, is_top ? kLater_s : 0.0);
            const auto pose =
                std::llround(double(time_us - kFirst_us - kPoseOffset_us) / double(kPoseStep_us));
            files.push_back(
                fmt::format(R"("token": "{0}{1}", "sample_token": "k{2}", "ego_pose_token": "e{3}", )"
                            R"("calibrated_sensor_token": "on_{0}", "filename": "{4}", "fileformat": "pcd", )"
                            R"("timestamp": {5}, "is_key_frame": {6}, "next": "{7}")",
                            lidar.channel, s, (s + 4) / 5 * 5, pose,
                            fs::relative(sweep(lidar.channel, s), folder).string(), time_us, s % 5 == 0,
                            after < kSweeps ? lidar.channel + std::to_string(after) : ""));
        }
    }
    for (std::int64_t e = -5; e <= 115; ++e) {
        const std::int64_t after_us = kPoseOffset_us + e * kPoseStep_us;
        const Pose pose = compute_vehicle_pose(double(after_us) * 1e-6);
        poses.push_back(fmt::format(R"("token": "e{}", "timestamp": {}, {})", e, kFirst_us + after_us,
                                    test::format_pose_keys(pose)));
    }
    std::vector<std::string> labels;
    for (int k = 0; k < kSweeps; k += 5) {
        const double time_s = k * kSweep_s + (k == 0 ? 900e-6 : -900e-6);
        labels.push_back(fmt::format(R"("token": "a{0}", "sample_token": "k{0}", "instance_token": "van", )"
                                     R"("size": [2.1, 5.5, 2.4], {1})",
                                     k, test::format_pose_keys(box_at(time_s))));
    }
    test::write_records(table("sample"), samples);
    test::write_records(table("sensor"), sensors);
    test::write_records(table("calibrated_sensor"), mounts);
    test::write_records(table("sample_data"), files);
    test::write_records(table("ego_pose"), poses);
    test::write_records(table("sample_annotation"), labels);
    test::write_records(table("instance"), {R"("token": "van", "category_token": "c")"});
    test::write_records(table("category"), {R"("token": "c", "name": "vehicle.other")"});
}

TruckScenesFolder::TruckScenesFolder(const std::string& name) : LogFolder("relidar_truckscenes_" + name) {
    Lidar left{"LIDAR_LEFT", {make_rotation_about(85.0, {0, 0, 1}), {1.2, 1.5, 3.1}}, {}, {}};
    for (const double e :
         {15.0, 11.0, 8.0, 5.0, 3.0, 2.0, 1.0, 0.0, -1.0, -2.0, -3.0, -4.0, -6.0, -9.0, -14.0, -19.0, -25.0})
        left.elevations_deg.push_back(e);
    Lidar top{"LIDAR_TOP_FRONT",
              {make_rotation_about(-12.0, {0, 0, 1}) * make_rotation_about(40.0, {0, 1, 0}), {2.4, 0.3, 3.4}},
              {},
              {}};
    for (int b = 0; b < 24; ++b) top.elevations_deg.push_back(43.0 - b * 86.0 / 23.0);
    lidars = {left, top};
    write_clouds(lidars[0], 0.0);
    write_clouds(lidars[1], kLater_s);
    fs::remove(sweep("LIDAR_TOP_FRONT", kMissing));
    write_tables();
}

Log load(const TruckScenesFolder& data, DatasetOptions options = {}) {
    options.max_range_m = 200.0;
    return data.load(options);
}

void expect_truth(const Log& actual, const Frame& frame, const TruckScenesFolder::Lidar& lidar) {
    const std::vector<YardRay>& truth = lidar.rays[std::size_t(frame.index)];
    const PoseTrack track = actual.lidar_track(frame.lidar);
    const std::size_t n_beams = lidar.elevations_deg.size();
    std::size_t n_returns = 0;
    for (const YardRay& ray : truth) n_returns += ray.returned;
    EXPECT_EQ(frame.scan.count_returns(), n_returns);
    EXPECT_EQ(frame.scan.rays.size(), truth.size());
    for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
        if (frame.scan.range_m[i] == 0.0f) continue;
        const double fired_s = frame.time_s + double(frame.scan.rays.time_offset_s[i]);
        const auto column = std::size_t(std::lround((fired_s - truth[0].time_s) / 250e-6));
        const YardRay& ray = truth[column * n_beams + frame.scan.rays.channel[i]];
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
    EXPECT_THAT(actual.notes, testing::Contains(test::Names("'LIDAR_TOP_FRONT' ... 24 beams ... 400")));
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
    files = replace_all(replace_all(files, R"(.pcd")", R"(.bin")"), R"(000, "is_key_frame")",
                        R"(000.25, "is_key_frame")");
    test::write_text(data.table("sample_data"), files);
    const std::string sensors = test::read_text(data.table("sensor"));
    test::write_text(data.table("sensor"),
                     replace_all(sensors, R"("channel": "LIDAR_TOP_FRONT")", R"("channel": "LIDAR_TOP")"));
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
    EXPECT_THAT(actual.notes, testing::Contains(test::Names("LIDAR_LEFT ... 1 sweeps ... LIDAR_TOP")));
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
