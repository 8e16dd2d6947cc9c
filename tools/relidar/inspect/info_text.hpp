// SPDX-License-Identifier: Apache-2.0
// Summarises a log or a run for `relidar info`, and formats the summary as text and JSON.
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
    /// Position of the box centre when the box first appears. It is given in the world
    /// frame of the dataset.
    glm::dvec3 start_m{0.0};
    double start_yaw_deg = 0.0;
    /// Number of the actor in the instance labels of rendered scans. No value for a log
    /// without a trained scene, or if the actor has no surfels.
    std::optional<std::size_t> instance;
    std::size_t n_surfels = 0;
    /// Class whose typical size was used for a discovered box, because the object was
    /// only partly visible. Empty if the size was measured.
    std::string size_guess;
    /// Number of poses that relidar found in the scans before the first label or after
    /// the last label of a track.
    std::size_t n_unlabelled_frames = 0;
};

struct LidarSummary {
    std::string name, sensor;
    std::size_t n_beams = 0;
    int columns = 0;
    double top_deg = 0.0, bottom_deg = 0.0;
    double period_s = 0.0, max_range_m = 0.0;
    std::size_t n_frames = 0;
    /// Number of second and later returns in the scans that were read. A ray can have
    /// several returns.
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
    /// Share of rays with a return. Has no value if the scans are missing.
    std::optional<double> returns_share;
    std::size_t n_scans_read = 0;  ///< Number of scans from which returns_share is computed.
    bool is_look = false;          ///< True if the summary is based on only some of the scans.
    std::vector<BoxSummary> boxes;
    /// Text that lists the moving boxes without a model. Training ignores the points in
    /// these boxes.
    std::string masked;
};

/// Creates the summary of a log.
/// @param options settings that decide which boxes move and which of them become actors
LogSummary summarise(const LidarSequence& sequence, const SceneInitialisationOptions& options);

/// Sensor that `relidar render` simulates for a LiDAR if no other sensor is selected.
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
    /// Number of parameters of the ray-drop network. The value is 0 if the run has no
    /// network.
    std::size_t n_drop_parameters = 0;
    std::string drop_image = {};  ///< Kind of image that the ray-drop network reads.
    std::size_t n_surfels = 0;
    PrimitiveType primitive = PrimitiveType::surfel;  ///< Shape of the surfels.
    /// Name and number of surfels of each model.
    std::vector<std::pair<std::string, std::size_t>> models;
    /// Number of blocks into which the background is divided. The value is 0 if the
    /// background is not divided.
    std::size_t n_blocks = 0;
    std::size_t n_instances = 0;
    std::vector<EditHistoryEntry> edits;
    std::size_t n_train = 0;
    std::vector<int> test_frames;
    std::vector<std::pair<std::string, std::uint64_t>> files;  ///< Name and size in bytes of each file.
};
RunSummary summarise(const TrainedRun& run);

std::string format_summary_as_text(const LogSummary& log);
std::string format_summary_as_text(const RunSummary& run);
std::string format_summary_as_json(const LogSummary& log);
std::string format_summary_as_json(const RunSummary& run);

}  // namespace relidar::cli
