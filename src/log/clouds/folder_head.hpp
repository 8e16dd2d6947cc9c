// SPDX-License-Identifier: Apache-2.0
// The parts of a plain folder, each checked while read; docs/datasets.md has the format.
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
inline constexpr std::size_t kLongestName = 200, kLongestText = 10000, kLongestPath = 255;  // bytes

/// What numbers of points mean.
struct PointUnits {
    std::vector<std::string> columns;     ///< of .bin and .npy; empty: x y z intensity
    std::optional<double> intensity_max;  ///< what is bright; not given: 1, and nothing may be brighter
    double time_unit_s = 1.0;
    bool absolute_times = false;  ///< of points: of the log, not from their frame's time
    double time_zero = 0.0;       ///< what counts as 0 s, in units of the points' times
};

/// A LiDAR as sequence.json has it.
struct HeadLidar {
    Lidar lidar;
    bool has_beams = false;  ///< they are given, or known by the sensor's name
    bool spins = true;       ///< whether beams may be looked for where none are given
    /// nobody could say that it does not spin: points that fit no head are no error
    bool is_guessed = false;
    bool lowest_first = false;  ///< how scans count their rings
    /// how long a sweep takes, where points do not say it; 0: from one frame to the next
    double turn_s = 0.0;
    std::string scans;  ///< folder, where no frames are listed
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
    std::vector<HeadFrame> frames;  ///< all, by time and LiDAR
    bool motion_compensated = false;
    PointUnits units;
    std::optional<glm::dvec3> world_offset_m;
};

/// sequence.json, and the scans where it lists none. @param max_range_m  of sensors that
/// give none
Head read_head(const std::filesystem::path& folder, double max_range_m);

/// world_from_vehicle of the frames; nothing where the file is missing. 12 numbers a
/// line: row-major 3x4, line i for frame number i. 8 numbers a line: time_s x y z qw qx
/// qy qz, interpolated.
std::optional<std::vector<Pose>> read_poses(const std::filesystem::path& file,
                                            const std::vector<HeadFrame>& frames);

/// Boxes of boxes.json, none without that file. Labels outside the time of the frames are
/// left out where the log goes on there.
/// @param all  frames of the log, which labels may name by number
std::vector<BoxTrack> read_boxes(const std::filesystem::path& file, const std::vector<HeadFrame>& frames,
                                 const std::vector<HeadFrame>& all);

/// Reads the scans of sequence.frames, which has its poses, and completes the sensors of
/// LiDARs whose beams are found from the points. Without poses (options.poses_file is
/// kNoPoses) motion compensation cannot be undone. @param files  [frames]
void read_scans(Sequence& sequence, const Head& head, const std::vector<std::filesystem::path>& files,
                const DatasetOptions& options);

}  // namespace relidar::folder
