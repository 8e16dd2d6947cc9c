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

/// Name of the description file in an asset's folder.
inline constexpr const char* kAssetFile = "asset.json";

/// Points at which LiDAR rays of the log hit one actor, used to find which parts were
/// observed.
struct ActorObservations {
    std::vector<glm::vec3> points_m;                             ///< [n,3] box frame
    std::vector<glm::vec3> directions;                           ///< [n,3] directions of the rays, box frame
    double nearest_m = std::numeric_limits<double>::infinity();  ///< shortest range of a hit
};
/// Returns the surface of an actor's box. The patches that rays of the log have hit are
/// marked as observed.
/// @param box_size_m [3] size of the box
ObservedBoxSurface make_observed_box_surface(const glm::dvec3& box_size_m,
                                             const ActorObservations& observations);
/// Returns the points at which rays of the log hit each actor, by track. Renders the
/// training frames again with the log's LiDARs at their original poses. An object that
/// hid an actor in the log therefore also hides it here. A LiDAR without a nominal ray
/// pattern is replaced by an HDL-64E.
std::map<std::string, ActorObservations> collect_actor_observations(Device& device, const TrainedRun& run,
                                                                    const ProgressReporter& progress = {});

/// Description of an asset, as stored in asset.json.
struct AssetDescription {
    std::string name;      ///< name of its folder and its track, for example "car-3"
    std::string category;  ///< class name in the dataset, or "Discovered"
    /// Kind of object, for example a vehicle. An object without a label counts as a
    /// vehicle if it is as large as one.
    ObjectKind kind = ObjectKind::other;
    glm::dvec3 size_m{0.0};    ///< length, width, height
    std::string source_run;    ///< absolute path of the run from which the actor was extracted
    std::string source_track;  ///< Id of the actor's track in the source run.
    /// Name of the sensor in the source run. The intensities and drop probabilities of
    /// the actor were trained for this sensor.
    std::string sensor;
    /// Fraction of each side of the box that rays of the log have hit.
    std::array<double, kBoxSides> seen_sides{};
    double seen = 0.0;  ///< Observed fraction of all sides of the box, by area.
    /// Fraction of the box surface that the log did not observe and that was replaced by
    /// the mirror image of the other side.
    double completed = 0.0;
    /// Height of the box's bottom above the road, in metres. Computed by
    /// measure_ground_clearance().
    double clearance_m = 0.0;
    double nearest_m = 0.0;  ///< Shortest range from which a ray hit the actor.
    std::size_t surfels = 0;
    std::size_t mirrored = 0;  ///< Number of surfels that were mirrored from the other side of the box.

    /// Returns the fraction of the box surface that was observed, or completed with the
    /// mirror image.
    double get_observed_or_mirrored_surface_fraction() const { return seen + completed; }
};

/// An actor that was extracted from a run.
struct ActorAsset {
    AssetDescription facts;
    /// Run with the frames in which the actor is present. The run has no other actors,
    /// and its background is empty.
    TrainedRun run;
};
/// Extracts an actor from a run. Removes surfels that are never visible, because they are
/// too faint to be blended or are outside the box. Parts of a vehicle that no ray has hit
/// are replaced by the mirror image of the other side. A part is replaced only if rays
/// have hit its mirror image.
/// @param observations  hits of this actor
/// @throws UsageError if no instance has this track
ActorAsset extract_actor_asset(const TrainedRun& run, const std::string& track,
                               const ActorObservations& observations);

/// Writes an asset (an actor) to a folder: its description as asset.json, and the files
/// of a trained run that contains only this actor.
/// @throws DataError if the folder cannot be written
void save_asset(ActorAsset asset, const std::filesystem::path& folder);
/// Reads asset.json from a folder.
/// @throws DataError if the file is missing or malformed
AssetDescription read_asset_description(const std::filesystem::path& folder);
/// Returns the height of an asset's box above the road (AssetDescription::clearance_m).
/// Returns nothing if the run is not an asset.
std::optional<double> read_asset_ground_clearance(const TrainedRun& run);
/// Returns the paths of all assets in a folder, sorted by name.
/// @throws DataError if the folder contains no asset
std::vector<std::filesystem::path> list_asset_folders(const std::filesystem::path& folder);

/// Returns the track name of the only actor of a run, for example of an asset.
/// @throws UsageError if the run has no actor or several
std::string get_track_name_of_only_actor(const TrainedRun& run);

}  // namespace relidar
