// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include "read/datasets/argoverse2/argoverse2_log.hpp"
#include "read/datasets/kitti/kitti_drive.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::Argoverse2Log;
using test::Argoverse2Options;
using test::YardRay;

const DatasetOptions kFar{.max_range_m = 200.0};

/// The elevation identifies the beam, a time within half a pair interval the firing.
class TrueRays {
public:
    TrueRays(const std::vector<YardRay>& rays, const SpinningSensor& sensor) {
        for (const YardRay& ray : rays) {
            std::size_t channel = 0;
            for (std::size_t k = 0; k < sensor.beams.size(); ++k)
                if (std::abs(sensor.beams[k].elevation_rad - std::asin(ray.direction.z)) <
                    std::abs(sensor.beams[channel].elevation_rad - std::asin(ray.direction.z)))
                    channel = k;
            of_channel_[channel].push_back(&ray);
        }
    }
    const YardRay& at(std::uint16_t channel, double time_s) const {
        const auto& rays = of_channel_[channel];
        const auto after = std::lower_bound(rays.begin(), rays.end(), time_s,
                                            [](const YardRay* r, double t) { return r->time_s < t; });
        if (after == rays.begin()) return **after;
        if (after == rays.end() || time_s - after[-1]->time_s < (*after)->time_s - time_s) return *after[-1];
        return **after;
    }

private:
    std::array<std::vector<const YardRay*>, 32> of_channel_;
};

// The position of a LiDAR is interpolated along chords, with r = 1.3754 m from the axle
// and 0.035088 rad per sweep. At s sweeps after the start of a chord, the distance to the
// arc is r angle^2 |s (s - 1)| / 2. Within the chord, it is at most r angle^2 / 8. The
// last sweep extrapolates the last chord up to s = 2.027.
constexpr double kArc_m = 1.3754 * 0.035088 * 0.035088, kBetween_m = kArc_m / 8 + 1e-6,
                 kBeyond_m = kArc_m * 2.027 * 1.027 / 2 + 1e-6;
constexpr double kNearest_m = 4.7;

TEST(Argoverse2, EveryRayIsWhereItWasFired) {
    const Argoverse2Log files("rays");
    EXPECT_EQ(detect_kind(files.folder), "argoverse2");
    const Log log = files.load(kFar);
    ASSERT_EQ(log.frames.size(), 6u);
    ASSERT_EQ(log.lidars.size(), 2u);
    EXPECT_EQ(log.lidars[0].name, "up_lidar");
    EXPECT_TRUE(log.lidars[0].sensor.clockwise);
    EXPECT_FALSE(log.lidars[1].sensor.clockwise) << "it hangs upside down and turns the same way";
    EXPECT_TRUE(log.rolling_shutter);
    for (const Frame& frame : log.frames) {
        const std::vector<YardRay>& rays = files.rays[std::size_t(frame.index)][std::size_t(frame.lidar)];
        const Lidar& lidar = log.lidar_of(frame);
        ASSERT_EQ(frame.scan.rays.columns, Argoverse2Options().firings);
        EXPECT_EQ(frame.scan.count_returns(),
                  std::size_t(std::count_if(rays.begin(), rays.end(), [](auto& r) { return r.returned; })));
        const TrueRays truth(rays, lidar.sensor);
        const PoseTrack track = log.lidar_track(frame.lidar);
        const double off_m = frame.index == 2 ? kBeyond_m : kBetween_m;
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const float range_m = frame.scan.range_m[i];
            const YardRay& ray =
                truth.at(frame.scan.rays.channel[i], double(frame.scan.rays.time_offset_s[i]));
            // A ray without a return has the time of its firing sequence. This time
            // differs by up to 35 us from the exact firing time.
            ASSERT_NEAR(frame.scan.rays.time_offset_s[i], ray.time_s, range_m > 0.0f ? 1e-8 : 2.9e-5);
            const auto [origin_m, point_m] = test::place_return(log, track, frame, i);
            ASSERT_EQ(range_m > 0.0f, ray.returned) << i;
            ASSERT_LT(glm::distance(origin_m, ray.origin_m), range_m > 0.0f ? off_m : 2e-3);
            ASSERT_LT(glm::distance(glm::dvec3(frame.scan.rays.direction[i]), ray.direction),
                      range_m > 0.0f ? off_m / kNearest_m : 5e-4)
                << i;
            if (range_m > 0.0f) {
                ASSERT_LT(glm::distance(point_m, ray.point_m), 1e-4);
                ASSERT_EQ(frame.scan.intensity[i], 0.2f);
            }
        }
    }
}

