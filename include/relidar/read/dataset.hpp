// SPDX-License-Identifier: Apache-2.0
// Loads LiDAR logs from disk into a `Log`. Error messages name the invalid file
// and field.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>
#include <relidar/log/log.hpp>

namespace relidar {

/// Frames [begin, end), written "a:b" on the command line.
struct FrameRange {
    int begin = 0;
    int end = -1;  ///< -1: up to the last frame

    /// Returns true if a frame with this number is in the range.
    bool contains(int number) const { return number >= begin && (end < 0 || number < end); }
};

/// Value of `DatasetOptions::poses_file` that means "the log has no poses". All vehicle
/// poses are then the identity until the scans are registered. set_trajectory() later
/// moves the labelled boxes together with the vehicle. To read a file with the name
/// "none", write "./none".
inline constexpr const char* kNoPoses = "none";

/// Options that only the reader of ROS bags uses.
struct BagOptions {
    /// TF frame or topic of the poses. If the text is empty, the reader chooses one.
    std::string poses_from = {};
};

/// Options that only the reader of Waymo Open uses.
struct WaymoOptions {
    /// True: intensities above 1 become 1. False: each intensity x becomes tanh(x).
    bool clamp_intensity = false;
};

/// Options for reading a log.
struct DatasetOptions {
    /// Name of the drive, if the dataset has several drives. Empty: the first drive.
    std::string sequence = {};
    FrameRange frames = {};
    /// Text file with poses world_from_vehicle: 3 x 4 matrices of frames, row by row, or
    /// times, positions, and quaternions or angles (docs/datasets.md). Empty: those of
    /// the dataset. kNoPoses: no poses.
    std::filesystem::path poses_file = {};
    /// True: skips frames without a scan. False: a missing scan is an error.
    bool allow_missing_scans = true;
    /// True: skips unreadable scans with notes. False: an unreadable scan is an error.
    bool skip_broken = false;
    Conventions conventions = {};  ///< those that the recording does not say, or says wrong
    /// True: each ray has its own firing time. False: all rays of a sweep are treated as
    /// if they were fired at the reference time of the sweep.
    bool rolling_shutter = true;
    double max_range_m = 80.0;  ///< Returns beyond this range are treated as dropped.
    double min_range_m = 0.0;   ///< Returns nearer than this range are treated as dropped.
    /// names of the LiDARs to read; empty: all
    std::vector<std::string> lidars = {};
    /// Maximum number of scans of each LiDAR, spread evenly over the log, for a preview.
    /// All other frames have no rays. 0: all scans. Logs of KITTI, Argoverse 2, Waymo,
    /// and nuScenes with its original HDL-32E are always read completely.
    int max_scans = 0;
    Progress progress = {};  ///< receives the progress of reading
    BagOptions bag = {};
    WaymoOptions waymo = {};
};

/// Reads a log from a dataset.
/// @param dataset  a path, whose format is detected, or "kind:path" with a kind that
/// detect_kind() returns
/// @throws DataError naming the file and the error in it
/// @throws UsageError for an unknown kind or an empty frame range
Log load_log(const std::string& dataset, const DatasetOptions& options);

/// Old name of load_log(), only in version 0.1.
[[deprecated("use load_log()")]] inline Log load_sequence(const std::string& dataset,
                                                          const DatasetOptions& options) {
    return load_log(dataset, options);
}

/// Makes the path in a dataset argument of load_log() absolute, so that the argument
/// does not depend on the working directory. Keeps a prefix "kind:".
std::string absolute_dataset(const std::string& dataset);

/// Returns the kind of a dataset, for example "kitti_raw" (docs/datasets.md).
/// @throws DataError if the path is not a dataset of a known kind
std::string detect_kind(const std::filesystem::path& path);

/// Options of save_folder().
struct LogFolderOptions {
    /// True: replaces a log folder, which is kept until the new one is complete.
    bool overwrite = false;
    /// False: no poses are written, for logs that were read without poses (kNoPoses).
    bool poses = true;
    /// If the callback throws an exception, writing stops and leaves no files.
    Progress progress = {};
};
/// Writes a log as a plain folder (kind "folder", docs/datasets.md) that load_log()
/// can read. All rays are preserved bit by bit, including dropped rays and second
/// returns. Times, boxes and notes are preserved too. Poses are preserved to a nanometre.
/// Values that are estimated later, for example the intensity response of beams, are not
/// written. The folder gets its final name only when it is complete.
/// @throws UsageError if the path exists and may not be replaced
/// @throws DataError if the folder cannot be written
void save_folder(const Log& log, const std::filesystem::path& folder, const LogFolderOptions& options = {});

/// Returns true if a folder or file is a log of a known kind.
bool is_dataset(const std::filesystem::path& path);

/// Parameters of a synthetic street with facades, poles, parked cars and moving objects.
/// The scans of the street are computed by exact ray casting.
struct StreetOptions {
    std::uint64_t seed = 1;
    int n_frames = 30;
    int rows = 32;
    int columns = 512;
    double range_noise_m = 0.01;  ///< standard deviation of the range noise
    double speed_mps = 8.0;       ///< speed of the sensor along the street
    bool moving_cars = true;
    /// File with the sensors that record the log. Empty: one sensor with `rows` and
    /// `columns`.
    std::string rig = {};
    /// Adds people and other objects to the street: three pedestrians, a cyclist, cars
    /// parked behind a fence, cars with transparent windows, and bushes.
    bool people = false;
    /// True: pedestrians swing their legs and arms while they walk. The phase of the
    /// motion depends on the walked distance.
    bool gait = false;
};

/// Creates the log of the synthetic street in memory. The scans are ground truth, because
/// they are computed by exact ray casting with a rolling shutter.
Log make_street_log(const StreetOptions& options);

/// Casts rays into the synthetic street, each ray at its own firing time. Returns the
/// exact scan of a novel sensor or pose, without noise. A dropped ray has range 0.
/// @param world_from_sensor  poses of the sensor over time
/// @param time_s  reference time of the scan
Scan cast_street_rays(const StreetOptions& options, const RayTable& rays, const PoseTrack& world_from_sensor,
                      double time_s);

/// Casts beams that have a divergence. Computes up to two returns for each beam, as a
/// dual-return LiDAR does. The first return is the strongest return. The second return is
/// the last return, or the second strongest return if the strongest return is also the
/// last. The function samples each beam with 53 exact rays. Surfaces that are 0.5 m apart
/// give separate returns. A second return needs the power that the sensor detects, as
/// described in docs/method.md.
/// @param rays  at least one ray must have a divergence above 0
/// @param max_range_m  range in the data sheet, at which a surface of 80 % is detected
/// @throws UsageError if no ray has a divergence
Scan cast_street_beams(const StreetOptions& options, const RayTable& rays, const PoseTrack& world_from_sensor,
                       double time_s, double max_range_m);

/// A car of an edited synthetic street. It has the shape of one of the street's original
/// cars and follows a track in relidar's world frame.
struct SyntheticCar {
    std::size_t shapes_of = 0;  ///< id of the original car: BoxTrack::id "0", "1", ...
    /// Track of the car. A sweep contains the car if the track covers the reference time
    /// of the sweep.
    BoxTrack track;
};

/// Casts rays into a street in which `cars` replace all original cars. Returns the exact
/// scan of the edited street.
/// @throws DataError if SyntheticCar::shapes_of is not the id of an original car
Scan cast_street_rays(const StreetOptions& options, const std::vector<SyntheticCar>& cars,
                      const RayTable& rays, const PoseTrack& world_from_sensor, double time_s);

/// Reads the options of a synthetic log that save_street() wrote.
/// @throws DataError naming the key that is wrong
StreetOptions load_street(const std::filesystem::path& folder);

/// Writes a synthetic log as a folder that load_log() can read (kind "synthetic").
/// The folder holds only the options of the street, in `street.toml`.
void save_street(const StreetOptions& options, const std::filesystem::path& folder);

}  // namespace relidar
