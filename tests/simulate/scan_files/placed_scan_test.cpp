// SPDX-License-Identifier: Apache-2.0
// Tests the points in files of a scan by a moving sensor. The pose in the file must
// transform deskewed points to the world. Points in the world need no transform. The test
// computes the scan from world positions that each ray must hit.
#include <sstream>

#include <gmock/gmock.h>

#include <relidar/simulate/actor_boxes.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../plates.hpp"

namespace relidar {
namespace {

constexpr double kTolerance_m = 2e-5;     // precision of floats at 40 m
constexpr double kLasTolerance_m = 1e-4;  // its steps are 0.1 mm

const std::vector<glm::dvec3>& places() {
    static const std::vector<glm::dvec3> points = {{30, 5, 1}, {-20, 8, 3}, {4, -25, 0}, {12, 30, -1}};
    return points;
}

/// Moves at 16 m/s and turns by 40 degrees per second: 0.8 m and 2 degrees.
/// @param origin_m of places() in the dataset's world
RenderedScan make_lane_change(const glm::dvec3& origin_m = {}) {
    RenderedScan scan;
    for (int i = 0; i <= 4; ++i) {
        const double t_s = 2.9 + 0.05 * i;
        scan.track.time_s.push_back(t_s);
        scan.track.pose.push_back({make_rotation(0.7 * (t_s - 3.0), 0.02, 0.01),
                                   origin_m + glm::dvec3(16.0 * (t_s - 3.0), 0.5 * (t_s - 3.0), 1.5)});
    }
    scan.time_s = 3.0;
    scan.world_from_sensor = scan.track.pose_at(scan.time_s);
    scan.time_offset_s = {-0.05f, -0.0125f, 0.0075f, 0.05f};
    for (std::size_t i = 0; i < places().size(); ++i) {
        const glm::dvec3 point_in_sensor_m = inverse(scan.firing_pose(i)) * (origin_m + places()[i]);
        const glm::vec3 origin(0.1f, 0.0f, 0.05f);
        const glm::dvec3 vector_m = point_in_sensor_m - glm::dvec3(origin);
        scan.image.origin.push_back(origin);
        scan.image.direction.emplace_back(glm::normalize(vector_m));
        scan.image.range_m.push_back(float(glm::length(vector_m)));
    }
    return test::complete(std::move(scan));
}

template <class T>
glm::dvec3 point(const std::vector<T>& numbers, std::size_t index) {
    return {numbers[index], numbers[index + 1], numbers[index + 2]};
}

template <class T>
std::vector<glm::dvec3> read_points_behind(const std::filesystem::path& path,
                                           const std::string& end_of_header) {
    const std::string bytes = read_contents(path);
    const std::size_t begin = end_of_header.empty() ? 0 : bytes.find(end_of_header) + end_of_header.size();
    const std::size_t stride = (bytes.size() - begin) / places().size();
    std::vector<glm::dvec3> points;
    for (std::size_t i = 0; i < places().size(); ++i) {
        points.push_back(read_at<glm::vec<3, T>>(bytes, begin + i * stride));
    }
    return points;
}

/// Reads a LAS file by the byte offsets of its specification.
std::vector<glm::dvec3> read_las(const std::filesystem::path& path) {
    const std::string bytes = read_contents(path);
    const auto at = [&]<class T>(std::size_t offset, T) { return read_at<T>(bytes, offset); };
    const std::size_t begin = at(96, std::uint32_t()), stride = at(105, std::uint16_t());
    EXPECT_EQ(bytes.substr(0, 4), "LASF");
    EXPECT_EQ(at(247, std::uint64_t()), places().size());
    EXPECT_EQ(bytes.size(), begin + stride * places().size());
    std::vector<glm::dvec3> points(places().size());
    for (std::size_t i = 0; i < points.size(); ++i)
        for (std::size_t axis = 0; axis < 3; ++axis) {
            points[i][int(axis)] =
                at(131 + 8 * axis, 0.0) * at(begin + i * stride + 4 * axis, std::int32_t()) +
                at(155 + 8 * axis, 0.0);
            EXPECT_LE(points[i][int(axis)], at(179 + 16 * axis, 0.0) + 1e-9);
            EXPECT_GE(points[i][int(axis)], at(187 + 16 * axis, 0.0) - 1e-9);
        }
    return points;
}

std::vector<double> read_numbers_behind(const std::string& text, const std::string& name) {
    std::istringstream line(text.substr(text.find(name) + name.size()));
    std::vector<double> numbers;
    for (double x; line >> x;) numbers.push_back(x);
    return numbers;
}

Pose make_pose(const std::vector<double>& m) {
    const glm::dmat3 columns(m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]);
    return {glm::quat_cast(columns), {m[3], m[7], m[11]}};
}

class PlacedScans : public TemporaryFolder {
protected:
    std::filesystem::path file(const char* extension) const {
        return folder / (std::string("frame_000000.") + extension);
    }

