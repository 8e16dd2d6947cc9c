// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/sensor_files.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include <cmath>

#include <relidar/base/arrays.hpp>

#include "support/sensor_texts.hpp"

namespace relidar {
namespace {

using test::expect_message;
using test::message;
using test::Names;
using test::path_of;
using test::write;

void expect_rays(const RayTable& rays, const std::vector<glm::dvec3>& directions,
                 const std::vector<glm::dvec3>& origins) {
    ASSERT_EQ(rays.size(), directions.size());
    for (std::size_t i = 0; i < rays.size(); ++i) {
        EXPECT_LT(glm::length(glm::dvec3(rays.direction[i]) - directions[i]), 1e-6) << i;
        EXPECT_LT(glm::length(glm::dvec3(rays.origin[i]) - origins[i]), 1e-6) << i;
    }
}

TEST(SensorFiles, RayTablesSayTheSameInEveryFormat) {
    const std::vector<glm::dvec3> directions{
        {1, 0, 0}, {0, 1, 0}, {std::sqrt(0.5), 0, std::sqrt(0.5)}, {0, -1, 0}};
    const std::vector<glm::dvec3> origins{{0, 0, 0}, {0, 0.1, 0}, {0, 0, 0.2}, {0.3, 0, 0}};
    const std::string csv = write("rays.csv",
                                  "azimuth_deg,elevation_deg,origin_x_m,origin_y_m,origin_z_m,time_s,channel,"
                                  "divergence_mrad,max_range_m\n"
                                  "0,0,0,0,0,-0.01,3,2,50\n90,0,0,0.1,0,0,2,2,50\n0,45,0,0,0.2,0.01,1,2,50\n-"
                                  "90,0,0.3,0,0,0.02,0,2,50\n");
    const std::string json =
        write("rays.json",
              R"({"directions": [[[1,0,0],[0,1,0]],[[0.70710678118,0,0.70710678118],[0,-1,0]]],
                                       "origin": [[0,0,0],[0,0.1,0],[0,0,0.2],[0.3,0,0]], "time": [-0.01,0,0.01,0.02], "ring": [3,2,1,0],
                                       "divergence_mrad": 2, "max_range_m": 50})");
    std::vector<float> d, o;
    for (const glm::dvec3& v : directions) d.insert(d.end(), {float(v.x), float(v.y), float(v.z)});
    for (const glm::dvec3& v : origins) o.insert(o.end(), {float(v.x), float(v.y), float(v.z)});
    const std::vector<float> time{-0.01f, 0.0f, 0.01f, 0.02f}, divergence{2.0f}, farthest{50.0f};
    const std::vector<std::uint16_t> ring{3, 2, 1, 0};
    write_npz(
        path_of("rays.npz"),
        {make_array("directions", {2, 2, 3}, d.data(), d.size()),
         make_array("origin", {2, 2, 3}, o.data(), o.size()), make_array("time", {2, 2}, time.data(), 4),
         make_array("ring", {2, 2}, ring.data(), 4), make_array("divergence_mrad", {1}, divergence.data(), 1),
         make_array("max_range_m", {1}, farthest.data(), 1)});
    for (const std::string& file : {csv, json, path_of("rays.npz")}) {
        const SensorModel sensor = find_sensor(file);
        const RayTable rays = make_rays(sensor);
        expect_rays(rays, directions, origins);
        EXPECT_EQ(rays.rows, file == csv ? 1 : 2) << file;
        EXPECT_EQ(to_vector(rays.time_offset_s), time) << file;
        EXPECT_EQ(to_vector(rays.channel), ring) << file;
        EXPECT_FLOAT_EQ(rays.divergence_rad, 2e-3f) << file;
        EXPECT_EQ(sensor.limits.max_m, 50.0) << file;
    }
}

TEST(SensorFiles, BeamsMayDivergeEachByItself) {
    const std::string csv =
        write("cones.csv", "azimuth_deg,elevation_deg,divergence_mrad\n0,0,2\n90,0,0\n0,90,0.5\n");
    const std::string json =
        write("cones.json", R"({"directions": [[1,0,0],[0,1,0],[0,0,1]], "divergence": [0.002, 0, 0.0005]})");
    const std::vector<float> d{1, 0, 0, 0, 1, 0, 0, 0, 1}, divergence{2e-3f, 0.0f, 5e-4f},
        same{2e-3f, 2e-3f, 2e-3f};
    const auto npz = [&](const char* name, const std::vector<float>& angles) {
        write_npz(path_of(name),
                  {make_array("directions", {1, 3, 3}, d.data(), d.size()),
                   make_array("divergence", {1, angles.size()}, angles.data(), angles.size())});
        return path_of(name);
    };
    for (const std::string& file : {csv, json, npz("cones.npz", divergence)}) {
        const RayTable rays = make_rays(find_sensor(file));
        ASSERT_EQ(rays.ray_divergence_rad.size(), 3u) << file;
        for (std::size_t i = 0; i < 3; ++i) {
            EXPECT_FLOAT_EQ(rays.ray_divergence_rad[i], divergence[i]) << file << " " << i;
            EXPECT_EQ(rays.divergence_of_rad(i), double(rays.ray_divergence_rad[i]));
        }
        EXPECT_FLOAT_EQ(float(rays.max_divergence_rad()), 2e-3f);
    }
    const RayTable alike = make_rays(find_sensor(npz("alike.npz", same)));
    EXPECT_TRUE(alike.ray_divergence_rad.empty()) << "one number where all have the same";
    EXPECT_EQ(alike.divergence_rad, 2e-3f);

    const auto bad = [](const std::string& file, const std::string& why) {
        EXPECT_THAT(message(file), Names(why));
    };
    expect_message("a.csv", "azimuth_deg,elevation_deg,divergence_mrad\n0,0,2\n90,0,-1\n",
                   "entry 1 ... divergence ... -0.001");
    expect_message("b.csv", "azimuth_deg,elevation_deg,divergence_mrad\n0,0,2\n90,0,nan\n",
                   "line 3: divergence_mrad ... 'nan'");
    bad(npz("c.npz", {2e-3f, std::nanf(""), 0.0f}), "entry 1 ... divergence ... nan");
    bad(npz("d.npz", {2e-3f, -1e-3f, 0.0f}), "entry 1 ... divergence ... -0.001");
    bad(npz("e.npz", {2e-3f, 1e-3f}), "divergence ... 2 ... 3");
    expect_message("f.json", R"({"directions": [[1,0,0]], "divergence": [0.002], "divergence_mrad": 2})",
                   "both");
}

/// Equation of Ouster's manual without the sensor's height. The range starts at the axis.
/// @param m column, of w columns
glm::dvec3 compute_ouster_point(double range_m, double offset_m, double altitude_deg, double azimuth_deg,
                                int m, int w) {
    const double encoder = 2.0 * kPi * (1.0 - double(m) / w), azimuth = -azimuth_deg * kPi / 180.0,
                 altitude = altitude_deg * kPi / 180.0;
    const double r = range_m - offset_m;
    const glm::dvec3 lidar(
        r * std::cos(encoder + azimuth) * std::cos(altitude) + offset_m * std::cos(encoder),
        r * std::sin(encoder + azimuth) * std::cos(altitude) + offset_m * std::sin(encoder),
        r * std::sin(altitude));
    return {-lidar.x, -lidar.y, lidar.z};
}

TEST(SensorFiles, OustersMetadataMakesOustersPoints) {
    const double altitude[] = {20.5, 0.25, -19.0}, azimuth[] = {-4.2, 1.4, 3.9}, offset_m = 0.015806;
    const std::string angles =
        R"("beam_altitude_angles": [20.5, 0.25, -19.0], "beam_azimuth_angles": [-4.2, 1.4, 3.9],
                                  "lidar_origin_to_beam_origin_mm": 15.806)";
    const std::string old =
        write("old.json", "{\"lidar_mode\": \"512x20\", \"prod_line\": \"OS-1-128\", " + angles + "}");
    const std::string nested = write("new.json",
                                     "{\"config_params\": {\"lidar_mode\": \"512x20\"}, \"sensor_info\": "
                                     "{\"prod_line\": \"OS-1-128\"},\"beam_intrinsics\": {" +
                                         angles + "}}");
    for (const std::string& file : {old, nested}) {
        const auto spinning = std::get<SpinningSensor>(find_sensor(file).pattern);
        ASSERT_EQ(spinning.columns, 512);
        EXPECT_DOUBLE_EQ(spinning.period_s, 0.05);
        EXPECT_DOUBLE_EQ(spinning.max_range_m, 120.0);
        for (int beam = 0; beam < 3; ++beam)
            for (const int m : {0, 1, 100, 511}) {
                const double head = spinning.first_azimuth_rad - 2.0 * kPi * m / 512.0;
                const BeamRay ray = aim_beam(spinning.beams[std::size_t(beam)], head);
                const glm::dvec3 expected =
                    compute_ouster_point(30.0, offset_m, altitude[beam], azimuth[beam], m, 512);
                EXPECT_LT(glm::length(ray.origin_m + (30.0 - offset_m) * ray.direction - expected), 1e-9)
                    << beam << " " << m;
            }
    }
    EXPECT_EQ(std::get<SpinningSensor>(find_sensor(old + ":1024x10").pattern).columns, 1024);
}

