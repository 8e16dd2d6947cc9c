// SPDX-License-Identifier: Apache-2.0
// Assets: actors of a run kept to be placed in other scenes. An asset is a folder: a run
// whose only actor it is, which renders and can be inserted like any other, and
// asset.json, which says what it is and how much of it was seen.
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

/// The file of an asset's folder that says what it is.
inline constexpr const char* kAssetFile = "asset.json";

/// The sides of a box that are looked at; its bottom is not.
enum class BoxSide { front, rear, left, right, top };
inline constexpr std::size_t kBoxSides = 5;
/// "front", "rear", "left", "right", "top".
const char* name_of(BoxSide side);

/// Which patches of a box's surface points lie on, as seen from its centre. Patches are
/// about 0.3 m wide; of the four sides the lowest fifth does not count: the ground hides
/// it. Every patch has a mirror image on the other side of the plane of x and z.
class BoxSurface {
public:
    /// @param size_m [3] length, width, height, all above 0
    explicit BoxSurface(const glm::dvec3& size_m);
    /// Marks the patch before a point as seen by a ray, if that comes to the patch's side
    /// from outside, and does not graze it: through a window the far side is met from
    /// within. @param point_m [3] box frame; the centre itself and what is below the
    /// sides mark nothing
    /// @param direction [3] of the ray, box frame
    void add(const glm::dvec3& point_m, const glm::dvec3& direction);
    /// Whether the patch before a point was seen; false for one that does not count.
    bool is_seen(const glm::dvec3& point_m) const;
    /// Whether that patch was not seen, and its mirror image was.
    bool is_mirrored(const glm::dvec3& point_m) const;
    /// Share of a side that was seen, 0 to 1.
    double seen(BoxSide side) const;
    /// Shares of the whole surface, by area, 0 to 1: what was seen, and what was not
    /// while its mirror image was.
    double seen() const;
    double mirrored() const;

private:
    struct Patch {
        BoxSide side;
        int column, row;
    };
    glm::dvec3 half_m_;
    std::array<std::array<int, 2>, kBoxSides> n_{};  ///< patches of a side along its two axes
    std::array<std::vector<char>, kBoxSides> seen_;

    /// whether there is one before a point, and which
    bool find(const glm::dvec3& point_m, Patch& patch) const;
    Patch mirror(Patch patch) const;        ///< its mirror image
    bool counts(const Patch& patch) const;  ///< whether it lies above what the ground hides
    bool at(const Patch& patch) const;      ///< whether it was seen
    /// m2: of patches that were seen (or mirrored), and of all
    std::array<double, 2> areas(BoxSide side, bool mirrored) const;
    double share(bool mirrored) const;  ///< of all sides
};

/// Where rays met an actor.
struct ActorSightings {
    std::vector<glm::vec3> points_m;                             ///< [n,3] box frame
    std::vector<glm::vec3> directions;                           ///< [n,3] of the rays, box frame
    double nearest_m = std::numeric_limits<double>::infinity();  ///< range of the nearest
};
/// The same as a surface. @param size_m [3] of the box
BoxSurface seen_surface(const glm::dvec3& size_m, const ActorSightings& sightings);
/// What re-simulated scans of the training frames meet of each actor, by track: the log's
/// own LiDARs where they were, so that what hides an actor hides it here too. In the
/// place of a LiDAR whose rays are known scan by scan alone there is an HDL-64E.
std::map<std::string, ActorSightings> sight_actors(Device& device, const Run& run,
                                                   const Progress& progress = {});

/// What is known of an asset.
struct AssetFacts {
    std::string name;      ///< of its folder and its track: "car-3"
    std::string category;  ///< the dataset's own class name, or "Discovered"
    /// of the class; what was discovered is a vehicle where it is as large as one
    ObjectKind kind = ObjectKind::other;
    glm::dvec3 size_m{0.0};                      ///< length, width, height
    std::string source_run;                      ///< absolute path of the run it was an actor of
    std::string source_track;                    ///< and by which name
    std::string sensor;                          ///< of that run, whose intensities and ray-drop it has
    std::array<double, kBoxSides> seen_sides{};  ///< share of each side that rays of the log have met
    double seen = 0.0;                           ///< share of all of them, by area
    double completed = 0.0;  ///< share that the mirror image of what was seen stands in for
    /// of the bottom of its box above the ground it drove on (ground_clearance())
    double clearance_m = 0.0;
    double nearest_m = 0.0;  ///< range from which it was seen at the nearest
    std::size_t surfels = 0;
    std::size_t mirrored = 0;  ///< of them, of the other side

    /// Share of its surface that it has: seen, or completed.
    double score() const { return seen + completed; }
};

/// An actor on its own.
struct Asset {
    AssetFacts facts;
    Run run;  ///< the frames in which it is there, and no other actor; its background is empty
};
/// Leaves out surfels that can show nowhere, too faint to be blended or outside of the
/// box. Of a vehicle, what no ray has met is replaced by the mirror image of the other
/// side, where that was met.
/// @param sightings  of that actor @throws UsageError for a track that no instance has
Asset make_asset(const Run& run, const std::string& track, const ActorSightings& sightings);

/// Surfels on the other side of the plane of x and z, y becoming -y, which look from
/// there as the given ones do from here.
Surfels mirrored_left_right(Surfels surfels);

/// Writes the asset into a folder, which becomes its run's. @throws DataError as
/// save_run()
void save_asset(Asset asset, const std::filesystem::path& folder);
/// What asset.json of a folder says. @throws DataError where it is missing or malformed
AssetFacts read_asset_facts(const std::filesystem::path& folder);
/// AssetFacts::clearance_m of a run that is an asset; nothing of another run.
std::optional<double> asset_clearance(const Run& run);
/// The folders of all assets in a folder, by name. @throws DataError where there is none
std::vector<std::filesystem::path> asset_folders(const std::filesystem::path& folder);

/// The only actor of a run: what an asset is of. @throws UsageError where it has several,
/// or none
std::string only_track(const Run& run);

}  // namespace relidar
