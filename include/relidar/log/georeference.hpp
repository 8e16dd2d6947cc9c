// SPDX-License-Identifier: Apache-2.0
// The place of a log on the earth. PROJ does the mathematics, if relidar was built with
// it.
#pragma once

#include <memory>
#include <string>

#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>

namespace relidar {

/// Degrees on the WGS 84 ellipsoid, and metres above it.
struct GeodeticPosition {
    double latitude_deg = 0.0, longitude_deg = 0.0, height_m = 0.0;
};

/// Relates the dataset's world to a projection P of the earth:
///   P(p) = P(position) + rotation * (p - point_m)
struct Georeference {
    GeodeticPosition position;
    glm::dvec3 point_m{0.0};  ///< the same point in the dataset's world frame
    /// The projection P: a code such as EPSG:32632, or a PROJ string that converts
    /// longitude and latitude to metres, such as "+proj=merc +R=6378137".
    std::string crs;
    glm::dquat rotation{1.0, 0.0, 0.0, 0.0};
};

/// Returns true if relidar was built with PROJ.
bool has_proj();
/// Returns the PROJ string of a plane at a position: x east, y north, z up.
std::string local_tangent_crs(const GeodeticPosition& position);

/// Converts between the world of a log and positions on the earth.
class GeoConverter {
public:
    /// @throws UsageError if relidar was built without PROJ
    /// @throws DataError if PROJ does not know the projection
    explicit GeoConverter(const Georeference& georeference);
    /// @param dataset_m metres, in the dataset's world frame
    /// @throws DataError if the projection has no such point
    GeodeticPosition to_geodetic(const glm::dvec3& dataset_m) const;
    /// @return metres, in the dataset's world frame
    /// @throws DataError if the projection has no such point
    glm::dvec3 to_dataset(const GeodeticPosition& position) const;
    /// Returns the rotation from axes that point east, north and up at a position to the
    /// axes of the dataset's world.
    glm::dquat dataset_from_enu(const GeodeticPosition& position) const;
    /// Returns the projection as WKT 1. Returns an empty text if PROJ cannot describe it,
    /// or if x and y of the dataset's world are not those of the projection.
    std::string wkt() const;

private:
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

}  // namespace relidar
