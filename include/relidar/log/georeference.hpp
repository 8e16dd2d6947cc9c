// SPDX-License-Identifier: Apache-2.0
// The place of a log on the earth. PROJ does the mathematics, if relidar was built with
// it.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <glm/glm.hpp>
#include <glm/gtc/quaternion.hpp>

namespace relidar {

struct Pose;

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
    /// longitude and latitude to metres, such as "+proj=merc +R=6378137". Its z is the
    /// height, and its lengths at `position` are 0.9 to 1.1 times those on the earth.
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
    /// @throws DataError if PROJ does not know the projection, or if its coordinates are
    /// not those of an upright, right-handed map in metres
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
    /// Returns the coordinates of the projection, in metres.
    glm::dvec3 to_map(const GeodeticPosition& position) const;
    /// Returns a note for the user if lengths at the position differ by more than 0.1 %
    /// from those on the earth, or an empty text.
    std::string scale_note() const;
    /// Returns the projection as WKT 1. Returns an empty text if PROJ cannot describe it,
    /// or if x and y of the dataset's world are not those of the projection.
    std::string wkt() const;

private:
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

/// Converts from the world of a log to the coordinates of a map.
class MapProjector {
public:
    /// @param crs  the map, as in Georeference
    /// @throws as GeoConverter
    MapProjector(const Georeference& world, const std::string& crs);
    glm::dvec3 to_map(const glm::dvec3& dataset_m) const;
    Pose to_map(const Pose& dataset_pose) const;
    /// Returns a frame at a point of the dataset's world with the axes of the map there.
    Pose dataset_from_axes(const glm::dvec3& dataset_m) const;
    /// Converts points in such a frame to positions on the map, relative to its origin.
    void project_points(std::vector<glm::vec3>& points_m, const Pose& dataset_from_axes) const;
    /// Converts from positions on the earth to the map.
    const GeoConverter& map() const { return map_; }
    const std::string& crs() const { return crs_; }

private:
    GeoConverter world_, map_;
    std::string crs_;
};

struct GeoreferenceFit {
    std::optional<Georeference> georeference;  ///< empty if the positions do not determine it
    std::string note;                          ///< numbers of the fit, for the user
};
/// Fits the world of a log to positions of an antenna on the earth. Assumes that the z
/// axis of the world points up.
/// @param antenna_m  [positions] where the antenna is in the dataset's world
GeoreferenceFit fit_georeference(const std::vector<glm::dvec3>& antenna_m,
                                 const std::vector<GeodeticPosition>& positions);

}  // namespace relidar
