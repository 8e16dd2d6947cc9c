// SPDX-License-Identifier: Apache-2.0
#include "info_text.hpp"

#include <algorithm>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "console.hpp"

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

double path_length_m(const PoseTrack& track) {
    double length = 0.0;
    for (std::size_t i = 1; i < track.pose.size(); ++i) length += glm::length(track.pose[i].translation - track.pose[i - 1].translation);
    return length;
}

std::optional<double> returns_share(const Sequence& sequence) {
    std::size_t n_returns = 0, n_rays = 0;
    for (const Frame& frame : sequence.frames) {
        n_returns += frame.scan.count_returns();
        n_rays += frame.scan.range_m.size();
    }
    if (n_rays == 0) return std::nullopt;
    return static_cast<double>(n_returns) / static_cast<double>(n_rays);
}

std::string line(const std::string& name, const std::string& value) { return value.empty() ? "" : fmt::format("{:<12}{}\n", name, value); }

std::string box_table(const std::vector<BoxSummary>& boxes) {
    if (boxes.empty()) return "";
    std::vector<std::vector<std::string>> rows{{"box", "class", "length", "width", "height", "frames", "path", "motion"}};
    for (const BoxSummary& b : boxes) {
        rows.push_back({b.id, b.category, fmt::format("{:.2f} m", b.size_m.x), fmt::format("{:.2f} m", b.size_m.y), fmt::format("{:.2f} m", b.size_m.z),
                        fmt::format("{}", b.n_frames), fmt::format("{:.1f} m", b.path_m), b.moves ? "moving" : "still"});
    }
    return "\n" + table(rows);
}

Json json_of(const LogSummary& log) {
    Json boxes = Json::array();
    for (const BoxSummary& b : log.boxes) {
        boxes.push_back({{"id", b.id}, {"category", b.category}, {"size_m", {b.size_m.x, b.size_m.y, b.size_m.z}}, {"frames", b.n_frames}, {"path_m", b.path_m}, {"moving", b.moves}});
    }
    Json json = {{"name", log.name}, {"source", log.source}, {"conventions", log.conventions},
                 {"sensor", {{"name", log.sensor}, {"rows", log.n_beams}, {"columns", log.columns}, {"top_deg", log.top_deg}, {"bottom_deg", log.bottom_deg},
                             {"period_s", log.period_s}, {"max_range_m", log.max_range_m}}},
                 {"rolling_shutter", log.rolling_shutter}, {"frames", log.n_frames}, {"first_frame", log.first_frame}, {"last_frame", log.last_frame},
                 {"seconds", log.seconds}, {"path_m", log.path_m}, {"returns_share", nullptr}, {"boxes", boxes}};
    if (log.returns_share) json["returns_share"] = *log.returns_share;
    return json;
}

std::string dumped(const Json& json) { return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n"; }

}  // namespace

LogSummary summarise(const Sequence& sequence, double min_step_m) {
    LogSummary log;
    log.name = sequence.name;
    log.source = sequence.source;
    log.conventions = sequence.conventions;
    log.sensor = sequence.sensor.name;
    log.n_beams = sequence.sensor.beams.size();
    log.columns = sequence.sensor.columns;
    const auto lower = [](const Beam& a, const Beam& b) { return a.elevation_rad < b.elevation_rad; };
    const auto [low, high] = std::minmax_element(sequence.sensor.beams.begin(), sequence.sensor.beams.end(), lower);
    if (low != sequence.sensor.beams.end()) log.bottom_deg = low->elevation_rad * 180.0 / kPi, log.top_deg = high->elevation_rad * 180.0 / kPi;
    log.period_s = sequence.sensor.period_s;
    log.max_range_m = sequence.sensor.max_range_m;
    log.rolling_shutter = sequence.rolling_shutter;
    log.n_frames = sequence.frames.size();
    if (!sequence.frames.empty()) {
        log.first_frame = sequence.frames.front().index;
        log.last_frame = sequence.frames.back().index;
        log.seconds = sequence.frames.back().time_s - sequence.frames.front().time_s;
    }
    log.path_m = path_length_m(sequence.world_from_sensor);
    log.returns_share = returns_share(sequence);
    for (const BoxTrack& box : sequence.boxes) {
        log.boxes.push_back({box.id, box.category, box.size_m, box.world_from_box.time_s.size(), path_length_m(box.world_from_box), box.mean_step_m() > min_step_m});
    }
    return log;
}

RunSummary summarise(const Run& run) {
    RunSummary summary;
    summary.log = summarise(run.sequence, run.config.init.actor_min_step_m);
    summary.preset = run.config.preset;
    summary.iterations = run.config.train.iterations;
    summary.n_surfels = run.scene.surfels.size();
    for (const Model& model : run.scene.models) summary.models.emplace_back(model.name, model.count);
    summary.n_train = run.split.train.size();
    for (const int position : run.split.test) summary.test_frames.push_back(run.sequence.frames[static_cast<std::size_t>(position)].index);
    for (const auto& entry : std::filesystem::directory_iterator(run.folder)) {
        if (entry.is_regular_file()) summary.files.emplace_back(entry.path().filename().string(), entry.file_size());
    }
    std::sort(summary.files.begin(), summary.files.end());
    return summary;
}

std::string to_text(const LogSummary& log) {
    std::string text = line("log", log.name) + line("source", log.source) + line("conventions", log.conventions);
    text += line("sensor", fmt::format("{}: {} rows x {} columns, {:+.2f} to {:+.2f} degrees, {:.3g} s a turn, {:.4g} m{}", log.sensor, log.n_beams, log.columns, log.top_deg,
                                       log.bottom_deg, log.period_s, log.max_range_m, log.rolling_shutter ? ", rolling shutter" : ""));
    text += line("frames", fmt::format("{} ({} to {}), {:.1f} s, {:.1f} m driven", log.n_frames, log.first_frame, log.last_frame, log.seconds, log.path_m));
    if (log.returns_share) text += line("returns", fmt::format("{:.1f} % of all rays", 100.0 * *log.returns_share));
    const auto moving = std::count_if(log.boxes.begin(), log.boxes.end(), [](const BoxSummary& b) { return b.moves; });
    text += line("boxes", fmt::format("{}, {} of them moving", log.boxes.size(), moving));
    return text + box_table(log.boxes);
}

std::string to_text(const RunSummary& run) {
    std::string text = line("surfels", fmt::format("{}", run.n_surfels));
    for (const auto& [name, count] : run.models) text += line("  model", fmt::format("{}: {} surfels", name, count));
    text += line("settings", fmt::format("preset {}, {} iterations", run.preset, run.iterations));
    text += line("split", fmt::format("{} training frames, {} test frames ({})", run.n_train, run.test_frames.size(), fmt::join(run.test_frames, ", ")));
    std::vector<std::vector<std::string>> rows{{"file", "size"}};
    for (const auto& [name, size] : run.files) rows.push_back({name, byte_size(size)});
    return text + to_text(run.log) + "\n" + table(rows);
}

std::string to_json(const LogSummary& log) { return dumped(json_of(log)); }

std::string to_json(const RunSummary& run) {
    Json json = {{"preset", run.preset}, {"iterations", run.iterations}, {"surfels", run.n_surfels}, {"models", Json::array()},
                 {"train_frames", run.n_train}, {"test_frames", run.test_frames}, {"files", Json::object()}, {"log", json_of(run.log)}};
    for (const auto& [name, count] : run.models) json["models"].push_back({{"name", name}, {"surfels", count}});
    for (const auto& [name, size] : run.files) json["files"][name] = size;
    return dumped(json);
}

}  // namespace relidar::cli
