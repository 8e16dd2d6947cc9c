// SPDX-License-Identifier: Apache-2.0
#include <relidar/read/dataset.hpp>

#include <cstdlib>

#include "base/codecs/tfrecord.hpp"
#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/datasets/waymo/waymo_segment.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::Names;
using test::WaymoPixel;
using test::WaymoSegment;

Log read(const WaymoSegment& segment, const DatasetOptions& options = {}) {
    return load_log(segment.file.string(), options);
}

TEST(Waymo, IntensitiesAreCutOrSquashed) {
    const WaymoSegment segment("waymo_intensity");
    const Log squashed = read(segment), cut = read(segment, {.waymo = {.clamp_intensity = true}});
    int above_1 = 0;
    for (std::size_t i = 0; i < segment.top[0].size(); ++i) {
        const WaymoPixel& pixel = segment.top[0][i];
        if (pixel.range_m == 0.0f) continue;
        above_1 += pixel.intensity > 1.0f;
        EXPECT_EQ(cut.frames[0].scan.intensity[i], std::min(pixel.intensity, 1.0f)) << i;
        EXPECT_NEAR(squashed.frames[0].scan.intensity[i], std::tanh(pixel.intensity), 1e-6f) << i;
    }
    EXPECT_GT(above_1, 10);
    EXPECT_THAT(cut.conventions, Names("Waymo's ... clamped ... 1"));
    EXPECT_THAT(squashed.conventions, Names("tanh ... Waymo's"));
}

void expect_pixels(const Log& log, const Frame& frame, const std::vector<WaymoPixel>& truth) {
    ASSERT_EQ(frame.scan.rays.size(), truth.size());
    std::size_t n = 0;
    for (std::size_t i = 0; i < truth.size(); ++i) {
        ASSERT_EQ(frame.scan.range_m[i], truth[i].range_m) << i;
        ASSERT_NEAR(frame.scan.intensity[i], std::tanh(truth[i].intensity), 1e-6f);
        ASSERT_EQ(frame.scan.rays.channel[i], i / std::size_t(frame.scan.rays.columns));
        if (truth[i].range_m == 0.0f) continue;
        ++n;
        const WorldReturn actual = locate_return(log, frame, i);
        ASSERT_LT(glm::distance(actual.point_m + log.world_offset_m, truth[i].point_m), 1e-3) << i;
        if (frame.scan.second_returns.empty()) continue;
        ASSERT_EQ(frame.scan.second_returns[0].range_m[i], truth[i].second_m) << i;
    }
    EXPECT_GT(n, truth.size() / 2);
}

TEST(Waymo, PointsStandInTheWorldWhereTheyWere) {
    const WaymoSegment segment("waymo");
    EXPECT_EQ(detect_kind(segment.file), "waymo");
    EXPECT_EQ(detect_kind(segment.folder), "waymo");
    EXPECT_TRUE(is_dataset(segment.file));
    const Log log = read(segment);
    ASSERT_EQ(log.lidars.size(), 2u);
    EXPECT_EQ(log.lidars[0].name, "TOP");
    EXPECT_EQ(log.lidars[1].name, "SIDE_LEFT");
    ASSERT_EQ(log.frames.size(), 6u);
    ASSERT_EQ(log.world_from_vehicle.pose.size(), 3u);
    for (std::size_t i = 0; i < 3; ++i) {
        const Frame &top = log.frames[2 * i], &side = log.frames[2 * i + 1];
        EXPECT_EQ(top.index, int(i));
        EXPECT_EQ(top.scan.rays.rows, WaymoSegment::kTopRows);
        EXPECT_EQ(side.scan.rays.columns, WaymoSegment::kSideColumns);
        ASSERT_EQ(top.scan.second_returns.size(), 1u);
        EXPECT_TRUE(side.scan.second_returns.empty());
        expect_pixels(log, top, segment.top[i]);
        expect_pixels(log, side, segment.side[i]);
    }
}