TEST(SensorFiles, ByteOrderMarksAreAccepted) {
    const std::string mark = "\xEF\xBB\xBF";
    EXPECT_EQ(make_rays(find_sensor(write("mark.csv", mark + "azimuth_deg,elevation_deg\r\n0,0\r\n"))).size(),
              1u);
    EXPECT_EQ(
        make_rays(find_sensor(write("mark_beams.csv", mark + "elevation_deg\n5\n-5\n") + ":360x10")).size(),
        720u);
    EXPECT_EQ(make_rays(find_sensor(write("mark.json", mark + R"({"directions": [[1,0,0]]})"))).size(), 1u);
    EXPECT_EQ(
        read_sensor_rig(write("mark_rig.json", mark + R"({"sensors": [{"name": "a", "sensor": "VLP-16"}]})"))
            .value()
            .size(),
        1u);
}

TEST(SensorFiles, SpinningSensorsByNameTakeColumnsAndRate) {
    const auto usual = std::get<SpinningSensor>(find_sensor("VLP-16").pattern),
               fast = std::get<SpinningSensor>(find_sensor("vlp-16:904x20").pattern);
    EXPECT_EQ(fast.columns, 904);
    EXPECT_DOUBLE_EQ(fast.period_s, 0.05);
    // The top beam fires 34.56 us after the sensor was at the azimuth of the firing. At
    // 20 Hz, the sensor turns by twice the angle in this time.
    EXPECT_NEAR(usual.beams[0].azimuth_offset_rad, -2.0 * kPi * 10.0 * 34.56e-6, 1e-9);
    EXPECT_NEAR(fast.beams[0].azimuth_offset_rad, -2.0 * kPi * 20.0 * 34.56e-6, 1e-9);
    EXPECT_THAT(message("rosette:100x10"), Names("spin"));
}

