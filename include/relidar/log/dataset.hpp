// SPDX-License-Identifier: Apache-2.0
// Loads LiDAR logs from disk into a `Sequence`. Errors name the file and the field that
// is wrong.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>
#include <relidar/log/sequence.hpp>

namespace relidar {

/// Half-open range of frame numbers, written "a:b" on the command line. Either side may
/// be empty. The numbers are those of the dataset.
struct FrameRange {
    int begin = 0;
    int end = -1;  ///< -1: up to the last frame
};

/// Value of `DatasetOptions::poses_file` for a log without poses. All poses are then
/// identity until a registration of the scans estimates them. Boxes keep the poses of
/// their labels in the sensor frame; set_vehicle_poses() moves them along with the
/// vehicle. To read a file that has the name "none", write "./none".
inline constexpr const char* kNoPoses = "none";

/// Options that only the reader of ROS bags uses.
struct BagOptions {
    std::string poses_from = {};  ///< frame or topic of the poses; empty: the reader chooses
};

/// Options that only the reader of Waymo Open uses.
struct WaymoOptions {
    bool clamp_intensity = false;  ///< cut intensities at 1; false: take their tanh
};

/// Options for reading a log.
struct DatasetOptions {
    /// Name of the drive, for a dataset that has several. Empty: the only drive, or the
    /// first one.
    std::string sequence;
    FrameRange frames;
    /// Text file with poses: line i has the 12 numbers of world_from_sensor for frame i,
    /// in the dataset's world frame. Empty: use the poses of the dataset. kNoPoses: read
    /// no poses.
    std::filesystem::path poses_file;
    /// true: skip frames without a scan. false: a missing scan is an error.
    bool allow_missing_scans = true;
    /// true: skip scans that cannot be read and add a note for each. false: the first
    /// such scan is an error.
    bool skip_broken = false;
    /// false: treat all rays of a sweep as if they were fired at its reference time
    bool rolling_shutter = true;
    double max_range_m = 80.0;             ///< returns farther away are treated as dropped
    double min_range_m = 0.0;              ///< returns nearer than this are treated as dropped
    std::vector<std::string> lidars = {};  ///< names of the LiDARs to read; empty: all
    /// For a preview of a long log: the maximum number of scans to read from each LiDAR.
    /// The scans are spread over its frames, and the other frames have no rays. 0: read
    /// all scans. Logs of KITTI, Argoverse 2 and Waymo, and of nuScenes' original
    /// HDL-32E, are always read completely.
    int most_scans = 0;
    Progress progress = {};  ///< receives the progress of reading
    BagOptions bag = {};
    WaymoOptions waymo = {};
};

/// Reads a log.
/// @param dataset  a path (the format is recognised), or "kind:path" with a kind that
/// recognise_dataset() returns
/// @throws DataError naming the file and what is wrong with it
/// @throws UsageError for an unknown kind or an empty frame range
Sequence load_sequence(const std::string& dataset, const DatasetOptions& options);

/// Returns a dataset argument of load_sequence() with an absolute path, so that it does
/// not depend on the working directory. Keeps a "kind:" prefix.
std::string absolute_dataset(const std::string& dataset);

/// Returns the kind of a dataset, for example "kitti_raw" or "waymo". docs/datasets.md
/// lists all kinds.
/// @throws DataError if the path is none of the known kinds
std::string recognise_dataset(const std::filesystem::path& path);

/// Options of save_folder().
struct FolderOptions {
    /// replace an existing plain folder of this name after the new one is complete
    bool overwrite = false;
    bool poses = true;  ///< false: do not write poses; for a log that was read without poses (kNoPoses)
    /// receives the progress; if it throws an exception, writing stops and leaves no
    /// files
    Progress progress = {};
};
/// Writes a log as a plain folder (kind "folder", docs/datasets.md) that load_sequence()
/// can read. All rays are preserved bit by bit, including dropped rays and second
/// returns. Times, boxes and notes are preserved too, and poses to a nanometre. Values
/// that are estimated later, for example the intensity response of beams, are not
/// written. The folder gets its final name only when it is complete.
/// @throws UsageError if the path exists and may not be replaced
/// @throws DataError if the folder cannot be written
void save_folder(const Sequence& sequence, const std::filesystem::path& folder,
                 const FolderOptions& options = {});

/// Returns true if a folder or file is a log of a known kind.
bool is_dataset(const std::filesystem::path& path);

/// Parameters of the synthetic street: facades, poles, parked cars and moving objects.
/// Its scans are computed by exact ray casting.
struct SyntheticOptions {
    std::uint64_t seed = 1;
    int n_frames = 30;
    int rows = 32;
    int columns = 512;
    double range_noise_m = 0.01;  ///< standard deviation of the range noise
    double speed_mps = 8.0;       ///< speed of the sensor along the street
    bool moving_cars = true;
    /// File of a sensor rig that is mounted on the vehicle. Its sensors record the log,
    /// instead of a sensor with `rows` and `columns`.
    std::string rig = {};
    /// Adds three pedestrians, a cyclist, cars parked behind a fence, cars with
    /// transparent windows, and bushes.
    bool people = false;
    /// pedestrians swing their legs and arms, in step with the distance they have walked
    bool gait = false;
};

/// Creates the log of the synthetic street in memory. The scans are ground truth: exact
/// ray casting with a rolling shutter.
Sequence make_synthetic_street(const SyntheticOptions& options);

/// Casts any rays into the synthetic street, each at its own firing time. The result is
/// the exact scan of a novel sensor or pose. It has no noise. A dropped ray has range 0.
/// @param world_from_sensor  poses of the sensor over time
/// @param time_s  reference time of the scan
Scan cast_synthetic_street(const SyntheticOptions& options, const RayTable& rays,
                           const PoseTrack& world_from_sensor, double time_s);

/// Casts beams with a divergence, and returns up to two returns for each beam, like a
/// dual-return receiver. The first is the strongest. The second is the last return, or
/// the second strongest if the strongest is also the last. Each beam is sampled with 53
/// exact rays. Surfaces that are 0.5 m apart give separate returns. A second return needs
/// at least a tenth of the light of the strongest one.
/// @param rays  at least one ray must have a divergence above 0
/// @throws UsageError if no ray has a divergence
Scan cast_synthetic_beams(const SyntheticOptions& options, const RayTable& rays,
                          const PoseTrack& world_from_sensor, double time_s);

/// A car in an edited street. It has the shape of one of the street's original cars and
/// follows a track in relidar's world frame.
struct StreetCar {
    std::size_t shapes_of = 0;  ///< id of the original car: BoxTrack::id "0", "1", ...
    BoxTrack track;  ///< the car exists in every sweep at whose reference time the track is present
};

/// Casts rays into the street with these cars instead of the original ones. The result is
/// the exact scan of an edited street.
/// @throws DataError if the street has no car with the id `shapes_of`
Scan cast_synthetic_street(const SyntheticOptions& options, const std::vector<StreetCar>& cars,
                           const RayTable& rays, const PoseTrack& world_from_sensor, double time_s);

/// Reads the options of a log that save_synthetic() wrote.
/// @throws DataError naming the key that is wrong
SyntheticOptions read_synthetic(const std::filesystem::path& folder);

/// Writes a synthetic log as a folder that load_sequence() can read (kind "synthetic").
/// The folder holds only `street.toml` with the options.
void save_synthetic(const SyntheticOptions& options, const std::filesystem::path& folder);

}  // namespace relidar
