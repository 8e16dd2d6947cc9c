// SPDX-License-Identifier: Apache-2.0
// Assets: actors that are extracted from a run so that they can be inserted into other
// scenes. An asset is a folder with two parts: a run that contains only this actor, and
// asset.json, which describes the actor and how completely it was observed.
#pragma once

#include <array>
#include <filesystem>
#include <limits>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/run/run.hpp>

namespace relidar {

/// Name of the description file in an asset's folder.
inline constexpr const char* kAssetFile = "asset.json";

/// Sides of a box whose visibility is measured. The bottom is not included.
enum class BoxSide { front, rear, left, right, top };
inline constexpr std::size_t kBoxSides = 5;
/// Returns the name of a side: "front", "rear", "left", "right", "top".
const char* name_of(BoxSide side);

/// Surface of a box, divided into patches of about 0.3 m. It records which patches were
/// observed. A point belongs to the patch onto which it projects from the centre of the
/// box. The lowest fifth of the four sides does not count, because it is hidden near the
/// ground. Every patch has a mirror patch on the other side of the x-z plane.
class BoxSurface {
public:
    /// Creates a surface without observed patches.
    /// @param size_m [3] length, width, height, all above 0
    explicit BoxSurface(const glm::dvec3& size_m);
    /// Marks the patch of a point as observed by a ray. The ray must hit the side from
    /// outside and must not graze it. Rays from inside are ignored, because they reach
    /// the far side through a window. The centre of the box and points below the sides
    /// mark nothing.
    /// @param point_m [3] box frame
    /// @param direction [3] direction of the ray, box frame
    void add(const glm::dvec3& point_m, const glm::dvec3& direction);
    /// Returns true if the patch of a point was observed. Returns false for a patch that
    /// does not count.
    bool is_seen(const glm::dvec3& point_m) const;
    /// Returns true if the patch of a point was not observed but its mirror patch was.
    bool is_mirrored(const glm::dvec3& point_m) const;
    /// Returns the observed fraction of a side, 0 to 1.
    double seen(BoxSide side) const;
    /// Returns the observed fraction of the complete surface, by area, 0 to 1. mirrored()
    /// returns the fraction that was not observed but whose mirror patch was.
    double seen() const;
    double mirrored() const;

private:
    struct Patch {
        BoxSide side;
        int column, row;
    };
    glm::dvec3 half_m_;
    std::array<std::array<int, 2>, kBoxSides> n_{};  ///< number of patches of a side along its two axes
    std::array<std::vector<char>, kBoxSides> seen_;

    /// Finds the patch of a point. Returns false if the point has none.
    bool find(const glm::dvec3& point_m, Patch& patch) const;
    Patch mirror(Patch patch) const;  ///< returns the mirror patch
    /// returns true if the patch is above the part near the ground
    bool counts(const Patch& patch) const;
    bool at(const Patch& patch) const;  ///< returns true if the patch was observed
    /// Returns two areas in m2: of the observed (or mirrored) patches, and of all
    /// patches.
    std::array<double, 2> areas(BoxSide side, bool mirrored) const;
    double share(bool mirrored) const;  ///< fraction of all sides
};

/// Points at which rays hit an actor.
struct ActorSightings {
    std::vector<glm::vec3> points_m;                             ///< [n,3] box frame
    std::vector<glm::vec3> directions;                           ///< [n,3] directions of the rays, box frame
    double nearest_m = std::numeric_limits<double>::infinity();  ///< shortest range of a hit
};
/// Returns the surface of an actor's box with the observed patches marked.
/// @param size_m [3] size of the box
BoxSurface seen_surface(const glm::dvec3& size_m, const ActorSightings& sightings);
/// Renders the training frames again and returns where their rays hit each actor, by
/// track. The scans use the log's LiDARs at their original poses, so objects that hid an
/// actor in the log hide it here too. A LiDAR without a nominal ray pattern is replaced
/// by an HDL-64E.
std::map<std::string, ActorSightings> sight_actors(Device& device, const Run& run,
                                                   const Progress& progress = {});

/// Description of an asset, as stored in asset.json.
struct AssetFacts {
    std::string name;      ///< name of its folder and its track, for example "car-3"
    std::string category;  ///< class name in the dataset, or "Discovered"
    /// Kind of the class. A discovered object counts as a vehicle if it is as large as
    /// one.
    ObjectKind kind = ObjectKind::other;
    glm::dvec3 size_m{0.0};    ///< length, width, height
    std::string source_run;    ///< absolute path of the run from which the actor was extracted
    std::string source_track;  ///< track of the actor in that run
    /// sensor of that run; it determined the intensities and the ray-drop of the actor
    std::string sensor;
    std::array<double, kBoxSides> seen_sides{};  ///< fraction of each side that rays of the log have hit
    double seen = 0.0;                           ///< fraction of all sides, by area
    double completed = 0.0;  ///< fraction that was not observed and was completed by mirroring
    /// Height of the bottom of its box above the road, see ground_clearance().
    double clearance_m = 0.0;
    double nearest_m = 0.0;  ///< shortest range from which it was observed
    std::size_t surfels = 0;
    std::size_t mirrored = 0;  ///< number of these surfels that were mirrored from the other side

    /// Returns the fraction of the surface that is observed or completed.
    double score() const { return seen + completed; }
};

/// An actor that was extracted from a run.
struct Asset {
    AssetFacts facts;
    Run run;  ///< run with the frames in which the actor is present; no other actors, empty background
};
/// Extracts an actor from a run. Removes surfels that are never visible, because they are
/// too faint to be blended or are outside the box. For a vehicle, parts that no ray has
/// hit are replaced by the mirror image of the other side, if rays have hit that.
/// @param sightings  hits of this actor
/// @throws UsageError if no instance has this track
Asset make_asset(const Run& run, const std::string& track, const ActorSightings& sightings);

/// Returns surfels mirrored at the x-z plane: y becomes -y. Seen from the other side,
/// they look the same as the original surfels.
Surfels mirrored_left_right(Surfels surfels);

/// Writes an asset to a folder, which becomes the folder of its run.
/// @throws DataError like save_run()
void save_asset(Asset asset, const std::filesystem::path& folder);
/// Reads asset.json from a folder.
/// @throws DataError if the file is missing or malformed
AssetFacts read_asset_facts(const std::filesystem::path& folder);
/// Returns AssetFacts::clearance_m of a run that is an asset, or nothing for any other
/// run.
std::optional<double> asset_clearance(const Run& run);
/// Returns the folders of all assets in a folder, sorted by name.
/// @throws DataError if there is none
std::vector<std::filesystem::path> asset_folders(const std::filesystem::path& folder);

/// Returns the track of the only actor of a run, such as an asset.
/// @throws UsageError if the run has no actor or several
std::string only_track(const Run& run);

}  // namespace relidar
