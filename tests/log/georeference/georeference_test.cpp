// SPDX-License-Identifier: Apache-2.0
// Compares positions on the earth with closed forms.
#include <relidar/log/georeference.hpp>

#include <cmath>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/base/math.hpp>

namespace relidar {
namespace {

constexpr double kDegree = kPi / 180.0;
const GeodeticPosition kKarlsruhe{49.015003823272, 8.4342971002335, 116.43};

/// Coordinates in EPSG:4978 with the axes of the WGS 84 ellipsoid.
glm::dvec3 geocentric(const GeodeticPosition& p) {
    constexpr double kRadius_m = 6378137.0, kFlattening = 1.0 / 298.257223563;
    const double e2 = kFlattening * (2.0 - kFlattening), latitude = kDegree * p.latitude_deg,
                 longitude = kDegree * p.longitude_deg,
                 n = kRadius_m / std::sqrt(1.0 - e2 * std::pow(std::sin(latitude), 2.0));
    return {(n + p.height_m) * std::cos(latitude) * std::cos(longitude),
            (n + p.height_m) * std::cos(latitude) * std::sin(longitude),
            (n * (1.0 - e2) + p.height_m) * std::sin(latitude)};
}

class Georeferences : public testing::Test {
    void SetUp() override {
        if (!has_proj()) GTEST_SKIP() << "built without PROJ";
    }
};

TEST_F(Georeferences, ConvertToMercatorAndBack) {
    // The projection of KITTI's development kit.
    constexpr double kRadius_m = 6378137.0;
    const Georeference place{kKarlsruhe, {10.0, 20.0, 30.0}, "+proj=merc +R=6378137 +lat_ts=49.015003823272"};
    const GeoConverter earth(place);
    const GeodeticPosition near{49.02, 8.44, 120.0};
    const auto mercator = [](const GeodeticPosition& p) {
        const double scale = std::cos(kDegree * kKarlsruhe.latitude_deg);
        return glm::dvec3(scale * kRadius_m * kDegree * p.longitude_deg,
                          scale * kRadius_m * std::log(std::tan(kPi / 4 + kDegree * p.latitude_deg / 2)),
                          p.height_m);
    };
    const glm::dvec3 expected = place.point_m + mercator(near) - mercator(kKarlsruhe);
    EXPECT_LT(glm::distance(earth.to_dataset(near), expected), 1e-6);
    const GeodeticPosition again = earth.to_geodetic(expected);
    EXPECT_NEAR(again.latitude_deg, near.latitude_deg, 1e-11);
    EXPECT_NEAR(again.longitude_deg, near.longitude_deg, 1e-11);
    EXPECT_NEAR(again.height_m, near.height_m, 1e-6);
}

TEST_F(Georeferences, RotateTheWorld) {
    const glm::dquat rotation = make_rotation(0.7, 0.0, 0.0);
    const GeoConverter earth({kKarlsruhe, {1.0, 2.0, 3.0}, local_tangent_crs(kKarlsruhe), rotation});
    const glm::dvec3 in_plane = rotation * (glm::dvec3(101.0, 2.0, 3.0) - glm::dvec3(1.0, 2.0, 3.0));
    const GeodeticPosition found = earth.to_geodetic({101.0, 2.0, 3.0});
    // East, north and up at Karlsruhe, along the axes of the earth.
    const double latitude = kDegree * kKarlsruhe.latitude_deg, longitude = kDegree * kKarlsruhe.longitude_deg;
    const glm::dvec3 east(-std::sin(longitude), std::cos(longitude), 0.0),
        up(std::cos(latitude) * std::cos(longitude), std::cos(latitude) * std::sin(longitude),
           std::sin(latitude)),
        north = glm::cross(up, east);
    const glm::dvec3 expected =
        geocentric(kKarlsruhe) + in_plane.x * east + in_plane.y * north + in_plane.z * up;
    EXPECT_LT(glm::distance(geocentric(found), expected), 1e-6);
    const glm::dquat enu = earth.dataset_from_enu(kKarlsruhe);
    EXPECT_LT(glm::distance(enu * glm::dvec3(1, 0, 0), glm::conjugate(rotation) * glm::dvec3(1, 0, 0)), 1e-6);
    EXPECT_LT(glm::distance(enu * glm::dvec3(0, 0, 1), glm::dvec3(0, 0, 1)), 1e-6);
    EXPECT_EQ(earth.wkt(), "");
}

TEST_F(Georeferences, KnowCodesOfEpsg) {
    // On the central meridian, the northing is 0.9996 times the length of the meridian:
    // 4984944.378 m from the equator to 45 degrees.
    const GeoConverter utm({{45.0, 9.0, 0.0}, {500000.0, 0.9996 * 4984944.378, 0.0}, "EPSG:32632"});
    EXPECT_LT(glm::distance(utm.to_dataset({0.0, 9.0, 5.0}), glm::dvec3(500000.0, 0.0, 5.0)), 2e-3);
    EXPECT_NE(utm.wkt().find("\"32632\""), std::string::npos);
    EXPECT_EQ(GeoConverter({{45.0, 9.0, 0.0}, {500000.0, 4.9e6, 0.0}, "EPSG:32632"}).wkt(), "")
        << "the world is shifted";
    EXPECT_THROW(GeoConverter({kKarlsruhe, {}, "EPSG:1"}), DataError);
    EXPECT_THROW(GeoConverter({kKarlsruhe, {}, "+proj=nonsense"}), DataError);
}

TEST_F(Georeferences, MustBeUprightRightHandedMapsInMetres) {
    const GeodeticPosition new_york{40.75, -73.9, 10.0}, prague{50.08, 14.42, 200.0}, oslo{60.0, 10.7, 20.0};
    const std::pair<GeodeticPosition, const char*> wrong[] = {
        {kKarlsruhe, "EPSG:4326"},                   // degrees
        {kKarlsruhe, "EPSG:4979"},                   // degrees
        {kKarlsruhe, "+proj=longlat +ellps=WGS84"},  // radians
        {kKarlsruhe, "EPSG:4978"},                   // geocentric: z points to the pole
        {new_york, "EPSG:2263"},                     // US survey feet
        {new_york, "+proj=utm +zone=18 +vunits=us-ft"},
        {prague, "EPSG:5513"},    // x south, y west
        {oslo, "EPSG:3857"},      // Mercator: lengths are doubled
        {new_york, "EPSG:32632"}  // 83 degrees from its meridian
    };
    for (const auto& [position, crs] : wrong)
        EXPECT_THROW(GeoConverter({position, {}, crs}), DataError) << crs;
    EXPECT_EQ(GeoConverter({new_york, {}, "EPSG:32118"}).scale_note(), "") << "EPSG:2263 in metres";
    EXPECT_EQ(GeoConverter({prague, {}, "EPSG:5514"}).scale_note(), "") << "x east, y north";
    EXPECT_EQ(GeoConverter({kKarlsruhe, {}, local_tangent_crs(kKarlsruhe)}).scale_note(), "");
    // 6378137 m / (cos(20 degrees) * 6342887 m), the radius of the meridian there
    EXPECT_NE(GeoConverter({{20.0, 0.0, 0.0}, {}, "EPSG:3857"}).scale_note().find("1.0701"),
              std::string::npos);
}

/// UTM coordinates by the series of Krueger, to the third order of the flattening.
glm::dvec2 project_utm(const GeodeticPosition& p, double meridian_deg) {
    constexpr double kFlattening = 1.0 / 298.257223563, n = kFlattening / (2.0 - kFlattening);
    const double radius_m = 6378137.0 / (1.0 + n) * (1.0 + n * n / 4.0 + n * n * n * n / 64.0),
                 alpha[] = {n / 2.0 - 2.0 * n * n / 3.0 + 5.0 * n * n * n / 16.0,
                            13.0 * n * n / 48.0 - 3.0 * n * n * n / 5.0, 61.0 * n * n * n / 240.0};
    const double sine = std::sin(kDegree * p.latitude_deg),
                 longitude = kDegree * (p.longitude_deg - meridian_deg), s = 2.0 * std::sqrt(n) / (1.0 + n),
                 t = std::sinh(std::atanh(sine) - s * std::atanh(s * sine)),
                 xi = std::atan2(t, std::cos(longitude)),
                 eta = std::atanh(std::sin(longitude) / std::sqrt(1.0 + t * t));
    glm::dvec2 east_north(eta, xi);
    for (int j = 1; j <= 3; ++j)
        east_north += alpha[j - 1] * glm::dvec2(std::cos(2 * j * xi) * std::sinh(2 * j * eta),
                                                std::sin(2 * j * xi) * std::cosh(2 * j * eta));
    return glm::dvec2(500000.0, 0.0) + 0.9996 * radius_m * east_north;
}

/// A turned world in a plane that touches the earth is put on a map.
TEST_F(Georeferences, ProjectToAMap) {
    const glm::dquat rotation = make_rotation(0.7, 0.0, 0.0);
    const Georeference place{kKarlsruhe, {1.0, 2.0, 3.0}, local_tangent_crs(kKarlsruhe), rotation};
    const MapProjector map(place, "EPSG:32632");
    const glm::dvec3 far_m(2000.0, -700.0, 30.0);
    for (const glm::dvec3& point_m : {place.point_m, far_m}) {
        const GeodeticPosition position = GeoConverter(place).to_geodetic(point_m);
        const glm::dvec3 expected(project_utm(position, 9.0), position.height_m);
        EXPECT_LT(glm::distance(map.to_map(point_m), expected), 1e-3);
    }
    // The convergence of the meridians turns north on the map.
    const double convergence =
        kDegree * (kKarlsruhe.longitude_deg - 9.0) * std::sin(kDegree * kKarlsruhe.latitude_deg);
    const glm::dvec3 forward = map.to_map(Pose{{1, 0, 0, 0}, place.point_m}).rotation * glm::dvec3(1, 0, 0);
    EXPECT_NEAR(std::atan2(forward.y, forward.x), 0.7 + convergence, 1e-5);
    const Pose axes = map.dataset_from_axes(place.point_m);
    std::vector<glm::vec3> points{glm::vec3(inverse(axes) * far_m)};
    map.project_points(points, axes);
    EXPECT_LT(glm::distance(map.to_map(place.point_m) + glm::dvec3(points[0]), map.to_map(far_m)), 1e-3);
    EXPECT_NE(map.map().wkt().find("\"32632\""), std::string::npos);
}

TEST_F(Georeferences, FitPositionsOnAPath) {
    const Georeference place{
        kKarlsruhe, {1.0, 2.0, 3.0}, local_tangent_crs(kKarlsruhe), make_rotation(0.7, 0.0, 0.0)};
    std::vector<glm::dvec3> path_m;
    std::vector<GeodeticPosition> positions;
    for (int i = 0; i < 20; ++i) {
        path_m.emplace_back(i, 0.1 * i * i, 0.0);
        positions.push_back(GeoConverter(place).to_geodetic(path_m.back()));
    }
    const std::optional<Georeference> fit = fit_georeference(path_m, positions).georeference;
    ASSERT_TRUE(fit.has_value());
    EXPECT_LT(glm::distance(GeoConverter(*fit).to_dataset(positions[7]), path_m[7]), 1e-3);
    EXPECT_FALSE(fit_georeference({path_m[0]}, {positions[0]}).georeference) << "a point shows no heading";
    EXPECT_FALSE(fit_georeference({}, {}).georeference);
}

}  // namespace
}  // namespace relidar