TEST(Waymo, RaysAreTheSensorsOwn) {
    const WaymoSegment segment("waymo_rays");
    const Log log = read(segment);
    const Lidar& lidar = log.lidars[0];
    EXPECT_NEAR(lidar.sensor.period_s, 0.1, 1e-9);
    for (int row = 0; row < WaymoSegment::kTopRows; ++row)
        EXPECT_EQ(lidar.sensor.beams[std::size_t(row)].elevation_rad,
                  WaymoSegment::list_top_inclinations()[std::size_t(WaymoSegment::kTopRows - 1 - row)]);
    const RayTable model = make_rays(lidar.sensor);
    const Frame& frame = log.frames[2];
    const glm::dvec3 forward(
        WaymoSegment::world_from_vehicle(frame.time_s * 1e6 + WaymoSegment::kStart_us)[3]);
    EXPECT_LT(glm::distance(log.world_from_vehicle.pose[1].translation + log.world_offset_m, forward), 0.03)
        << "2 ms at 12 m/s";
    std::size_t n_dropped = 0;
    for (std::size_t i = 0; i < model.size(); ++i) {
        const WaymoPixel& truth = segment.top[1][i];
        const double column = double(i % WaymoSegment::kTopColumns) + 0.5;
        EXPECT_NEAR(frame.time_s + double(frame.scan.rays.time_offset_s[i]),
                    0.1 + 0.1 * column / WaymoSegment::kTopColumns, 1e-6);
        EXPECT_LT(glm::distance(frame.scan.rays.direction[i], model.direction[i]), 2e-3)
            << "the vehicle turns 1 mrad in 2 ms";
        if (truth.range_m > 0.0f) continue;
        ++n_dropped;
        const WorldRay ray = make_world_ray(log.lidar_track(0), frame.time_s, frame.scan.rays, i, true);
        const glm::dvec3 there = ray.origin_m + log.world_offset_m + 10.0 * ray.direction;
        EXPECT_LT(glm::distance(there, truth.point_m), 0.06)
            << "the way between its pixel's time and its column's";
    }
    EXPECT_GT(n_dropped, model.size() / 20);
}

TEST(Waymo, LabelsAreBoxesOfTheWorld) {
    const WaymoSegment segment("waymo_boxes");
    const Log log = read(segment);
    ASSERT_EQ(log.boxes.size(), 2u) << "signs stay where they are";
    const BoxTrack &parked = log.boxes[0], &walker = log.boxes[1];
    EXPECT_EQ(parked.id, "parked");
    EXPECT_EQ(parked.category, "vehicle");
    EXPECT_EQ(parked.size_m, glm::dvec3(4.6, 2.0, 1.6));
    EXPECT_EQ(walker.category, "pedestrian");
    ASSERT_EQ(walker.world_from_box.pose.size(), 3u);
    for (std::size_t i = 0; i < 3; ++i) {
        EXPECT_EQ(walker.world_from_box.time_s[i], log.frames[2 * i].time_s);
        const glm::dmat4 vehicle = WaymoSegment::world_from_vehicle(WaymoSegment::label_time_us(int(i)));
        const glm::dvec3 truth(vehicle * glm::dvec4(10.0 + double(i), 2, 1, 1));
        EXPECT_LT(glm::distance(walker.world_from_box.pose[i].translation + log.world_offset_m, truth), 1e-6);
        const glm::dvec3 centre(WaymoSegment::get_world_from_parked()[3]);
        EXPECT_LT(glm::distance(parked.world_from_box.pose[i].translation + log.world_offset_m, centre),
                  1e-6);
    }
    for (const Frame& frame : log.frames) {
        if (frame.lidar != 0) continue;
        std::size_t inside = 0;
        for (std::size_t ray = 0; ray < frame.scan.rays.size(); ++ray)
            inside += frame.scan.range_m[ray] > 0.0f &&
                      parked.contains_point(locate_return(log, frame, ray).point_m, frame.time_s, 0.1);
        EXPECT_GT(inside, 10u) << frame.index;
    }
}