TEST(SensorFiles, WrongFilesAreNamed) {
    EXPECT_THAT(message(path_of("missing.npz")), Names("missing.npz"));
    expect_message("a.csv", "azimuth_deg,elevation_deg\n0,nan\n", "a.csv line 2: elevation_deg ... 'nan'");
    expect_message("b.csv", "azimuth_deg,elevation_deg\n", "b.csv ... 0 rays");
    expect_message("c.csv", "azimuth_deg,elevation_deg,wavelength\n1,1,905\n",
                   "column 'wavelength' ... unknown");
    expect_message("d.csv", "azimuth_deg,elevation_deg,max_range_m\n1,1,50\n1,1,60\n",
                   "d.csv line 3: max_range_m ... 60 ... 50");
    expect_message("e.csv", "azimuth_deg,time_s\n1,1\n", "azimuth_deg ... elevation_deg");
    expect_message("a.json", "{\"directions\": [[1,0,0],[0,2,0]]}", "entry 1 ... directions ... 2 ... 1");
    expect_message("n.json", R"({"directions": [[1,0,0]], "times": [0]})", "'times' ... time");
    expect_message("o.json", R"({"window": {}, "max_range_m": 50})", "'max_range_m' ... window");
    expect_message("b.json", "{\"directions\": [[1,0,0]], \"time\": [1,2]}", "time ... 2 ... 1");
    expect_message("c.json", "{\"directions\": [[1,0,\"x\"]]}", "string");
    EXPECT_THAT(message(write("d.json", "{\"directions\": " + std::string(50'000, '[') +
                                            std::string(50'000, ']') + "}")),
                Names("nested"));
    expect_message("e.json", "[1,", "e.json ... JSON");
    expect_message(
        "f.json", "{}",
        "\"spinning\", \"window\", \"rosette\", \"rays\", \"directions\" ... \"beam_altitude_angles\"");
    expect_message("g.json",
                   R"({"beam_altitude_angles": [1], "beam_azimuth_angles": [1,2], "lidar_mode": "512x10"})",
                   "1 beam_altitude_angles ... 2 beam_azimuth_angles");
    expect_message("h.json",
                   R"({"beam_altitude_angles": [1], "beam_azimuth_angles": [1], "lidar_mode": "fast"})",
                   "lidar_mode ... \"fast\"");
    expect_message("i.json", R"({"directions": [[1,0,0]], "time": [1e300]})", "entry 0 ... time ... 1e+300");
    write_npz(path_of("a.npz"), {single_text("name", "x")});
    EXPECT_THAT(message(path_of("a.npz")), Names("array \"directions\" ... missing"));
}

TEST(SensorFiles, WhatSweepsIsDescribedInAFewNumbers) {
    const SensorModel front = find_sensor(
        write("front.json", R"({"window": {"rows": 3, "columns": 5, "left_deg": 40, "right_deg": -40,
        "top_deg": 10, "bottom_deg": -10, "period_s": 0.05, "divergence_mrad": 2, "min_range_m": 1, "max_range_m": 90}})"));
    const RayTable window = make_rays(front);
    EXPECT_EQ(std::pair(window.rows, window.columns), std::pair(3, 5));
    EXPECT_EQ(front.limits.max_m, 90.0);
    EXPECT_FLOAT_EQ(window.divergence_rad, 2e-3f);
    const double d = kPi / 180.0;
    EXPECT_LT(glm::length(glm::dvec3(window.direction[0]) - glm::dvec3(std::cos(10 * d) * std::cos(40 * d),
                                                                       std::cos(10 * d) * std::sin(40 * d),
                                                                       std::sin(10 * d))),
              1e-7);
    EXPECT_NEAR(window.time_offset_s[0], -0.02, 1e-7) << "the middle of the first of five steps of 10 ms";
    const SensorModel flower =
        find_sensor(write("flower.json", R"({"rosette": {"rays": 100, "deflection_deg": 9, "first_hz": 3,
        "second_hz": -2}})"));
    EXPECT_EQ(make_rays(flower).size(), 100u);
    EXPECT_NE(make_rays(flower, 0.0).direction, make_rays(flower, 0.1).direction);
    EXPECT_EQ(flower.limits.max_m, 80.0);
    expect_message("j.json", R"({"window": {"rows": 3}})", "window.columns ... missing");
    expect_message("k.json", R"({"rosette": {"rays": 5, "petals": 3}})", "'petals'");
    expect_message(
        "l.json", R"({"window": {"rows": 60000, "columns": 60000, "left_deg": 1, "right_deg": 0, "top_deg": 1,
        "bottom_deg": 0}})",
        "60000 ... 60000");
    expect_message("m.json", R"({"rosette": {"rays": 5, "deflection_deg": 3, "first_hz": 1, "second_hz": 1,
        "min_range_m": 90}})",
                   "min_range_m < max_range_m");
}

