// SPDX-License-Identifier: Apache-2.0
// Assets: actors that are extracted from a run so that they can be inserted into other
// scenes. An asset is a folder that contains a run with only this actor, and the file
// asset.json. This file describes the actor and how completely the log observed it.
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
#include <relidar/scene/box_surface.hpp>

namespace relidar {

inline constexpr const char* kAssetFile = "asset.json";

/// Points at which LiDAR rays of the log hit one actor.
struct ActorObservations {
    std::vector<glm::vec3> points_m;                             ///< [n,3] box frame
    std::vector<glm::vec3> directions;                           ///< [n,3] directions of the rays, box frame
    double nearest_m = std::numeric_limits<double>::infinity();  ///< shortest range of a hit
};
using ObservationsByTrack = std::map<std::string, ActorObservations>;
/// Marks the patches of an actor's box that rays of the log have hit.
ObservedBoxSurface observed_surface(const glm::dvec3& box_size_m, const ActorObservations& observations);
/// Returns the points at which rays of the log hit each actor, by track. Renders the
/// training frames again, so that an object that hid an actor in the log also hides it
/// here. A LiDAR without a nominal ray pattern is replaced by an HDL-64E.
ObservationsByTrack observe_actors(Device& device, const Run& run, const Progress& progress = {});

struct AssetDescription {
    std::string name;      ///< name of its folder and its track, for example "car-3"
    std::string category;  ///< class name in the dataset, or that of class_of()
    /// An object without a label counts as a vehicle if it is as large as one.
    ObjectKind kind = ObjectKind::other;
    glm::dvec3 size_m{0.0};    ///< length, width, height
    std::string source_run;    ///< name of the run from which the actor was extracted
    std::string source_track;  ///< Id of the actor's track in the source run.
    /// Sensor of the source run, for which intensities and drop probabilities were
    /// trained.
    std::string sensor;
    /// fraction of each side that rays of the log have hit
    std::array<double, kBoxSides> seen_sides{};
    double seen = 0.0;  ///< Observed fraction of all sides of the box, by area.
    /// fraction of the box surface that was replaced by the mirror image of the other
    /// side
    double completed = 0.0;
    /// Height of the box above the road, from ground_clearance().
    double clearance_m = 0.0;
    double nearest_m = 0.0;  ///< Shortest range from which a ray hit the actor.
    std::size_t surfels = 0;
    std::size_t mirrored = 0;  ///< Number of surfels that were mirrored from the other side of the box.

    double covered_share() const { return seen + completed; }
};

struct ActorAsset {
    AssetDescription facts;
    /// Has the frames in which the actor is present, and an empty background.
    Run run;
};
/// Extracts an actor from a run. Removes surfels that are too faint to be blended or
/// outside the box. Parts of a vehicle that no ray has hit are replaced by the mirror
/// image of the other side, if rays have hit it.
/// @param observations  hits of this actor
/// @throws UsageError if no instance has this track
ActorAsset extract_asset(const Run& run, const std::string& track, const ActorObservations& observations);

/// Writes asset.json, and the files of a trained run that contains only the actor.
/// @throws DataError if the folder cannot be written
void save_asset(ActorAsset asset, const std::filesystem::path& folder);
/// Reads asset.json from a folder.
/// @throws DataError if the file is missing or malformed
AssetDescription read_description(const std::filesystem::path& folder);
/// Returns AssetDescription::clearance_m, or nothing if the run is not an asset.
std::optional<double> read_clearance(const Run& run);
/// Returns the folders of all assets in a folder, sorted by name.
/// @throws DataError if the folder contains no asset
std::vector<std::filesystem::path> list_assets(const std::filesystem::path& folder);

/// Returns the track name of the only actor of a run, for example of an asset.
/// @throws UsageError if the run has no actor or several
std::string only_track(const Run& run);

}  // namespace relidar
