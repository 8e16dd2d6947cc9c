// SPDX-License-Identifier: Apache-2.0
// Reads and checks the files of a plain folder. docs/datasets.md describes the format.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <relidar/log/clouds.hpp>
#include <relidar/log/dataset.hpp>

#include "log/clouds/pose_conventions.hpp"

namespace relidar::folder {

inline constexpr const char* kHeadFile = "sequence.json";
inline constexpr const char* kPosesFile = "poses.txt";
inline constexpr const char* kBoxesFile = "boxes.json";
inline constexpr const char* kFormat = "relidar log";
inline constexpr int kVersion = 1;
// limits of texts, in bytes
inline constexpr std::size_t kLongestName = 200, kLongestText = 10000, kLongestPath = 255;

/// Units and meaning of the point values in scan files.
struct PointUnits {
    /// names of the columns in .bin and .npy files; empty: x y z intensity
    std::vector<std::string> columns;
    /// Intensity that is scaled to 1. If not set, intensities are not scaled, and an
    /// intensity above 1 is an error.
    std::optional<double> intensity_max;
    double time_unit_s = 1.0;
    /// true: point times are times of the log; false: point times are relative to the
    /// time of the frame
    bool absolute_times = false;
    /// name of the field with the intensities; empty: the first field that may have them
    std::string intensity_field = {};
    /// Position that marks a ray without a return, in addition to those that is_return()
    /// rejects.
    std::optional<glm::vec3> no_return = {};
    double time_zero = 0.0;  ///< point time that corresponds to 0 s, in the time unit of the file
};

/// A LiDAR that sequence.json describes.
struct HeadLidar {
    Lidar lidar;
    bool has_beams = false;  ///< true: the beams are listed, or known from the sensor's name
    bool spins = true;       ///< true: the LiDAR spins, so that unknown beams may be estimated from points
    /// True: it is unknown whether the LiDAR spins. So points that do not fit a spinning
    /// head are not an error.
    bool is_guessed = false;
    bool lowest_first = false;  ///< true: ring 0 of the scans is the lowest beam
    /// Duration of a sweep in seconds, used if points have no times. 0: the time between
    /// frames is used.
    double turn_s = 0.0;
    std::string scans;  ///< folder with the scans; used if sequence.json lists no frames
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

/// Reads sequence.json. If the file does not list the scans, lists the files in the scan
/// folders.
/// @param max_range_m  maximum range of sensors that state none
Head read_head(const std::filesystem::path& folder, double max_range_m);

/// Reads the vehicle poses at the frames. Returns nothing if the file does not exist. A
/// line with 12 numbers is a 3x4 matrix, row-major, and line i belongs to frame number i.
/// A line with 8 numbers is time_s x y z qw qx qy qz, and a line with 7 numbers is time_s
/// x y z roll pitch yaw. Such poses are interpolated at the times of the frames. If the
/// vehicle then does not drive forward, the numbers may have another meaning
/// (choose_reading()).
/// @param read_pairs  reads scans that confirm the meaning; may be null
std::optional<std::vector<Pose>> read_poses(const std::filesystem::path& file,
                                            const std::vector<HeadFrame>& frames, const ReadPairs& read_pairs,
                                            std::vector<std::string>& notes);

/// Reads the boxes from boxes.json. Returns none if the file does not exist. If only a
/// range of the log's frames is read, labels outside its time are ignored.
/// @param all  all frames of the log; labels can refer to them by number
std::vector<BoxTrack> read_boxes(const std::filesystem::path& file, const std::vector<HeadFrame>& frames,
                                 const std::vector<HeadFrame>& all);

/// Reads the scans of sequence.frames. The frames must already have poses. If the beams
/// of a LiDAR are unknown, estimates them from the points. Motion compensation can be
/// undone only if the log has poses (options.poses_file is not kNoPoses).
/// @param files  [frames] scan file of each frame
void read_scans(Sequence& sequence, const Head& head, const std::vector<std::filesystem::path>& files,
                const DatasetOptions& options);

}  // namespace relidar::folder
