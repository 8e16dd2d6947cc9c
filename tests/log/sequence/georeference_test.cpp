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
    const glm::dvec3 point = geocentric(kKarlsruhe);
    const GeoConverter geocentric_world({kKarlsruhe, point, "EPSG:4978"});
    const GeodeticPosition near{49.02, 8.44, 120.0};
    EXPECT_LT(glm::distance(geocentric_world.to_dataset(near), geocentric(near)), 1e-6);
    EXPECT_NE(geocentric_world.wkt(), "");
    // On the central meridian, the northing is 0.9996 times the length of the meridian:
    // 4984944.378 m from the equator to 45 degrees.
    const GeoConverter utm({{45.0, 9.0, 0.0}, {500000.0, 0.9996 * 4984944.378, 0.0}, "EPSG:32632"});
    EXPECT_LT(glm::distance(utm.to_dataset({0.0, 9.0, 5.0}), glm::dvec3(500000.0, 0.0, 5.0)), 2e-3);
    EXPECT_NE(utm.wkt().find("\"32632\""), std::string::npos);
    EXPECT_EQ(GeoConverter({{45.0, 9.0, 0.0}, {500000.0, 4.9e6, 0.0}, "EPSG:32632"}).wkt(), "")
        << "the world is shifted";
    EXPECT_THROW(GeoConverter({kKarlsruhe, {}, "EPSG:1"}), DataError);
    EXPECT_THROW(GeoConverter({kKarlsruhe, {}, "+proj=nonsense"}), DataError);
    for (const char* crs : {"EPSG:4326", "EPSG:4979", "+proj=longlat +ellps=WGS84"})
        EXPECT_THROW(GeoConverter({kKarlsruhe, {}, crs}), DataError) << "degrees";
}

}  // namespace
}  // namespace relidar