TEST(Waymo, SegmentsFramesAndPoses) {
    const WaymoSegment segment("waymo_names");
    fs::copy_file(segment.file, segment.folder / "segment-9.tfrecord");
    EXPECT_THAT(segment.load().notes, testing::Contains(Names("2 segments")));
    const Log one = segment.load({.sequence = "9", .frames = {1, 2}});
    EXPECT_EQ(one.name, "segment-9");
    EXPECT_EQ(one.start_unix_ns, 1000 * WaymoSegment::kStart_us);
    ASSERT_EQ(one.frames.size(), 2u);
    EXPECT_EQ(one.frames[0].index, 1);
    EXPECT_NEAR(one.frames[0].time_s, 0.15, 1e-9) << "counted from the segment's first firing";
    EXPECT_THROW(segment.load({.sequence = "7"}), UsageError);
    EXPECT_THROW(read(segment, {.frames = {3, -1}}), UsageError);
    fs::copy_file(segment.file, segment.folder / "segment-113792_x.tfrecord");
    const Log paper = segment.load({.sequence = "ws1"});
    EXPECT_EQ(paper.name, "segment-113792_x");
    EXPECT_EQ(paper.lidars.size(), 1u) << "the paper renders TOP";
    ASSERT_EQ(paper.frames.size(), 2u);
    EXPECT_EQ(paper.frames[0].index, 1);
    const Log none = read(segment, {.poses_file = kNoPoses});
    EXPECT_EQ(none.world_from_vehicle.pose[2].translation, glm::dvec3(0.0));
    const glm::dmat4 from_world = glm::inverse(
        WaymoSegment::world_from_vehicle(WaymoSegment::kStart_us + 1.5 * WaymoSegment::kPeriod_us));
    EXPECT_LT(glm::distance(none.boxes[0].world_from_box.pose[1].translation,
                            glm::dvec3(from_world * WaymoSegment::get_world_from_parked()[3])),
              0.1);
}

TEST(Waymo, Crc32cOfTheStandard) {
    // the check value of CRC-32C
    EXPECT_EQ(masked_crc32c("123456789"),
              std::uint32_t(((0xE3069283u >> 15) | (0xE3069283u << 17)) + 0xa282ead8u));
}

TEST(Waymo, DamagedFilesAreRefused) {
    const WaymoSegment segment("waymo_damage");
    const std::string original = test::read_text(segment.file),
                      second = test::make_tfrecord(segment.frames[1].encode_frame_message());
    const std::size_t first_size = test::make_tfrecord(segment.frames[0].encode_frame_message()).size();
    const auto flipped = [&](std::size_t at) {
        std::string bytes = original;
        bytes[at] = char(bytes[at] ^ 0x10);
        return bytes;
    };
    const std::string absurd("\xff\xff\xff\xff\xff\xff\xff\x7f", 8);
    const std::string header =
        absurd + test::make_tfrecord(absurd).substr(20, 4);  // the CRC of these 8 bytes
    const auto expect = [&](const std::string& bytes, const std::string& parts) {
        segment.expect_error_with(segment.file, bytes, parts);
    };
    expect("", ".tfrecord ... empty");
    expect(original.substr(0, first_size + 5), "record 1 ... 5");
    expect(original.substr(0, original.size() - 1), "record 2 ... length ... ");
    expect(flipped(first_size + 100), "record 1 ... checksum ... data");
    expect(flipped(first_size), "record 1 ... checksum ... length");
    expect(header + original, "record 0 ... 9223372036854775807");
    expect(test::make_tfrecord("not a message"), "record 0: ");
    expect(test::make_tfrecord(""), "record 0 ... pose");
}

TEST(Waymo, DamagedFramesAreRefused) {
    WaymoSegment segment("waymo_frames");
    const std::vector<test::WaymoFrame> good = segment.frames;
    const auto expect = [&](const std::string& part, const std::function<void(test::WaymoFrame&)>& damage) {
        segment.frames = good;
        damage(segment.frames[1]);
        segment.write();
        segment.expect_error(part);
    };
    const int h = WaymoSegment::kTopRows, w = WaymoSegment::kTopColumns;
    const auto expect_top = [&](const std::string& part, const std::string& image,
                                const std::string& poses = "") {
        expect(part, [&](auto& frame) { frame.lasers[1] = test::make_waymo_laser(1, image, "", poses); });
    };
    const auto image = [](int rows, int columns, int channels, float value) {
        return test::make_waymo_matrix(std::vector<float>(std::size_t(rows * columns * channels), value),
                                       {rows, columns, channels});
    };
    expect_top("record 1: TOP ... 33554432 bytes",
               test::deflate_bytes(std::string(std::size_t(100) << 20, '\0')));
    expect_top("record 1: TOP ... zlib", image(h, w, 4, 5.0f).substr(0, 40));
    expect_top("record 1: TOP ... malformed", test::deflate_bytes("\x0a\x7f"));
    expect_top("record 1: TOP ... 4 ... 3 ... 1000000 x 1000000 x 4",
               test::make_waymo_matrix({1, 2, 3, 4}, {1000000, 1000000, 4}));
    expect_top("record 1: TOP ... 32000 values ... 16 x 400 x 5", image(h, w, 5, 1.0f));
    expect_top("16 x 399 ... 16 x 400", image(h, w - 1, 4, 1.0f));
    expect_top("ray 0, range_m ... nan", image(h, w, 4, NAN));
    expect_top("ray 0, range_m ... inf", image(h, w, 4, INFINITY));
    expect_top("2 x 2 ... poses ... 16 x 400", image(h, w, 4, 1.0f), image(2, 2, 6, 0.0f));
    expect_top("pose 0 ... nan", image(h, w, 4, 1.0f), image(h, w, 6, NAN));
    expect("record 1 ... SIDE_LEFT ... missing",
           [](auto& frame) { frame.lasers.erase(frame.lasers.begin()); });
    expect("record 1 ... pose", [](auto& frame) { frame.pose.clear(); });
    expect("record 1: pose ... 0 ... 16", [](auto& frame) { frame.pose = std::string("\x10\x01", 2); });
    expect("record 1: pose ... rotation",
           [](auto& frame) { frame.pose = test::make_waymo_transform(glm::dmat4(2.0)); });
    expect("record 1: pose ... nan",
           [](auto& frame) { frame.pose = test::make_waymo_transform(glm::dmat4(NAN)); });
    expect("timestamp_micros", [](auto& frame) { frame.timestamp_us += 5000000; });
    for (const double length_m : {0.0, double(INFINITY)})
        expect("box 'v' ... x 1 x 1 m", [&](auto& frame) {
            frame.labels = {test::make_waymo_label("v", 1, {}, {length_m, 1, 1}, 0)};
        });
}