TEST(Rigs, SensorsAreMountedAsTheFileSays) {
    write("near.csv", "elevation_deg\n5\n-5\n");
    const std::string file = write("rig.json", R"({"sensors": [{"name": "top", "sensor": "VLP-16:900x20"},
        {"name": "left", "sensor": "near.csv:360x10", "returns": 2, "translation_m": [1, 2, 3], "yaw_pitch_roll_deg": [90, 0, 180]}]})");
    EXPECT_FALSE(read_sensor_rig(write("no_rig.json", "{}")));
    EXPECT_FALSE(read_sensor_rig(write("broken.json", "{")));
    EXPECT_FALSE(read_sensor_rig("VLP-16"));
    const std::vector<MountedSensor> rig = read_sensor_rig(file).value();
    ASSERT_EQ(rig.size(), 2u);
    EXPECT_EQ(rig[0].name, "top");
    EXPECT_EQ(std::pair(rig[0].returns, rig[1].returns), std::pair(1, 2));
    EXPECT_EQ(make_rays(rig[0].sensor).columns, 900);
    EXPECT_EQ(make_rays(rig[1].sensor).size(), 720u) << "a file beside the rig's";
    // The sensor is first rolled about x, then turned left. Its up axis becomes down, and
    // its forward axis becomes left.
    EXPECT_LT(glm::length(rig[1].rig_from_sensor * glm::dvec3(1, 0, 0) - glm::dvec3(1, 3, 3)), 1e-12);
    EXPECT_LT(glm::length(rig[1].rig_from_sensor * glm::dvec3(0, 0, 1) - glm::dvec3(1, 2, 2)), 1e-12);
}

