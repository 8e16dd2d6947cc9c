// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/sensor_files.hpp>
#include <relidar/log/sensor_pattern.hpp>

#include "support/sensor_texts.hpp"

namespace relidar {
namespace {

using test::expect_message;
using test::message;
using test::Names;
using test::write;

SpinningSensor spinning(const std::string& name) {
    return std::get<SpinningSensor>(find_sensor(name).pattern);
}

TEST(KnownSensors, EveryNameMakesRaysHighestBeamFirst) {
    for (const std::string& name : list_sensors()) {
        const SensorModel model = find_sensor(name);
        EXPECT_EQ(model.name, name);
        EXPECT_FALSE(model.about.empty()) << name << " does not say where its figures are from";
        const RayTable rays = make_rays(model);
        EXPECT_EQ(rays.size(), std::size_t(rays.rows) * std::size_t(rays.columns)) << name;
        for (const glm::vec3& d : rays.direction) ASSERT_NEAR(glm::length(d), 1.0f, 1e-6f) << name;
        const auto* sensor = std::get_if<SpinningSensor>(&model.pattern);
        for (std::size_t b = 1; sensor && b < sensor->beams.size(); ++b)
            EXPECT_LT(sensor->beams[b].elevation_rad, sensor->beams[b - 1].elevation_rad) << name << " " << b;
    }
    EXPECT_NEAR(spinning("VLP-16").beams[15].elevation_rad, -15 * kPi / 180, 1e-12);
    EXPECT_EQ(make_rays(find_sensor("kitti360")).direction, make_rays(kitti360_grid()).direction);
}

/// Manual 63-9243 adds a vertical offset to the height of each laser. All lasers
/// therefore cross 41.9 mm before the axis.
TEST(KnownSensors, Vlp16HasTheVerticalOffsetsOfItsManual) {
    const std::vector<Beam> beams = spinning("VLP-16").beams;
    const std::vector<double> offsets_mm = {-11.2, -9.7, -8.1, -6.6, -5.1, -3.7, -2.2, -0.7,
                                            0.7,   2.2,  3.7,  5.1,  6.6,  8.1,  9.7,  11.2};
    ASSERT_EQ(beams.size(), offsets_mm.size());
    for (std::size_t b = 0; b < beams.size(); ++b)
        for (const double azimuth_rad : {0.0, 1.0, 4.0}) {
            const BeamRay ray = aim_beam(beams[b], azimuth_rad);
            // The firing time turns a beam by up to 2 mrad, which moves its origin.
            EXPECT_NEAR(glm::length(ray.origin_m - glm::dvec3(0.0, 0.0, 1e-3 * offsets_mm[b])), 0.0, 1e-5);
            const double lens_m = 0.0419 / std::cos(beams[b].elevation_rad);
            EXPECT_NEAR((ray.origin_m + lens_m * ray.direction).z, 0.0, 1e-4);
        }
}

TEST(KnownSensors, SpecifiedRangesAreThoseOfTheProduct) {
    EXPECT_EQ(nominal_max_range_m("HDL-64E fitted to KITTI odometry 04"), 120.0);
    EXPECT_EQ(nominal_max_range_m("VLP-16"), 100.0);
    EXPECT_FALSE(nominal_max_range_m("/lidar_top"));
}

TEST(KnownSensors, Pandar128LooksAsItsDataSheetSays) {
    const SpinningSensor sensor = spinning("Pandar128");
    ASSERT_EQ(sensor.beams.size(), 128u);
    EXPECT_NEAR((sensor.beams.front().elevation_rad - sensor.beams.back().elevation_rad) * 180 / kPi, 40.0,
                0.6);
    int fine = 0;  // beams 26 to 90 are an eighth of a degree apart
    for (std::size_t b = 1; b < 128; ++b)
        fine += std::abs((sensor.beams[b - 1].elevation_rad - sensor.beams[b].elevation_rad) * 180 / kPi -
                         0.125) < 0.015;
    EXPECT_EQ(fine, 64);
    EXPECT_LT(sensor.beams[0].azimuth_offset_rad, 0.0)
        << "the maker counts azimuths clockwise: 3.257 is to the right";
}

TEST(KnownSensors, At128SweepsAWindowFromLeftToRight) {
    const SensorModel model = find_sensor("AT128");
    const RayTable rays = make_rays(model);
    ASSERT_EQ(rays.rows, 128);
    ASSERT_EQ(rays.columns, 1200);
    const auto azimuth_deg = [&](std::size_t ray) {
        return std::atan2(rays.direction[ray].y, rays.direction[ray].x) * 180 / kPi;
    };
    const auto elevation_deg = [&](std::size_t ray) { return std::asin(rays.direction[ray].z) * 180 / kPi; };
    EXPECT_NEAR(elevation_deg(0) - elevation_deg(127 * 1200), 25.4, 1e-4);
    for (const std::size_t row : {0u, 1u, 16u, 17u, 127u}) {
        const std::size_t first = row * 1200, last = first + 1199;
        EXPECT_NEAR(azimuth_deg(first) - azimuth_deg(last), 119.9, 1e-4) << row;
        EXPECT_NEAR(azimuth_deg(first) - azimuth_deg(first + 1), 0.1, 1e-4) << row;
        EXPECT_NEAR(rays.time_offset_s[last] - rays.time_offset_s[first], 0.1 * 1199 / 1200, 1e-7) << row;
    }
    EXPECT_NEAR(azimuth_deg(0), 59.95 - 2.4, 1e-4)
        << "the maker counts azimuths clockwise: 2.4 is to the right";
    EXPECT_NEAR(azimuth_deg(1200), 59.95 + 0.65, 1e-4);
    EXPECT_THROW(find_sensor("AT128:600x10"), UsageError);
}

TEST(KnownSensors, UnknownNameNamesTheNearestAndTheCsvWay) {
    EXPECT_EQ(find_sensor("vlp-16").name, "VLP-16") << "in any case";
    EXPECT_EQ(spinning("KITTI360").columns, 1030);
    EXPECT_THAT(message("vlp16"), testing::AllOf(Names("'VLP-16'"), Names("beams.csv")));
    EXPECT_THROW(find_sensor("vlp16"), UsageError);
}

TEST(KnownSensors, CsvTableByHeaderName) {
    const std::string path = write(
        "beams.csv", "channel,azimuth_offset_deg,elevation_deg,origin_up_m\n0,1.5,10,0.2\n1,-1.5,-10,0.1\n");
    const SpinningSensor sensor = spinning(path + ":512x20");
    ASSERT_EQ(sensor.beams.size(), 2u);
    EXPECT_EQ(sensor.columns, 512);
    EXPECT_DOUBLE_EQ(sensor.period_s, 0.05);
    EXPECT_NEAR(sensor.beams[0].elevation_rad, 10 * kPi / 180, 1e-12);
    EXPECT_NEAR(sensor.beams[1].azimuth_offset_rad, -1.5 * kPi / 180, 1e-12);
    EXPECT_DOUBLE_EQ(sensor.beams[1].origin_up_m, 0.1);
    EXPECT_DOUBLE_EQ(sensor.beams[1].origin_left_m, 0.0);
    EXPECT_EQ(spinning(path).columns, 1800);
}

TEST(KnownSensors, CsvTableHoldsRangeLimits) {
    const SpinningSensor limited =
        spinning(write("near.csv", "elevation_deg,max_range_m,min_range_m\n5,30,0.5\n-5,30,0.5\n"));
    EXPECT_DOUBLE_EQ(limited.min_range_m, 0.5);
    EXPECT_DOUBLE_EQ(limited.max_range_m, 30.0);
    EXPECT_DOUBLE_EQ(spinning(write("plain.csv", "elevation_deg\n5\n")).max_range_m, 80.0);
}

TEST(KnownSensors, SizesThatNoSensorHasAreRefused) {
    const std::string path = write("l.csv", "elevation_deg\n1\n");
    EXPECT_THAT(message(path + ":99999999x10"), Names("99999999 ... 10 Hz ... 1000000"));
    std::string many = "elevation_deg\n";
    for (int i = 0; i < 17; ++i) many += "1\n";
    const SpinningSensor large = spinning(write("m.csv", many) + ":1000000x10");
    EXPECT_THROW(make_rays(large), UsageError);
}

TEST(KnownSensors, WrongTablesAreNamed) {
    EXPECT_THAT(message("/nowhere/beams.csv"), Names("/nowhere/beams.csv"));
    for (const auto& [text, names] : std::vector<std::pair<const char*, const char*>>{
             {"channel\n1\n", "a.csv ... column 'elevation_deg'"},
             {"elevation_deg\n1\nabc\n", "a.csv line 3: elevation_deg ... 'abc'"},
             {"elevation_deg\nnan\n", "'nan'"},
             {"elevation_deg\n1\n2\n", "lowest"},
             {"elevation_deg,channel\n1\n", "1 ... 2"},
             {"elevation_deg\n", "beams"},
             {"elevation_deg,max_range_m\n5,30\n-5,40\n", "line 3 ... 40 m ... 30 m"},
             {"elevation_deg,min_range_m,max_range_m\n5,30,30\n", "min_range_m below max_range_m"},
             {"elevation_deg,max_range_m\n5,-1\n", "max_range_m ... '-1' ... [0, 10000]"},
             {"elevation_deg,azimuth_ofset_deg\n5,1\n",
              "a.csv line 1 ... 'azimuth_ofset_deg' ... 'azimuth_offset_deg'"},
             {"elevation_deg,elevation_deg\n5,1\n", "'elevation_deg' ... twice"}})
        expect_message("a.csv", text, names);
    EXPECT_THAT(message(write("f.csv", "elevation_deg\n1\n") + ":0"), Names("1000000 columns"));
}

}  // namespace
}  // namespace relidar