/// The sensors do not face forward at the time of the sweep. Moving objects must still be
/// placed at the times of their rays.
TEST(Argoverse2, HeadsFaceThingsWhenTheirRaysWereFired) {
    const Argoverse2Log files("facing");
    const Log log = files.load(kFar);
    for (const Frame& frame : log.frames) {
        ASSERT_TRUE(frame.start.has_value());
        std::size_t late = 0;
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const glm::dvec3 point_m(frame.scan.rays.origin[i] + 10.0f * frame.scan.rays.direction[i]);
            const double facing_s = facing_time_s(log, point_m, timing_of(frame));
            late += std::abs(facing_s - frame.time_s - double(frame.scan.rays.time_offset_s[i])) > 3e-3;
        }
        // Only few rays may be late. Beams deviate by up to 4.2 degrees from the sensor's
        // azimuth (1.2 ms). The sweep is longer than a turn, so its ends overlap.
        EXPECT_LT(double(late), 0.03 * double(frame.scan.rays.size())) << frame.index << " " << frame.lidar;
    }
}

TEST(Argoverse2, TimesPosesAndBoxes) {
    const Argoverse2Log files("boxes");
    const Log log = files.load();
    ASSERT_EQ(log.world_from_vehicle.time_s.size(), 3u);
    EXPECT_EQ(log.start_unix_ns, Argoverse2Log::kFirstSweep_ns);
    for (std::size_t i = 0; i < 3; ++i) {
        const double time_s = double(i) * 0.100252;
        EXPECT_NEAR(log.world_from_vehicle.time_s[i], time_s, 1e-9);
        test::expect_pose(log, log.world_from_vehicle.pose[i], Argoverse2Log::compute_vehicle_pose(time_s));
    }
    ASSERT_EQ(log.boxes.size(), 1u);
    const BoxTrack& box = log.boxes[0];
    EXPECT_EQ(box.id, "1046f12a");
    EXPECT_EQ(box.category, "REGULAR_VEHICLE");
    EXPECT_EQ(box.size_m, glm::dvec3(4.5, 1.9, 1.6));
    ASSERT_EQ(box.world_from_box.pose.size(), 3u);
    for (std::size_t i = 0; i < 3; ++i)
        test::expect_pose(log, box.world_from_box.pose[i],
                          Argoverse2Log::compute_box_pose(box.world_from_box.time_s[i]));
}

TEST(Argoverse2, PointsTellWhichHalfIsUp) {
    const Argoverse2Log files("halves",
                              {.lower_half_up = true, .sweeps = 2, .codec = test::FeatherCodec::none});
    const Log log = files.load(kFar);
    for (const Frame& frame : log.frames) {
        const std::vector<YardRay>& rays = files.rays[std::size_t(frame.index)][std::size_t(frame.lidar)];
        EXPECT_EQ(frame.scan.count_returns(),
                  std::size_t(std::count_if(rays.begin(), rays.end(), [](auto& r) { return r.returned; })));
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            const glm::vec3& d = frame.scan.rays.direction[i];
            const double beam = log.lidar_of(frame).sensor.beams[frame.scan.rays.channel[i]].elevation_rad;
            ASSERT_NEAR(std::atan2(d.z, std::hypot(d.x, d.y)), beam, kBeyond_m / kNearest_m);
        }
    }
}

TEST(Argoverse2, FrameRangePosesAndNoLabels) {
    const Argoverse2Log files("range");
    fs::remove(files.file("annotations.feather"));
    const Log log = files.load({.frames = {1, 3}});
    ASSERT_EQ(log.frames.size(), 4u);
    EXPECT_EQ(log.frames[0].index, 1);
    EXPECT_NEAR(log.frames[0].time_s, 0.100252, 1e-9);
    EXPECT_TRUE(log.boxes.empty());
    EXPECT_THAT(log.notes, testing::Contains(test::Names("annotations.feather ... missing")));
    test::write_text(files.file("poses.txt"),
                     "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 5 0 1 0 0 0 0 1 0\n1 0 0 6 0 1 0 0 0 0 1 0\n");
    EXPECT_EQ(files.load({.frames = {1, 3}, .poses_file = files.file("poses.txt")}).world_offset_m,
              glm::dvec3(6, 0, 0));
    EXPECT_EQ(files.load({.poses_file = kNoPoses}).world_from_vehicle.pose[1].translation,
              glm::dvec3(0, 0, 0));
    EXPECT_THROW(files.load({.frames = {3, -1}}), UsageError);
}

std::string make_point_bytes(float x, std::uint8_t laser, std::int32_t offset_ns) {
    return test::make_feather_bytes({test::make_numbers("x", std::vector{x}),
                                     test::make_numbers("y", std::vector{1.0f}),
                                     test::make_numbers("z", std::vector{1.0f}),
                                     test::make_numbers("intensity", std::vector<std::uint8_t>{1}),
                                     test::make_numbers("laser_number", std::vector{laser}),
                                     test::make_numbers("offset_ns", std::vector{offset_ns})});
}

