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
    const BoxTrack& box;
    std::size_t n_frames = 0;  ///< Number of frames of the log in which the box is present.
    int first_frame = 0, last_frame = 0;
    double path_m = 0.0, mean_speed_mps = 0.0;
    /// centre when the box first appears, in the dataset's world frame
    glm::dvec3 start_m{0.0};
    double start_yaw_deg = 0.0;
    /// in the instance labels of rendered scans; no value without surfels
    std::optional<std::size_t> instance = {};
    std::size_t n_surfels = 0;
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

/// What info says of a log, in addition to its members.
struct LogSummary {
    const Log& log;
    std::vector<std::string> notes;
    std::vector<LidarSummary> lidars = {};
    double path_m = 0.0;
    /// no value if the scans are missing
    std::optional<double> returns_share = {};
    std::size_t n_scans_read = 0;  ///< Number of scans from which returns_share is computed.
    bool is_sample = false;        ///< True if the summary is based on only some of the scans.
    std::vector<BoxSummary> boxes = {};
    /// moving boxes without a model, whose points training ignores
    std::string masked = {};
};

/// Summarises a log for `relidar info`.
/// @param options which moving objects get a model
LogSummary summarise_log(const Log& log, const InitOptions& options);

struct RenderedSensorSummary {
    std::string name;
    int rows = 0, columns = 0;  ///< Size of the range image. 0 if the rays differ from scan to scan.
    double max_range_m = 0.0;
};

/// What info says of a run, in addition to its members.
struct RunSummary {
    const Run& run;
    LogSummary log;
    std::vector<RenderedSensorSummary> rendered_sensors = {};      ///< for each LiDAR of the log
    std::vector<std::pair<std::string, std::size_t>> models = {};  ///< Name and number of surfels.
    std::vector<int> test_frames = {};
    std::vector<std::pair<std::string, std::uint64_t>> files = {};  ///< Name and size in bytes of each file.
};
/// Summarises a run and its log for `relidar info`.
RunSummary summarise_run(const Run& run);

// What `relidar info` prints, as lines of text or, with --json, as JSON.
std::string format_as_text(const LogSummary& log);
std::string format_as_text(const RunSummary& run);
std::string format_as_json(const LogSummary& log);
std::string format_as_json(const RunSummary& run);

}  // namespace relidar::cli
