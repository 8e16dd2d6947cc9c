// SPDX-License-Identifier: Apache-2.0
// Classes of surfaces, and the class map of a log: the classes of all places at which the
// log has labelled points. A simulated ray gets the class of the place that it hits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

struct PoseTrack;
struct BoxTrack;
struct Log;

/// Class of a surface. The numbers are the values of the channel `class`.
enum class SurfaceClass : std::uint8_t {
    unknown,  ///< background without a label
    vehicle,
    cyclist,  ///< cycle or motorcycle, with or without a rider
    person,
    other_actor,
    road,      ///< surface to drive on, including markings and parking spaces
    sidewalk,  ///< surface to walk on, including kerbs
    terrain,   ///< grass and soil
    other_ground,
    building,
    fence,
    vegetation,  ///< plants, including trunks
    pole,
    sign,       ///< traffic sign or traffic light
    structure,  ///< man-made structure without a more specific class
    object,     ///< small static object, such as a cone or a barrier
    ego         ///< the vehicle that carries the sensor
};
inline constexpr std::size_t kSurfaceClasses = 17;

/// A cubic cell of the world with labelled points, and their most frequent class.
struct SurfaceClassCell {
    glm::ivec3 grid_index{0};  ///< position of the lowest corner, in units of kClassCell_m
    SurfaceClass surface = SurfaceClass::unknown;

    bool operator==(const SurfaceClassCell&) const = default;
};
/// Edge length of a cell.
inline constexpr double kClassCell_m = 0.1;
/// All cells of a log that contain labelled points. No two cells have the same position.
using SurfaceClassMap = std::vector<SurfaceClassCell>;

/// Computes the class map of some scans, in relidar's world frame. Uses the first returns
/// of scans with classes. Ignores returns in moving boxes. In a tie between classes, uses
/// the class with the higher number.
/// @param world_from_vehicle  poses of the vehicle at the times of the frames
/// @param boxes  boxes of the objects of the log; returns in moving boxes are ignored
/// @param frames  indices into Log::frames of the frames to use
/// @return an empty map if no scan has classes
SurfaceClassMap map_classes(const Log& log, const PoseTrack& world_from_vehicle,
                            const std::vector<BoxTrack>& boxes, const std::vector<int>& frames);

/// Adds the cells of another map. If both maps have a cell at the same position, keeps
/// the cell of `target_map`.
void merge_class_map(SurfaceClassMap& target_map, const SurfaceClassMap& source_map);

/// Finds the class of a point. Several threads can use the same object.
class SurfaceClassLookup {
public:
    /// Builds a search tree of the cells.
    /// @param map  at least one cell
    explicit SurfaceClassLookup(const SurfaceClassMap& map);
    ~SurfaceClassLookup();
    /// Returns the class of the nearest cell. Returns `unknown` if the centre of this
    /// cell is more than 2 m away, or if a coordinate is not finite.
    /// @param point_m [3] metres, in relidar's world frame
    SurfaceClass find_class(const glm::dvec3& point_m) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
