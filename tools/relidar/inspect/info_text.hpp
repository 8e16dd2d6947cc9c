// SPDX-License-Identifier: Apache-2.0
// Summaries of a log or a run for `relidar info`, as numbers, text and JSON.
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
    std::size_t n_frames = 0;  ///< Number of the log's frames in which the box is present.
    int first_frame = 0, last_frame = 0;
    double path_m = 0.0, mean_speed_mps = 0.0;
    bool moves = false;       ///< See BoxTrack::moves().
    glm::dvec3 start_m{0.0};  ///< Centre of the box when it first appears, in the dataset's world frame.
    double start_yaw_deg = 0.0;
    /// Number of the actor in rendered labels. No value for a log, or if the actor has no
    /// surfels.
    std::optional<std::size_t> instance;
    std::size_t n_surfels = 0;
    /// Only for discovered boxes: the class whose typical size completed the visible
    /// part. Empty if the measured size is used.
    std::string size_guess;
    /// Number of poses discovered before or after the labels of a labelled track.
    std::size_t n_beside = 0;
};

struct LidarSummary {
    std::string name, sensor;
    std::size_t n_beams = 0;
    int columns = 0;
    double top_deg = 0.0, bottom_deg = 0.0;
    double period_s = 0.0, max_range_m = 0.0;
    std::size_t n_frames = 0;
    /// Number of second and further returns in the scans that were read.
    std::size_t n_second_returns = 0;
};

struct LogSummary {
    std::string name, source, conventions;
    std::vector<std::string> notes;  ///< Messages about data that the log lacks.
    std::vector<LidarSummary> lidars;
    bool rolling_shutter = false;
    std::size_t n_frames = 0;
    int first_frame = 0, last_frame = 0;
    double seconds = 0.0, path_m = 0.0;
    std::optional<double> returns_share;  ///< No value if the scans are missing.
    std::size_t n_scans_read = 0;         ///< Number of scans that returns_share is computed from.
    bool is_look = false;                 ///< True if only a sample of the scans was read.
    std::vector<BoxSummary> boxes;
    std::string masked;  ///< Names of moving boxes that are masked out instead of being actors.
};

/// Summarises a log.
/// @param options decides which boxes count as moving, and which moving boxes become
/// actors
LogSummary summarise(const Sequence& sequence, const InitialiseOptions& options);

struct RunSummary {
    LogSummary log;
    std::string preset;
    int iterations = 0;
    /// Number of parameters of the ray-drop network. 0: the run has none.
    std::size_t n_drop_parameters = 0;
    std::string drop_image = {};  ///< Kind of image that the network reads.
    std::size_t n_surfels = 0;
    Primitive primitive = Primitive::surfel;  ///< Kind of the surfels.
    /// Name and number of surfels of each model.
    std::vector<std::pair<std::string, std::size_t>> models;
    /// Number of blocks of the background. 0: the background is stored in one piece.
    std::size_t n_blocks = 0;
    std::size_t n_instances = 0;
    std::vector<RunEdit> edits;
    std::size_t n_train = 0;
    std::vector<int> test_frames;
    std::vector<std::pair<std::string, std::uint64_t>> files;  ///< Name and size in bytes of each file.
};
RunSummary summarise(const Run& run);

std::string to_text(const LogSummary& log);
std::string to_text(const RunSummary& run);
std::string to_json(const LogSummary& log);
std::string to_json(const RunSummary& run);

}  // namespace relidar::cli