TEST(Rigs, TheVehicleBlocksRays) {
    const auto rig = [](const std::string& vehicle) {
        return write("vehicle_rig.json",
                     R"({"sensors": [{"name": "roof", "sensor": "VLP-16", "translation_m": [0.5, 0, 0],
            "yaw_pitch_roll_deg": [90, 0, 0]}], "vehicle": )" +
                         vehicle + "}");
    };
    const std::string size =
        R"({"length_m": 4.5, "width_m": 1.8, "height_m": 1.4, "rear_axle_to_front_m": 3.5)";
    // The rear axle is 1 m behind the rig and 2 m below: the box is 3.5 m ahead of the
    // axle and 1 m behind it, and reaches from the ground to 1.4 m.
    const std::string file = rig(size + R"(, "base_link_m": [-1, 0, -2], "points": "ego"})");
    const OwnVehicle vehicle = read_rig_vehicle(file).value();
    EXPECT_TRUE(vehicle.keeps_points);
    ASSERT_EQ(vehicle.boxes.size(), 1u);
    EXPECT_LT(glm::distance(vehicle.rig_from_base_link * vehicle.boxes[0].frame_from_box.translation,
                            glm::dvec3(0.25, 0.0, -1.3)),
              1e-12);
    // The sensor is at x = 0.5 and looks to the left.
    const VehicleBody body = read_sensor_rig(file).value()[0].body;
    ASSERT_EQ(body.boxes.size(), 1u);
    EXPECT_LT(glm::distance(body.boxes[0].frame_from_box.translation, glm::dvec3(0.0, 0.25, -1.3)), 1e-12);
    const std::string boxes = R"(, "boxes": [{"centre_m": [1, 0, 1], "size_m": [1, 2, 0.5]},
        {"centre_m": [2, 0, 1], "size_m": [1, 1, 1]}]})";
    EXPECT_EQ(read_rig_vehicle(rig(size + boxes)).value().boxes.at(0).size_m, glm::dvec3(1, 2, 0.5));
    EXPECT_FALSE(read_rig_vehicle("VLP-16"));
    EXPECT_TRUE(read_rig_vehicle(rig(R"("log")")).value().is_of_log);
    EXPECT_TRUE(read_sensor_rig(rig(R"("log")")).value()[0].body.empty());
    for (const auto& [text, parts] : std::vector<std::pair<std::string, const char*>>{
             {"3", "vehicle: ... 3"},
             {size + R"(, "hight_m": 2})", "'hight_m' ... 'height_m'"},
             {R"({"length_m": 4.5})", "width_m"},
             {size + R"(, "points": "all"})", "points: ... \"all\""},
             {size + R"(, "boxes": []})", "boxes"},
             {size + R"(, "boxes": [{"centre_m": [0, 0, 0]}]})", "boxes[0].size_m"}})
        EXPECT_THAT([&] { read_sensor_rig(rig(text)); }, testing::ThrowsMessage<Error>(Names(parts))) << text;
}