/// All ranges are 5 m. Pixel i has the instance i and one of four classes.
std::string make_labelled_top(int n_labels, const std::vector<int>& dims) {
    constexpr int kTypes[] = {0, 1, 18, 22};  // undefined, car, road, sidewalk
    std::vector<int> labels;
    for (int i = 0; i < n_labels; ++i) labels.insert(labels.end(), {i, kTypes[i % 4]});
    const int h = WaymoSegment::kTopRows, w = WaymoSegment::kTopColumns;
    return test::make_waymo_laser(
        1, test::make_waymo_matrix(std::vector<float>(std::size_t(h * w * 4), 5.0f), {h, w, 4}), "", "",
        test::make_waymo_integer_matrix(labels, dims));
}

TEST(Waymo, ReadsTheClassesOfPoints) {
    using enum SurfaceClass;
    constexpr SurfaceClass kClasses[] = {unknown, vehicle, road, sidewalk};
    WaymoSegment segment("waymo_classes");
    const int h = WaymoSegment::kTopRows, w = WaymoSegment::kTopColumns;
    segment.frames[1].lasers[1] = make_labelled_top(h * w, {h, w, 2});
    segment.write();
    const Log log = read(segment);
    for (const Frame& frame : log.frames) {
        const bool has_labels = frame.index == 1 && log.lidar_of(frame).name == "TOP";
        ASSERT_EQ(frame.scan.classes.size(), has_labels ? frame.scan.range_m.size() : 0u);
        for (std::size_t i = 0; i < frame.scan.classes.size(); ++i)
            ASSERT_EQ(frame.scan.classes[i], kClasses[i % 4]) << i;
    }
    segment.frames[1].lasers[1] = make_labelled_top(h * (w - 1), {h, w - 1, 2});
    segment.write();
    segment.expect_error("16 x 399 ... 16 x 400");
}

TEST(Waymo, DamagedCalibrationsAreRefused) {
    WaymoSegment segment("waymo_calibration");
    const auto expect = [&](const std::string& part, const std::vector<std::string>& calibrations) {
        segment.frames[0].context = test::make_waymo_context(calibrations);
        segment.write();
        segment.expect_error(part);
    };
    const std::string side = test::make_waymo_calibration(3, {}, -1.5, 0.5, glm::dmat4(1.0));
    expect("record 0: laser_calibrations ... TOP", {side});
    expect("record 0 ... 2 beam_inclinations ... laser 1 ... 16 rows",
           {side, test::make_waymo_calibration(1, {0.0, 0.1}, 0, 0, glm::dmat4(1.0))});
    expect("Waymo TOP ... finite", {side, test::make_waymo_calibration(1, {}, NAN, 0, glm::dmat4(1.0))});
    expect("record 0: laser_calibrations ... rotation",
           {side, test::make_waymo_calibration(1, {}, 0, 0.1, glm::dmat4(0.5))});
}

}  // namespace
}  // namespace relidar