TEST(Argoverse2, ASweepMayLackALidar) {
    const Argoverse2Log files("lacking");
    test::write_text(files.sweep(1), make_point_bytes(8.0f, 40, 5000000));
    const Log log = files.load();
    ASSERT_EQ(log.frames.size(), 5u);
    EXPECT_EQ(log.frames[2].lidar, 1);
    EXPECT_THAT(log.notes, testing::Contains(test::Names("1 frames")));
}

TEST(Argoverse2, SaysWhichFileIsWrong) {
    const Argoverse2Log files("errors", {.sweeps = 2, .codec = test::FeatherCodec::none});
    const auto refuse = [&](const fs::path& file, const std::vector<test::FeatherColumn>& columns,
                            const std::string& part) {
        files.expect_error_with(file, test::make_feather_bytes(columns),
                                file.filename().string() + " ... " + part);
    };
    const fs::path sensors = files.file("calibration/egovehicle_SE3_sensor.feather"),
                   vehicle_poses = files.file("city_SE3_egovehicle.feather"),
                   boxes = files.file("annotations.feather"), sweep = files.sweep(1);
    const std::vector<Pose> two(2);
    refuse(sensors, test::set_poses({test::make_texts("sensor_name", {"up_lidar", "ring"})}, two),
           "'sensor_name' ... down_lidar");
    std::vector<Pose> bad = two;
    bad[1].rotation = glm::dquat(0.5, 0, 0, 0);
    refuse(sensors, test::set_poses({test::make_texts("sensor_name", {"up_lidar", "down_lidar"})}, bad),
           "'qw' ... 'qz' ... row 1 ... 0.5 ... 1");
    const auto times = [](std::vector<std::int64_t> t) { return test::make_numbers("timestamp_ns", t); };
    const std::int64_t first = Argoverse2Log::sweep_ns(0), second = Argoverse2Log::sweep_ns(1);
    refuse(vehicle_poses, test::set_poses({times({first, first})}, two),
           "column 'timestamp_ns': row 1 ... 315966265259836000 ... 315966265259836000");
    refuse(vehicle_poses, test::set_poses({times({first, first + 1})}, two), "pose ... 315966265360088000");
    bad = two;
    bad[0].translation.y = NAN;
    refuse(vehicle_poses, test::set_poses({times({first, second})}, bad), "column 'ty_m': row 0 ... nan");
    const auto label = [&](double length_m) {
        const std::vector<double> one{1.0};
        return test::set_poses(
            {times({first}), test::make_texts("track_uuid", {"a"}), test::make_texts("category", {"DOG"}),
             test::make_numbers("length_m", std::vector<double>{length_m}),
             test::make_numbers("width_m", one), test::make_numbers("height_m", one)},
            {Pose{}});
    };
    files.expect_error_with(boxes, test::make_feather_bytes(label(-1.0)), "box 'a' ... -1 x 1 x 1 m");
    const auto refuse_point = [&](float x, std::uint8_t laser, std::int32_t offset_ns,
                                  const std::string& part) {
        files.expect_error_with(sweep, make_point_bytes(x, laser, offset_ns),
                                sweep.filename().string() + " ... " + part);
    };
    refuse_point(2e4f, 1, 0, "point 0 ... (20000, 1, 1) ... 10000");
    refuse_point(NAN, 1, 0, "column 'x': row 0 ... nan");
    refuse_point(1.0f, 64, 0, "column 'laser_number': row 0 ... 64 ... 0 ... 63");
    refuse_point(1.0f, 1, 300000000, "column 'offset_ns': row 0 ... 300000000");
    refuse(sweep, {test::make_numbers("x", std::vector<float>())}, "sweep");
    refuse(sweep, {test::make_numbers("x", std::vector<float>{1.0f})}, "column 'y' ... column");
    const std::string original = test::read_text(sweep);
    files.expect_error_with(sweep, original.substr(0, original.size() / 2), "truncated");
    files.expect_error_with(sweep, "", "0 bytes");
}

TEST(Argoverse2, SaysWhatIsMissing) {
    Argoverse2Log files("missing", {.sweeps = 1, .codec = test::FeatherCodec::none});
    files.kind = "argoverse2:";
    fs::remove(files.file("calibration/egovehicle_SE3_sensor.feather"));
    files.expect_error("calibration/egovehicle_SE3_sensor.feather");
    fs::remove(files.file("city_SE3_egovehicle.feather"));
    files.expect_error("city_SE3_egovehicle.feather");
    fs::remove(files.sweep(0));
    files.expect_error("sensors/lidar ... scan");
    fs::remove_all(files.file("sensors"));
    files.expect_error("sensors/lidar ... folder");
}

}  // namespace
}  // namespace relidar
