// SPDX-License-Identifier: Apache-2.0
// Readers for the files of a plain folder, which check what they read. docs/datasets.md
// describes the format.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>
#include <relidar/log/dataset.hpp>

namespace relidar::folder {

inline constexpr const char* kHeadFile = "sequence.json";
inline constexpr const char* kPosesFile = "poses.txt";
inline constexpr const char* kBoxesFile = "boxes.json";
inline constexpr const char* kFormat = "relidar log";
inline constexpr int kVersion = 1;
// limits of texts, in bytes
inline constexpr std::size_t kLongestName = 200, kLongestText = 10000, kLongestPath = 255;

/// Units of point values.
struct PointUnits {
    std::vector<std::string> columns;  ///< columns of .bin and .npy; empty: x y z intensity
    /// intensity that counts as 1; if not set: 1, and larger intensities are errors
    std::optional<double> intensity_max;
    double time_unit_s = 1.0;
    /// true: point times are times of the log; false: they are relative to the frame's
    /// time
    bool absolute_times = false;
    double time_zero = 0.0;  ///< point time that is 0 s, in the unit of the points' times
};

/// A LiDAR in sequence.json.
struct HeadLidar {
    Lidar lidar;
    bool has_beams = false;  ///< the beams are given, or known from the sensor's name
    bool spins = true;       ///< true: beams may be estimated if none are given
    /// True: it is unknown whether the LiDAR spins, so points that do not fit a spinning
    /// head are not an error.
    bool is_guessed = false;
    bool lowest_first = false;  ///< true: ring 0 of the scans is the lowest beam
    /// Duration of a sweep if points have no times. 0: the time between frames.
    double turn_s = 0.0;
    std::string scans;  ///< folder of scans, if no frames are listed
};

struct HeadFrame {
    int number = 0;
    double time_s = 0.0;
    int lidar = 0;
    std::filesystem::path scan;
};

struct Head {
    std::string name, conventions;
    std::vector<std::string> notes;
    std::vector<HeadLidar> lidars;
    std::vector<HeadFrame> frames;  ///< all frames, sorted by time and LiDAR
    bool motion_compensated = false;
    PointUnits units;
    std::optional<glm::dvec3> world_offset_m;
};

/// Reads sequence.json, and lists the scans if it does not.
/// @param max_range_m  range limit of sensors without one
Head read_head(const std::filesystem::path& folder, double max_range_m);

/// Reads world_from_vehicle of the frames, or returns nothing if the file does not exist.
/// Lines with 12 numbers are 3x4 matrices, row-major, with line i for frame number i.
/// Lines with 8 numbers are time_s x y z qw qx qy qz, which are interpolated.
std::optional<std::vector<Pose>> read_poses(const std::filesystem::path& file,
                                            const std::vector<HeadFrame>& frames);

/// Reads the boxes of boxes.json, or none without this file. Ignores labels outside the
/// time of the frames if the log continues there.
/// @param all  all frames of the log, to which labels may refer by number
std::vector<BoxTrack> read_boxes(const std::filesystem::path& file, const std::vector<HeadFrame>& frames,
                                 const std::vector<HeadFrame>& all);

/// Reads the scans of sequence.frames, whose poses are set, and completes the sensors of
/// LiDARs whose beams are estimated from the points. Without poses (options.poses_file is
/// kNoPoses), motion compensation cannot be undone.
/// @param files  [frames]
void read_scans(Sequence& sequence, const Head& head, const std::vector<std::filesystem::path>& files,
                const DatasetOptions& options);

}  // namespace relidar::folder
