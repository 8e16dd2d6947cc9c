// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <relidar/run/run.hpp>

namespace relidar::cli {

struct BoxSummary {
    std::string id, category;
    glm::dvec3 size_m{0.0};
    std::size_t n_frames = 0;  ///< Number of frames of the log in which the box is present.
    int first_frame = 0, last_frame = 0;
    double path_m = 0.0, mean_speed_mps = 0.0;
    bool moves = false;  ///< See BoxTrack::is_moving().
    /// centre when the box first appears, in the dataset's world frame
    glm::dvec3 start_m{0.0};
    double start_yaw_deg = 0.0;
    /// in the instance labels of rendered scans; no value without surfels
    std::optional<std::size_t> instance;
    std::size_t n_surfels = 0;
    /// class whose typical size the box has; empty if the size was measured
    std::string size_guess;
    /// poses found before the first or after the last label of a track
    std::size_t n_unlabelled_frames = 0;
};

struct LidarSummary {
    std::string name, sensor;
    std::size_t n_beams = 0;
    int columns = 0;
    double top_deg = 0.0, bottom_deg = 0.0;
    double period_s = 0.0, max_range_m = 0.0;
    std::size_t n_frames = 0;
    std::size_t n_second_returns = 0;
};

struct LogSummary {
    std::string name, source, conventions;
    std::vector<std::string> notes;  ///< Notes about data that are missing in the log.
    std::vector<LidarSummary> lidars;
    bool rolling_shutter = false;
    std::size_t n_frames = 0;
    int first_frame = 0, last_frame = 0;
    double seconds = 0.0, path_m = 0.0;
    /// no value if the scans are missing
    std::optional<double> returns_share;
    std::size_t n_scans_read = 0;  ///< Number of scans from which returns_share is computed.
    bool is_look = false;          ///< True if the summary is based on only some of the scans.
    std::vector<BoxSummary> boxes;
    /// moving boxes without a model, whose points training ignores
    std::string masked;
};

LogSummary summarise(const Log& sequence, const InitOptions& options);

struct RenderedSensorSummary {
    std::string name;
    int rows = 0, columns = 0;  ///< Size of the range image. 0 if the rays differ from scan to scan.
    double max_range_m = 0.0;
};

struct RunSummary {
    LogSummary log;
    std::vector<RenderedSensorSummary> rendered_sensors;  ///< for each LiDAR of the log
    std::string preset;
    int iterations = 0;
    std::size_t n_drop_parameters = 0;
    std::string drop_image = {};  ///< Kind of image that the ray-drop network reads.
    std::size_t n_surfels = 0;
    PrimitiveType primitive = PrimitiveType::surfel;  ///< Shape of the surfels.
    std::vector<std::pair<std::string, std::size_t>> models;
    /// of the background; 0 if it is not divided
    std::size_t n_blocks = 0;
    std::size_t n_instances = 0;
    std::vector<EditHistoryEntry> edits;
    std::size_t n_train = 0;
    std::vector<int> test_frames;
    std::vector<std::pair<std::string, std::uint64_t>> files;  ///< Name and size in bytes of each file.
};
RunSummary summarise(const Run& run);

std::string format_as_text(const LogSummary& log);
std::string format_as_text(const RunSummary& run);
std::string format_as_json(const LogSummary& log);
std::string format_as_json(const RunSummary& run);

}  // namespace relidar::cli