TEST(SensorFiles, FieldOfViewIsPartOfFilesAndNames) {
    const auto columns = [](const std::string& name) { return make_rays(find_sensor(name)).columns; };
    // 1 degree per column: columns are at half degrees, 60 of them from 59.5 to 0.5
    EXPECT_EQ(columns("VLP-16:360x10:60..0"), 60);
    EXPECT_EQ(columns("VLP-16:360x10:0..60"), 300);
    EXPECT_EQ(2 * columns("VLP-16:90..-90"), columns("VLP-16"));
    const std::string beams = write("view.csv", "elevation_deg\n5\n-5\n");
    EXPECT_EQ(columns(beams + ":360x10:60..0"), 60);
    EXPECT_EQ(columns(write("view.json", R"({"spinning": {"columns": 360, "beams": [{"elevation_deg": 1}],
        "azimuth_deg": [60, 0]}})")),
              60);
    expect_message("x.json",
                   R"({"spinning": {"columns": 360, "beams": [{"elevation_deg": 1}], "azimuth_deg": [60]}})",
                   "azimuth_deg ... 1 numbers");
    EXPECT_THROW((void)find_sensor("rosette:60..-60"), UsageError);
    EXPECT_THROW((void)find_sensor("VLP-16:60..60"), UsageError);
}

/// The JSON object of a sensor must define the same rays in a file, in a rig and as text.
TEST(SensorFiles, EveryKindReadsBackToTheSameBits) {
    RayTable cones = make_rays(*find_built_in("rosette"), 0.37);
    for (std::size_t i = 0; i < cones.size(); ++i) cones.ray_divergence_rad.push_back(1e-3f / float(i + 1));
    std::vector<SensorModel> sensors{
        {"cones", "", {0.5, 90.0}, cones},
        {"thirds",
         "",
         {1.0 / 3.0, 200.0 / 3.0},
         WindowScanSensor{"thirds", 4, 6, 1.0 / 3.0, -0.3, 0.1, -0.2, 1.0 / 30.0, 1e-3 / 3.0}}};
    for (const char* name :
         {"HDL-64E-KITTI:400x7", "VLP-16:400x10:70..-50", "kitti360", "AT128", "window-128", "rosette"})
        sensors.push_back(find_sensor(name));
    for (const SensorModel& sensor : sensors) {
        const std::string text = format_sensor_json(sensor);
        const std::vector<MountedSensor> rig =
            read_sensor_rig(write("inline.json", R"({"sensors": [{"name": "a", "sensor": )" + text + "}]}"))
                .value();
        for (const SensorModel& read : {find_sensor(write("any.json", text)), rig.at(0).sensor}) {
            EXPECT_EQ(read.name, sensor.name);
            EXPECT_EQ(read.pattern.index(), sensor.pattern.index());
            EXPECT_EQ(std::pair(read.limits.min_m, read.limits.max_m),
                      std::pair(sensor.limits.min_m, sensor.limits.max_m));
            const RayTable a = make_rays(read, 0.7), b = make_rays(sensor, 0.7);
            EXPECT_EQ(std::pair(a.rows, a.columns), std::pair(b.rows, b.columns)) << sensor.name;
            EXPECT_TRUE(a.origin == b.origin && a.direction == b.direction &&
                        a.time_offset_s == b.time_offset_s && a.channel == b.channel &&
                        a.divergence_rad == b.divergence_rad && a.ray_divergence_rad == b.ray_divergence_rad)
                << sensor.name;
            EXPECT_EQ(format_sensor_json(read), text);
            EXPECT_EQ(summarise_pattern(read.pattern).n_rays, b.size());
        }
    }
    expect_message("p.json", R"({"spinning": {"columns": 90}})", "beams");
    expect_message("q.json", R"({"window": {"rows": 1, "columns": 1, "left_deg": 1, "left_rad": 1}})",
                   "left_deg ... left_rad");
}

