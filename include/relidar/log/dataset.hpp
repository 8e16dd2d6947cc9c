// SPDX-License-Identifier: Apache-2.0
// From a folder on disk to a Sequence, or a sentence saying which file and field is
// wrong.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Half-open range of the dataset's own frame numbers, as "a:b" on the command line;
/// either side may be empty.
struct FrameRange {
    int begin = 0;
    int end = -1;  ///< -1: to the last frame
};

/// DatasetOptions::poses_file of a log without poses: all are identity, for a
/// registration of the scans to find. Boxes stand where their labels have them in the
/// sensor's frame, and go along with set_vehicle_poses(). A file of this name is given as
/// "./none".
inline constexpr const char* kNoPoses = "none";

/// Options that only the reader of ROS bags uses.
struct BagOptions {
    std::string poses_from = {};  ///< frame or topic of the poses; empty: the reader chooses
};

/// Options that only the reader of Waymo Open uses.
struct WaymoOptions {
    bool clamp_intensity = false;  ///< cut intensities at 1; false: take their tanh
};

/// What to read of a log.
struct DatasetOptions {
    /// which drive of a dataset that holds several, by its own name; empty: the only one,
    /// or the first
    std::string sequence;
    FrameRange frames;
    /// 12 numbers a line, world_from_sensor of frame i on line i, in the dataset's world;
    /// empty = the dataset's own; kNoPoses
    std::filesystem::path poses_file;
    /// leave frames without a scan out; false: a missing scan is an error
    bool allow_missing_scans = true;
    /// leave scans that cannot be read out, with a note each; false: the first is an
    /// error
    bool skip_broken = false;
    bool rolling_shutter = true;           ///< false: take all rays of a sweep as fired at its reference time
    double max_range_m = 80.0;             ///< returns beyond are treated as dropped
    double min_range_m = 0.0;              ///< and so are those nearer than this
    std::vector<std::string> lidars = {};  ///< names of those that are read; none: all
    /// For a look at a long log: of each LiDAR so many scans, spread over its frames, are
    /// read, and other frames stay without rays; 0: all. Logs of KITTI, Argoverse 2 and
    /// Waymo, and nuScenes' own HDL-32E, are read whole all the same.
    int most_scans = 0;
    Progress progress = {};  ///< of reading
    BagOptions bag = {};
    WaymoOptions waymo = {};
};

/// Reads a log. @param dataset a path (format recognised) or "kind:path" with a kind that
/// recognise_dataset() gives
/// @throws DataError naming the file and what is wrong with it; UsageError for an unknown
/// kind or an empty frame range
Sequence load_sequence(const std::string& dataset, const DatasetOptions& options);

/// A dataset as load_sequence() takes it, made independent of the working folder; a kind
/// in front stays.
std::string absolute_dataset(const std::string& dataset);

/// Kind of a dataset path ("kitti_raw", "waymo", ... as in docs/datasets.md). @throws
/// DataError where it is none of the known ones
std::string recognise_dataset(const std::filesystem::path& path);

/// How save_folder() writes.
struct FolderOptions {
    bool overwrite = false;  ///< a plain folder of this name is replaced, once the new one is complete
    bool poses = true;       ///< false: those of a log that was read without any (kNoPoses) are no poses
    Progress progress = {};  ///< what it throws ends the writing; nothing is left
};
/// Writes a log as a plain folder (kind "folder", docs/datasets.md) from which
/// load_sequence() reads it again: the same rays, dropped ones and second returns
/// included, bit by bit; times, boxes, notes; poses to a nanometre. What is estimated of
/// sensors later, such as the response of beams, is not part of a log. The folder appears
/// under its name when it is complete.
/// @throws UsageError where something of that name is there that may not be replaced,
/// DataError where it cannot be written
void save_folder(const Sequence& sequence, const std::filesystem::path& folder,
                 const FolderOptions& options = {});

/// Whether a folder or file is a log of one of these kinds.
bool is_dataset(const std::filesystem::path& path);

/// Parameters of the synthetic street: facades, poles, parked cars and what moves, cast
/// exactly.
struct SyntheticOptions {
    std::uint64_t seed = 1;
    int n_frames = 30;
    int rows = 32;
    int columns = 512;
    double range_noise_m = 0.01;  ///< standard deviation
    double speed_mps = 8.0;       ///< of the sensor along the street
    bool moving_cars = true;
    /// file of a rig, whose sensors take the log in place of rows and columns; mounted in
    /// the vehicle
    std::string rig = {};
    /// three pedestrians, a cyclist, cars parked behind a fence, cars with windows that
    /// let rays through, bushes
    bool people = false;
    bool gait = false;  ///< the pedestrians swing their legs and arms, by the distance that they have come
};

/// Makes the synthetic street log in memory, ground truth by exact ray casting with a
/// rolling shutter.
Sequence make_synthetic_street(const SyntheticOptions& options);

/// Casts any rays into the synthetic street at their own times: the exact answer for a
/// novel sensor or pose. Noise-free; a dropped ray has range 0. @param world_from_sensor
/// pose of the sensor against time
Scan cast_synthetic_street(const SyntheticOptions& options, const RayTable& rays,
                           const PoseTrack& world_from_sensor, double time_s);

/// The same for beams of a divergence, as a receiver of two returns has them: the
/// strongest, and the last one, or the next strongest where the strongest is the last. 53
/// exact rays for each beam; surfaces 0.5 m apart are two returns, a tenth of the
/// strongest's light is enough for the second. @param rays  some of them of a divergence
/// above 0 @throws UsageError where none is
Scan cast_synthetic_beams(const SyntheticOptions& options, const RayTable& rays,
                          const PoseTrack& world_from_sensor, double time_s);

/// A car on a street that has been edited: the shapes of one of the street's own cars,
/// along a track of relidar's world.
struct StreetCar {
    std::size_t shapes_of = 0;  ///< the street's car of BoxTrack::id "0", "1", ...
    BoxTrack track;  ///< the car is there at the sweeps at whose reference time the track is present
};

/// The same with these cars instead of the street's own: the exact answer for an edit.
/// @throws DataError where the street has no such car
Scan cast_synthetic_street(const SyntheticOptions& options, const std::vector<StreetCar>& cars,
                           const RayTable& rays, const PoseTrack& world_from_sensor, double time_s);

/// Options of a log that save_synthetic wrote. @throws DataError naming the key that is
/// wrong
SyntheticOptions read_synthetic(const std::filesystem::path& folder);

/// Writes a synthetic log as a folder that load_sequence reads (kind "synthetic":
/// street.toml with the options).
void save_synthetic(const SyntheticOptions& options, const std::filesystem::path& folder);

}  // namespace relidar
