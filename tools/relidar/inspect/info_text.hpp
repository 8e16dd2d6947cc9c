// SPDX-License-Identifier: Apache-2.0
// What `relidar info` says of a log or a run, as numbers, for people and as JSON.
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
    std::size_t n_frames = 0;  ///< of the log, in which it is there
    int first_frame = 0, last_frame = 0;
    double path_m = 0.0, mean_speed_mps = 0.0;
    bool moves = false;       ///< see BoxTrack::moves()
    glm::dvec3 start_m{0.0};  ///< box centre when it first appears, the dataset's world
    double start_yaw_deg = 0.0;
    /// of a run: its number in rendered labels; none where it has no surfels of its own
    std::optional<std::size_t> instance;
    std::size_t n_surfels = 0;
    /// of a discovered one: for what kind of thing its size was filled up; empty: as it
    /// was seen
    std::string size_guess;
    std::size_t n_beside = 0;  ///< poses of a labelled one that were discovered before or after its labels
};

struct LidarSummary {
    std::string name, sensor;
    std::size_t n_beams = 0;
    int columns = 0;
    double top_deg = 0.0, bottom_deg = 0.0;
    double period_s = 0.0, max_range_m = 0.0;
    std::size_t n_frames = 0;
    std::size_t n_second_returns = 0;  ///< second, third ... returns of rays that were read
};

struct LogSummary {
    std::string name, source, conventions;
    std::vector<std::string> notes;  ///< what the log lacks
    std::vector<LidarSummary> lidars;
    bool rolling_shutter = false;
    std::size_t n_frames = 0;
    int first_frame = 0, last_frame = 0;
    double seconds = 0.0, path_m = 0.0;
    std::optional<double> returns_share;  ///< none where the scans are not there
    std::size_t n_scans_read = 0;         ///< that it is of
    bool is_look = false;                 ///< others were left out, not without rays
    std::vector<BoxSummary> boxes;
    std::string masked;  ///< moving boxes that become no actor, or have become none
};

/// @param options  say which boxes count as moving, and which of those become actors
LogSummary summarise(const Sequence& sequence, const InitialiseOptions& options);

struct RunSummary {
    LogSummary log;
    std::string preset;
    int iterations = 0;
    std::size_t n_drop_parameters = 0;  ///< of the ray-drop network; 0: there is none
    std::string drop_image = {};        ///< what it looks at
    std::size_t n_surfels = 0;
    Primitive primitive = Primitive::surfel;                  ///< what they are
    std::vector<std::pair<std::string, std::size_t>> models;  ///< name, surfels
    std::size_t n_blocks = 0;                                 ///< of the background; 0: it is in one piece
    std::size_t n_instances = 0;
    std::vector<RunEdit> edits;
    std::size_t n_train = 0;
    std::vector<int> test_frames;
    std::vector<std::pair<std::string, std::uint64_t>> files;  ///< name, bytes
};
RunSummary summarise(const Run& run);

std::string to_text(const LogSummary& log);
std::string to_text(const RunSummary& run);
std::string to_json(const LogSummary& log);
std::string to_json(const RunSummary& run);

}  // namespace relidar::cli