    glm::dvec3 origin_m{0.0};  ///< of places() in the world

    void write(PointCoordinateFrame frame, bool deskew) const {
        ScanOutputOptions format;
        format.formats = {"npz", "exr", "ply", "pcd", "bin", "las"};
        format.world_offset_m = origin_m;
        format.frame = frame;
        format.deskew = deskew;
        ScanFolderWriter scans(folder, format);
        scans.write_scan(0, make_lane_change(origin_m));
        scans.finish();
    }
    void expect_places(const std::string& description, const Pose& world_from_points,
                       const std::vector<glm::dvec3>& points, double tolerance_m = kTolerance_m) const {
        for (std::size_t i = 0; i < places().size(); ++i)
            EXPECT_LT(glm::distance(world_from_points * points[i], origin_m + places()[i]), tolerance_m)
                << description << ", point " << i;
    }
    /// @param world_from_points transform of a file's points, from the pose in the file
    /// @param T type of positions in npz, ply and pcd
    /// @param float_origin_m add to positions in exr and bin
    template <class T>
    void expect_all(const std::function<Pose(const Pose&)>& world_from_points,
                    const glm::dvec3& float_origin_m = {}) const {
        const auto arrays = read_npz(file("npz"));
        const Pose of_npz = make_pose(find_array(arrays, "pose")->to_doubles());
        const std::vector<float> range_m = find_array(arrays, "range")->to_floats(),
                                 direction = find_array(arrays, "directions")->to_floats();
        const std::vector<double> origin = find_array(arrays, "origin")->to_doubles(),
                                  end = find_array(arrays, "points")->to_doubles();
        EXPECT_EQ(find_array(arrays, "points")->bytes.size(), end.size() * sizeof(T));
        const ExrImage exr = read_exr(file("exr"));
        std::vector<glm::dvec3> in_npz, npz_points, in_exr;
        for (std::size_t i = 0; i < places().size(); ++i) {
            in_npz.push_back(point(origin, 3 * i) + double(range_m[i]) * point(direction, 3 * i));
            npz_points.push_back(point(end, 3 * i));
            const auto vector = [&](const std::string& name) {
                return glm::dvec3(exr.channels.at(name + ".x")[i], exr.channels.at(name + ".y")[i],
                                  exr.channels.at(name + ".z")[i]);
            };
            in_exr.push_back(float_origin_m + vector("origin") +
                             double(exr.channels.at("range")[i]) * vector("direction"));
        }
        expect_places("npz", world_from_points(of_npz), in_npz);
        expect_places("npz points", world_from_points(of_npz), npz_points);
        expect_places(
            "exr", world_from_points(make_pose(read_numbers_behind(exr.notes.at("world_from_sensor"), ""))),
            in_exr);
        const Pose of_ply = make_pose(read_numbers_behind(read_contents(file("ply")), "world_from_sensor "));
        expect_places("ply", world_from_points(of_ply), read_points_behind<T>(file("ply"), "end_header\n"));
        std::vector<glm::dvec3> in_bin = read_points_behind<float>(file("bin"), "");
        for (glm::dvec3& p : in_bin) p += float_origin_m;
        expect_places("bin", world_from_points(of_npz), in_bin);
        expect_places("las", world_from_points(of_npz), read_las(file("las")), kLasTolerance_m);
        const std::vector<double> v = read_numbers_behind(read_contents(file("pcd")), "VIEWPOINT ");
        expect_places("pcd", {glm::dquat(v[3], v[4], v[5], v[6]), {v[0], v[1], v[2]}},
                      read_points_behind<T>(file("pcd"), "DATA binary\n"));
    }
};

TEST_F(PlacedScans, DeskewedPointsComeToTheWorldByThePoseOfTheirFile) {
    write(PointCoordinateFrame::sensor, true);
    expect_all<float>([](const Pose& world_from_sensor) { return world_from_sensor; });
}

TEST_F(PlacedScans, PointsOfTheWorldAreThere) {
    write(PointCoordinateFrame::world, false);
    expect_all<double>([](const Pose&) { return Pose{}; });
    EXPECT_EQ(read_contents(folder / "scans.json").find("world_offset_m"), std::string::npos);
}

TEST_F(PlacedScans, KeepMillimetresAtLargeCoordinates) {
    for (const glm::dvec3& origin :
         {glm::dvec3(500000.25, 4000000.1, 100.0), glm::dvec3(6378137.0, 0.3, -0.7)}) {
        origin_m = origin;
        write(PointCoordinateFrame::world, false);
        // The files of single precision have a local origin, which they name.
        const std::vector<double> v =
            read_numbers_behind(read_exr(file("exr")).notes.at("world_offset_m"), "");
        EXPECT_EQ(glm::dvec3(v[0], v[1], v[2]), origin);
        EXPECT_NE(read_contents(folder / "scans.json").find("\"world_offset_m\""), std::string::npos);
        expect_all<double>([](const Pose&) { return Pose{}; }, origin);
        write(PointCoordinateFrame::sensor, true);
        expect_all<float>([](const Pose& world_from_sensor) { return world_from_sensor; });
    }
}

TEST_F(PlacedScans, SecondReturnsHaveTheirOwnValues) {
    RenderedScan scan = make_lane_change();
    scan.second_returns = {{{40.0f, 0.0f, 0.0f, 41.0f}, {0.1f, 0.0f, 0.0f, 0.1f}}};
    scan.channels = {{{.name = "why", .none = -1.0},
                      std::vector<std::int32_t>{1, 2, 0, 0},
                      std::vector<std::int32_t>{5, -1, -1, 7}}};
    ScanOutputOptions format;
    format.formats = {"npz", "exr", "ply"};
    ScanFolderWriter scans(folder, format);
    scans.write_scan(0, scan);
    scans.finish();
    const auto arrays = read_npz(file("npz"));
    EXPECT_EQ(find_array(arrays, "why")->to_floats(), (std::vector<float>{1, 2, 0, 0}));
    EXPECT_EQ(find_array(arrays, "why_2")->to_floats(), (std::vector<float>{5, -1, -1, 7}));
    EXPECT_EQ(read_exr(file("exr")).channels.at("why_2"), (std::vector<float>{5, -1, -1, 7}));
    const std::string ply = read_contents(file("ply"));
    std::vector<std::int32_t> of_points;
    const std::size_t begin = ply.find("end_header\n") + 11, stride = (ply.size() - begin) / 6;
    for (std::size_t i = 0; i < 6; ++i)  // the last value of a point
        of_points.push_back(read_at<std::int32_t>(ply, begin + (i + 1) * stride - sizeof(std::int32_t)));
    EXPECT_EQ(of_points, (std::vector<std::int32_t>{1, 5, 2, 0, 0, 7}))
        << "second returns behind their first";
    scan.channels[0].second = std::vector<std::int32_t>{5};
    EXPECT_THROW(scans.write_scan(1, scan), DataError) << "of another length";
    scan.channels[0].second = std::vector<float>{5, -1, -1, 7};
    EXPECT_THROW(scans.write_scan(1, scan), DataError) << "of another type";
}

// A clockwise head hits the left part behind the sensor at the start of the sweep, and
// the right part at the end, 0.8 m later.
TEST(ActorBoxes, ABoxBehindTheSensorHasTheTimeOfItsLargerPart) {
    constexpr double kSpeed_mps = 8.0;
    const auto get_front_m = [](double t_s) { return -10.0 + kSpeed_mps * t_s; };
    RenderedScan scan;
    scan.actor_views = {{"car", 40, 40}};
    for (int i = 0; i < 720; ++i) {
        const double azimuth = kPi - (i + 0.5) * 2.0 * kPi / 720, t_s = -azimuth / (2.0 * kPi) * 0.1,
                     range_m = get_front_m(t_s) / std::cos(azimuth), y_m = range_m * std::sin(azimuth);
        // The centre of the box is at y = 0.3 m, but its left part is hidden.
        const bool is_hit = std::cos(azimuth) < 0.0 && y_m > -0.7 && y_m < 0.2;
        scan.image.direction.emplace_back(std::cos(azimuth), std::sin(azimuth), 0.0);
        scan.image.range_m.push_back(is_hit ? float(range_m) : 0.0f);
        scan.image.drop_prob.push_back(is_hit ? 0.0f : 1.0f);
        scan.instance.push_back(is_hit);
        scan.time_offset_s.push_back(float(t_s));
    }
    scan = test::complete(std::move(scan));
    ScanOutputOptions format;
    format.instance_names = {"background", "car"};
    format.actors = {{"car", "Car", {4.0, 2.0, 1.5}, {{-1.0, 1.0}, {}}}};
    for (const double t_s : {-1.0, 1.0})
        format.actors[0].world_from_box.pose.push_back({{1, 0, 0, 0}, {get_front_m(t_s) - 2.0, 0.3, 0.0}});
    const std::vector<ActorBox> boxes = actor_boxes_of(scan, format);
    ASSERT_EQ(boxes.size(), 1u);
    EXPECT_NEAR(boxes[0].time_s, 0.05, 0.002);
    EXPECT_NEAR(boxes[0].dataset_from_box.translation.x, get_front_m(boxes[0].time_s) - 2.0, 1e-9);
}

/// Points at 8, 9 and 30 m on the x axis. The box from 8 to 12 m has a margin of 0.1 m,
/// and its lowest 0.15 m belong to the ground.
TEST(ActorBoxes, AStandingObjectHasThePointsOfTheBackgroundInItsBox) {
    RenderedScan scan;
    const auto add_ray = [&](const glm::vec3& origin_m, float range_m, int instance) {
        scan.image.origin.push_back(origin_m);
        scan.image.direction.emplace_back(1.0f, 0.0f, 0.0f);
        scan.image.range_m.push_back(range_m);
        scan.instance.push_back(instance);
    };
    add_ray({0.0f, 0.0f, 0.0f}, 8.0f, 0);
    add_ray({0.0f, 1.05f, 0.0f}, 7.95f, 0);  // in the margin
    add_ray({0.0f, 0.0f, 0.0f}, 9.0f, 1);    // on the actor
    add_ray({0.0f, 0.0f, 0.0f}, 30.0f, 0);   // behind the box
    add_ray({0.0f, 0.0f, -0.7f}, 9.0f, 0);   // on the ground
    scan = test::complete(std::move(scan));
    scan.world_from_sensor.translation = {100.0, 0.0, 0.0};
    ScanOutputOptions format;
    format.world_offset_m = {100.0, 0.0, 0.0};
    format.instance_names = {"background", "car"};
    const auto make_box = [](const char* id, double x_m) {
        return BoxTrack{id, "Car", {4.0, 2.0, 1.5}, {{0.0}, {{{1, 0, 0, 0}, {x_m, 0.0, 0.0}}}}};
    };
    format.standing = {make_box("parked", 10.0)};
    EXPECT_TRUE(actor_boxes_of(scan, format).empty()) << "rays were not counted";
    scan.actor_views = {{"parked", 2, 8}};
    std::vector<ActorBox> boxes = actor_boxes_of(scan, format);
    ASSERT_EQ(boxes.size(), 1u);
    EXPECT_EQ(boxes[0].n_points, 2u);
    EXPECT_EQ(boxes[0].visible_share, 0.25);
    EXPECT_TRUE(boxes[0].is_static);
    EXPECT_EQ(boxes[0].note, LabelNote::none);
    EXPECT_EQ(boxes[0].dataset_from_box.translation.x, 110.0);
    // An actor whose box overlaps by 0.2 m only touches the object; here by 0.3 m.
    format.actors = {make_box("car", 13.7)};
    scan.actor_views.push_back({"car", 1, 1});
    EXPECT_EQ(actor_boxes_of(scan, format)[1].note, LabelNote::covered);
    format.actors[0] = make_box("car", 13.9);
    scan.actor_views[0] = {"parked", 0, 0};
    EXPECT_EQ(actor_boxes_of(scan, format)[1].note, LabelNote::not_observed);
}

// Each actor appears once per sweep of a rig, at the time of the first ray of all
// sensors.
TEST(ActorBoxes, ASweepOfARigHasOneMessageWithAllActors) {
    ScanOutputOptions left, right;
    name_topics(left, "left");
    name_topics(right, "right");
    left.instance_names = {"background", "car"};
    left.actors = {{"car", "Car", {4.0, 2.0, 1.5}, {{0.0, 2.0}, {Pose{}, Pose{}}}}};
    right.actors = left.actors;
    std::vector<RenderedScan> scans;
    for (const float first_s : {-0.04f, -0.02f}) {
        RenderedScan scan;
        scan.image = {1, 1, {10.0f}, {0.5f}, {0.0f}, {}, {glm::vec3(1.0f, 0.0f, 0.0f)}};
        scan.instance = {1};
        scan.time_offset_s = {first_s};
        scan.ring = {0};
        scan.time_s = 1.0;
        scans.push_back(test::complete(std::move(scan)));
    }
    ScanMessageEncoder encoder({left, right});
    std::size_t n_messages = 0;
    for (const ScanMessage& message : encoder.encode(scans))
        n_messages += encoder.list_topics()[message.topic].name == "/actors";
    EXPECT_EQ(n_messages, 1u);
}

}  // namespace
}  // namespace relidar