TEST(SensorFiles, RangeOfAFileThatGivesNoneIsTheCallers) {
    const std::vector<float> ahead{1.0f, 0.0f, 0.0f};
    write_npz(path_of("endless.npz"), {make_array("directions", {1, 3}, ahead.data(), ahead.size())});
    for (const std::string& file :
         {write("endless_beams.csv", "elevation_deg\n5\n-5\n"),
          write("endless_rays.csv", "azimuth_deg,elevation_deg\n0,0\n"),
          write("endless_rays.json", R"({"directions": [[1, 0, 0]]})"), path_of("endless.npz"),
          write("endless_window.json",
                R"({"window": {"rows": 2, "columns": 2, "left_deg": 40, "right_deg": -40, "top_deg": 10,
                                                         "bottom_deg": -10}})")}) {
        EXPECT_EQ(find_sensor(file).limits.max_m, kDefaultMaxRange_m) << file;
        const SensorModel sensor = find_sensor(file, {}, 250.0);
        EXPECT_EQ(sensor.limits.max_m, 250.0) << file;
        const auto* spinning = std::get_if<SpinningSensor>(&sensor.pattern);
        EXPECT_TRUE(!spinning || spinning->max_range_m == 250.0) << file;
    }
    expect_message("beyond.csv", "elevation_deg,min_range_m\n5,90\n", "min_range_m < max_range_m");
    EXPECT_EQ(find_sensor("VLP-16", {}, 250.0).limits.max_m, find_sensor("VLP-16").limits.max_m);
}

TEST(Rigs, WrongRigsAreNamed) {
    const auto expect_error = [](const std::string& text, const std::string& parts) {
        const std::string file = write("bad_rig.json", R"({"sensors": [)" + text);
        EXPECT_THAT([&] { read_sensor_rig(file); }, testing::ThrowsMessage<Error>(Names(parts)));
    };
    expect_error("]}", "sensors ... 1 ... 64");
    expect_error(R"({"sensor": "VLP-16"}]})", "sensors[0].name");
    expect_error(R"({"name": "../x", "sensor": "VLP-16"}]})", "name ... \"../x\"");
    expect_error(R"({"name": "a", "sensor": "VLP-16"}, {"name": "a", "sensor": "VLP-16"}]})",
                 "sensors[1].name ... \"a\" ... twice");
    expect_error(R"({"name": "a", "sensor": "VLP-16", "translation_m": [1, 2]}]})",
                 "sensors[0].translation_m ... 2 numbers ... 3");
    expect_error(R"({"name": "a", "sensor": "VLP-16", "translation": [1, 2, 0]}]})",
                 "sensors[0] ... 'translation' ... 'translation_m'");
    expect_error(R"({"name": "a", "sensor": "VLP-16"}], "yaw_pitch_roll_deg": [0, 0, 0]})",
                 "'yaw_pitch_roll_deg' ... sensors");
    expect_error(R"({"name": "a", "sensor": "VLP"}]})", "VLP-16");
    expect_error(R"({"name": "a", "sensor": "VLP-16", "returns": 3}]})", "sensors[0].returns ... 1 ... 2");
}

}  // namespace
}  // namespace relidar
