// SPDX-License-Identifier: Apache-2.0
#include "inspect/info_text.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/log/checks.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/render.hpp>

#include "console.hpp"

namespace relidar::cli {
namespace {

using Json = nlohmann::ordered_json;

double path_length_m(const PoseTrack& track) {
    double length = 0.0;
    for (std::size_t i = 1; i < track.pose.size(); ++i)
        length += glm::length(track.pose[i].translation - track.pose[i - 1].translation);
    return length;
}

std::optional<double> return_share(const Log& log) {
    std::size_t n_returns = 0, n_rays = 0;
    for (const Frame& frame : log.frames) {
        n_returns += frame.scan.count_returns();
        n_rays += frame.scan.range_m.size();
    }
    if (n_rays == 0) return std::nullopt;
    return static_cast<double>(n_returns) / static_cast<double>(n_rays);
}

double duration_s(const Log& log) { return log.frames.back().time_s - log.frames.front().time_s; }

std::string format_line(const std::string& value_name, const std::string& value) {
    return value.empty() ? "" : fmt::format("{:<12}{}\n", value_name, value);
}

/// Names boxes with guessed sizes, and boxes that were found beyond their labels.
std::string box_notes(const std::vector<BoxSummary>& boxes) {
    std::vector<std::string> guesses, continued;
    for (const BoxSummary& b : boxes) {
        if (!b.box.size_guess.empty()) guesses.push_back(b.box.id);
        if (const std::size_t n = b.box.n_before + b.box.n_after; n > 0)
            continued.push_back(fmt::format("{} ({} frames)", b.box.id, n));
    }
    std::string text;
    if (!guesses.empty())
        text += fmt::format(
            "Tracks whose size is estimated from their class, because only one side of the object was "
            "observed: {}\n",
            fmt::join(guesses, ", "));
    if (!continued.empty())
        text += fmt::format("Tracks that were extended to frames without labels: {}\n",
                            fmt::join(continued, ", "));
    return text;
}

/// Returns a table of boxes, or an empty text if there are none.
/// @param show_instance_columns for a run: also the number and surfels of each actor
std::string box_table(const std::vector<BoxSummary>& boxes, bool show_instance_columns) {
    if (boxes.empty()) return "";
    TableRows rows{{"track", "class", "length", "width", "height", "frames", "path length", "mean speed",
                    "start x,y,z,yaw_deg"}};
    if (show_instance_columns) rows[0].insert(rows[0].end(), {"instance", "surfels"});
    for (const BoxSummary& summary : boxes) {
        const BoxTrack& box = summary.box;
        const glm::dvec3& start_m = summary.start_m;
        std::string box_class = name_of(class_of(box));
        if (is_discovered(box)) box_class += " (discovered)";
        else if (box_class != box.category) box_class += fmt::format(" ({})", box.category);
        if (!box.size_guess.empty()) box_class += fmt::format(", {}?", box.size_guess);
        rows.push_back({box.id, box_class});
        for (const int axis : {0, 1, 2}) rows.back().push_back(fmt::format("{:.2f} m", box.size_m[axis]));
        rows.back().push_back(summary.n_frames ? fmt::format("{}-{}", summary.first_frame, summary.last_frame)
                                               : "none");
        rows.back().push_back(fmt::format("{:.1f} m", summary.path_m));
        rows.back().push_back(box.is_moving() ? fmt::format("{:.1f} m/s", summary.mean_speed_mps) : "parked");
        rows.back().push_back(fmt::format("{:.2f},{:.2f},{:.2f},{:.1f}", start_m.x, start_m.y, start_m.z,
                                          summary.start_yaw_deg));
        if (!show_instance_columns) continue;
        // An object without a model has no instance.
        rows.back().push_back(summary.instance ? fmt::format("{}", *summary.instance) : "-");
        rows.back().push_back(summary.instance ? fmt::format("{}", summary.n_surfels) : "-");
    }
    std::string text = "\n" + format_table(rows) + box_notes(boxes);
    std::vector<std::string> editable;
    for (const BoxSummary& summary : boxes)
        if (summary.instance || !summary.box.is_moving()) editable.push_back(summary.box.id);
    if (show_instance_columns && !editable.empty())
        text += fmt::format("Tracks that `relidar edit` can change: {}\n", fmt::join(editable, ", "));
    return text;
}

/// Returns a table of the conventions with which a log was read, or an empty text.
std::string convention_table(const std::vector<UsedConvention>& conventions) {
    if (conventions.empty()) return "";
    TableRows rows{{"convention", "value", "change with", "from"}};
    for (const UsedConvention& used : conventions)
        rows.push_back({used.name, used.value, used.setting, used.from});
    return "\n" + format_table(rows);
}

/// Returns the summary of a box for `relidar info --json`.
Json summary_json(const BoxSummary& summary) {
    const BoxTrack& box = summary.box;
    Json json = {{"id", box.id},
                 {"class", name_of(class_of(box))},
                 {"label", label_of(box)},
                 {"is_discovered", is_discovered(box)},
                 {"size_m", {box.size_m.x, box.size_m.y, box.size_m.z}},
                 {"frames", summary.n_frames},
                 {"first_frame", summary.first_frame},
                 {"last_frame", summary.last_frame},
                 {"path_m", summary.path_m},
                 {"mean_speed_mps", summary.mean_speed_mps},
                 {"moving", box.is_moving()},
                 {"start_m", {summary.start_m.x, summary.start_m.y, summary.start_m.z}},
                 {"start_yaw_deg", summary.start_yaw_deg},
                 {"instance", nullptr},
                 {"surfels", summary.n_surfels}};
    if (summary.instance) json["instance"] = *summary.instance;
    if (!box.size_guess.empty()) json["size_guess"] = box.size_guess;
    const std::size_t n_unlabelled_frames = box.n_before + box.n_after;
    if (n_unlabelled_frames > 0) json["beside_labels"] = n_unlabelled_frames;
    return json;
}

Json summary_json(const LidarSummary& summary) {
    return {{"name", summary.name},         {"sensor", summary.sensor},
            {"rows", summary.n_beams},      {"columns", summary.columns},
            {"top_deg", summary.top_deg},   {"bottom_deg", summary.bottom_deg},
            {"period_s", summary.period_s}, {"max_range_m", summary.max_range_m},
            {"frames", summary.n_frames},   {"second_returns", summary.n_second_returns}};
}

Json summary_json(const std::optional<Georeference>& place) {
    if (!place) return {};
    return {{"latitude_deg", place->position.latitude_deg},
            {"longitude_deg", place->position.longitude_deg},
            {"height_m", place->position.height_m},
            {"world_point_m", {place->point_m.x, place->point_m.y, place->point_m.z}},
            {"crs", place->crs},
            {"rotation", {place->rotation.w, place->rotation.x, place->rotation.y, place->rotation.z}}};
}

/// Returns the summary of a log for `relidar info --json`.
Json summary_json(const LogSummary& summary) {
    Json boxes = Json::array(), lidars = Json::array(), cameras = Json::array();
    for (const BoxSummary& box : summary.boxes) boxes.push_back(summary_json(box));
    for (const LidarSummary& lidar : summary.lidars) lidars.push_back(summary_json(lidar));
    const Log& log = summary.log;
    for (const Camera& camera : log.cameras)
        cameras.push_back({{"name", camera.name}, {"columns", camera.columns}, {"rows", camera.rows}});
    Json conventions = Json::array();
    for (const UsedConvention& used : log.conventions_used)
        conventions.push_back(
            {{"name", used.name}, {"value", used.value}, {"from", used.from}, {"setting", used.setting}});
    Json json = {{"name", log.name},
                 {"source", log.source},
                 {"conventions", log.conventions},
                 {"conventions_used", conventions},
                 {"notes", summary.notes},
                 {"lidars", lidars},
                 {"cameras", cameras},
                 {"rolling_shutter", log.rolling_shutter},
                 {"frames", log.frames.size()},
                 {"first_frame", log.frames.front().index},
                 {"last_frame", log.frames.back().index},
                 {"seconds", duration_s(log)},
                 {"path_m", summary.path_m},
                 {"georeference", summary_json(log.georeference)},
                 {"returns_share", nullptr},
                 {"boxes", boxes},
                 {"labelled_azimuth_rad", nullptr},
                 {"masked", summary.masked}};
    if (const auto& azimuths = log.labelled_azimuth)
        json["labelled_azimuth_rad"] = {azimuths->right_rad, azimuths->left_rad};
    if (summary.returns_share) {
        json["returns_share"] = *summary.returns_share;
        json["scans_read"] = summary.n_scans_read;
    }
    return json;
}

std::string dump_json(const Json& json) {
    return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

/// Summarises a box: when it is present, where it starts, how far and fast it moves.
BoxSummary summarise_box(const Log& log, const BoxTrack& box) {
    BoxSummary summary{box};
    for (const Frame& frame : log.frames) {
        if (!box.is_observed(frame.time_s)) continue;
        if (summary.n_frames == 0) summary.first_frame = frame.index;
        summary.last_frame = frame.index;
        ++summary.n_frames;
    }
    const PoseTrack& track = box.world_from_box;
    summary.path_m = path_length_m(track);
    if (track.pose.empty()) return summary;
    const double seconds = track.time_s.back() - track.time_s.front();
    summary.mean_speed_mps = seconds > 0.0 ? summary.path_m / seconds : 0.0;
    // The yaw angle is the direction of the x axis in the first pose.
    const glm::dvec3 forward = track.pose.front().rotation * glm::dvec3(1, 0, 0);
    summary.start_m = track.pose.front().translation + log.world_offset_m;
    summary.start_yaw_deg = std::atan2(forward.y, forward.x) * 180.0 / kPi;
    return summary;
}

/// Summarises a LiDAR of a log: its pattern of rays and its numbers of scans and returns.
LidarSummary summarise_lidar(const Log& log, int lidar_index) {
    const Lidar& lidar = log.lidars[std::size_t(lidar_index)];
    const SpinningSensor& sensor = lidar.sensor;
    LidarSummary summary;
    summary.name = lidar.name;
    summary.sensor = sensor.name;
    summary.max_range_m = sensor.max_range_m;
    if (lidar.pattern) {
        // A sensor that does not spin has no beam table, so its nominal rays are used.
        const RayTable rays = make_lidar_rays(lidar, 0.0);
        const auto [lowest, highest] = std::ranges::minmax(rays.direction, {}, &glm::vec3::z);
        summary.n_beams = std::size_t(rays.rows);
        summary.columns = rays.columns;
        summary.period_s = lidar.sweep_period_s();
        summary.bottom_deg = std::asin(double(lowest.z)) * 180.0 / kPi;
        summary.top_deg = std::asin(double(highest.z)) * 180.0 / kPi;
    } else {
        summary.n_beams = sensor.beams.size();
        summary.columns = sensor.columns;
        summary.period_s = sensor.period_s;
        if (!sensor.beams.empty()) {
            const auto [lowest, highest] = std::ranges::minmax(sensor.beams, {}, &Beam::elevation_rad);
            summary.bottom_deg = lowest.elevation_rad * 180.0 / kPi;
            summary.top_deg = highest.elevation_rad * 180.0 / kPi;
        }
    }
    for (const Frame& frame : log.frames) {
        if (frame.lidar != lidar_index) continue;
        ++summary.n_frames;
        for (const AdditionalReturns& second : frame.scan.second_returns)
            summary.n_second_returns += std::size_t(
                std::ranges::count_if(second.range_m, [](float range_m) { return range_m > 0.0f; }));
    }
    return summary;
}

/// Returns a LiDAR as one line. A single LiDAR may have no name.
std::string summary_text(const LidarSummary& summary) {
    const std::string name =
        summary.name.empty() ? "" : fmt::format("{}, {} frames, ", summary.name, summary.n_frames);
    const std::string second_returns =
        summary.n_second_returns == 0 ? "" : fmt::format(", {} second returns", summary.n_second_returns);
    if (summary.n_beams == 0)
        return fmt::format("{}{}: unknown beams, range up to {:.4g} m{}", name, summary.sensor,
                           summary.max_range_m, second_returns);
    return fmt::format(
        "{}{}: {} rows x {} columns, {:+.2f} to {:+.2f} degrees, {:.3g} s per sweep, range up to {:.4g} m{}",
        name, summary.sensor, summary.n_beams, summary.columns, summary.top_deg, summary.bottom_deg,
        summary.period_s, summary.max_range_m, second_returns);
}

/// Returns the place of the dataset's world on the earth, or an empty text.
std::string describe_place(const std::optional<Georeference>& place) {
    if (!place) return "";
    const double turn_deg = 2.0 * std::acos(std::min(std::abs(place->rotation.w), 1.0)) * 180.0 / kPi;
    return fmt::format(
        "the world's point {:.2f},{:.2f},{:.2f} is at latitude {:.7f}, longitude {:.7f}, height {:.2f} m; "
        "{}{}",
        place->point_m.x, place->point_m.y, place->point_m.z, place->position.latitude_deg,
        place->position.longitude_deg, place->position.height_m, place->crs,
        turn_deg > 0.0 ? fmt::format(", turned by {:.2f} degrees", turn_deg) : "");
}

double view_angle_deg(const Camera& camera) {
    const double left_px = camera.centre_x_px + 0.5, right_px = camera.columns - left_px;
    return (std::atan(left_px / camera.focal_x_px) + std::atan(right_px / camera.focal_x_px)) * 180.0 / kPi;
}

/// Returns the summary of a log as lines "name  value", followed by the table of boxes.
std::string summary_text(const LogSummary& summary, bool show_instance_columns) {
    const Log& log = summary.log;
    std::string text = format_line("log", log.name) + format_line("source", log.source) +
                       format_line("conventions", log.conventions);
    for (const std::string& note : summary.notes) text += format_line("note", note);
    const char* shutter = log.rolling_shutter ? ", rolling shutter" : ", no rolling shutter";
    for (const LidarSummary& lidar : summary.lidars)
        text += format_line("sensor", summary_text(lidar) + shutter);
    for (const Camera& camera : log.cameras)
        text += format_line("camera", fmt::format("{}: {} x {}, {:.1f} degrees wide", camera.name,
                                                  camera.columns, camera.rows, view_angle_deg(camera)));
    text += format_line("frames", fmt::format("{} ({} to {}), {:.1f} s, {:.1f} m driven", log.frames.size(),
                                              log.frames.front().index, log.frames.back().index,
                                              duration_s(log), summary.path_m));
    text += format_line("on earth", describe_place(log.georeference));
    if (summary.returns_share) {
        std::string returns = fmt::format("{:.1f} % of all rays return", 100.0 * *summary.returns_share);
        if (summary.is_sample)
            returns += fmt::format(" in a sample of {} scans of the log; --all reads all scans",
                                   summary.n_scans_read);
        text += format_line("returns", returns);
    }
    const auto n_moving = std::ranges::count_if(log.boxes, &BoxTrack::is_moving);
    text += format_line("boxes", fmt::format("{}: {} moving, {} parked", summary.boxes.size(), n_moving,
                                             std::ssize(summary.boxes) - n_moving));
    if (const auto& azimuths = log.labelled_azimuth)
        text += format_line("labelled",
                            fmt::format("azimuths {:.1f} to {:.1f} degrees (left is positive)",
                                        azimuths->right_rad * 180.0 / kPi, azimuths->left_rad * 180.0 / kPi));
    if (!summary.masked.empty())
        text += format_line("masked", summary.masked + ": these moving objects are not trained");
    return text + convention_table(log.conventions_used) + box_table(summary.boxes, show_instance_columns);
}

}  // namespace

LogSummary summarise_log(const Log& log, const InitOptions& options) {
    LogSummary summary{log, {}};
    for (const Note& note : log.notes)
        if (note.id != kGuessesNote) summary.notes.push_back(note.text);  // the table has the guesses
    for (std::size_t i = 0; i < log.lidars.size(); ++i)
        summary.lidars.push_back(summarise_lidar(log, int(i)));
    summary.path_m = path_length_m(log.world_from_vehicle);
    summary.returns_share = return_share(log);
    summary.n_scans_read = std::size_t(
        std::ranges::count_if(log.frames, [](const Frame& f) { return f.scan.range_m.size() > 0; }));
    for (const BoxTrack& box : log.boxes) summary.boxes.push_back(summarise_box(log, box));
    summary.masked = format_box_list(find_unselected(log, options));
    return summary;
}

RunSummary summarise_run(const Run& run) {
    RunSummary summary{run, summarise_log(run.log, run.config.init)};
    if (!run.refined_poses.empty() && run.refined_poses != "none")
        summary.log.notes.push_back(fmt::format(
            "poses: training corrected the poses of the log (train.refine_poses={}), so positions of the "
            "vehicle and of boxes differ from those that `relidar info LOG` prints",
            run.refined_poses));
    // An edited run has no list of ignored boxes, because the list would contain actors
    // that the edits have removed.
    summary.log.masked =
        run.edits.empty() ? format_box_list(find_unmodelled(run.scene, run.log, run.config.init)) : "";
    for (std::size_t i = 0; i < run.log.lidars.size(); ++i) {
        const SimulatedSensor sensor = make_sensor(run.config, run.log, int(i));
        const int rows = sensor.grid ? sensor.grid->rows : sensor.rays.rows;
        const int columns = sensor.grid ? sensor.grid->columns : sensor.rays.columns;
        summary.rendered_sensors.push_back({sensor.name, rows, columns, sensor.limits.max_m});
    }
    // Finds the model of each box.
    for (BoxSummary& box : summary.log.boxes) {
        const auto instance = std::ranges::find(run.scene.instances, box.box.id, &ModelInstance::track);
        if (instance == run.scene.instances.end()) continue;
        box.instance = std::size_t(instance - run.scene.instances.begin());
        box.n_surfels = run.scene.models[instance->model].count;
    }
    for (const SurfelModel& model : run.scene.models) summary.models.emplace_back(model.name, model.count);
    // The blocks of a long log also belong to the background, the first model.
    for (const SceneBlock& block : run.scene.blocks) summary.models.front().second += block.count;
    for (const int position : run.split.test)
        summary.test_frames.push_back(run.log.frames[static_cast<std::size_t>(position)].index);
    for (const auto& entry : std::filesystem::directory_iterator(run.folder)) {
        if (entry.is_regular_file())
            summary.files.emplace_back(entry.path().filename().string(), entry.file_size());
    }
    std::sort(summary.files.begin(), summary.files.end());
    return summary;
}

std::string format_as_text(const LogSummary& log) { return summary_text(log, false); }

std::string format_as_text(const RunSummary& summary) {
    const Run& run = summary.run;
    const PrimitiveType primitive = run.scene.surfels.primitive;
    const bool is_default_type = primitive == ImageModel{}.primitive;
    const std::string type = is_default_type ? "" : fmt::format(" {}", properties_of(primitive).label);
    std::string text = format_line("surfels", fmt::format("{}{}", count_surfels(run.scene), type));
    if (!run.scene.blocks.empty())
        text += format_line(
            "blocks", fmt::format("the background consists of {} blocks; each is loaded when a scan needs it",
                                  run.scene.blocks.size()));
    for (const auto& [name, count] : summary.models)
        text += format_line("  model", fmt::format("{}: {} surfels", name, count));
    text += format_line("instances",
                        fmt::format("{}, of which number 0 is the background and all others are actors",
                                    run.scene.instances.size()));
    if (!run.drop_network.empty())
        text += format_line(
            "ray drop",
            fmt::format(
                "corrected by a network with {} parameters; the network reads range images of type {}",
                run.drop_network.parameters.size(), run.drop_network.image));
    for (const EditHistoryEntry& e : run.edits)
        text += format_line("  edit", fmt::format("{} (of run {})", e.edit, e.run));
    text += format_line(
        "settings", fmt::format("preset {}, {} iterations", run.config.preset, run.config.train.iterations));
    text +=
        format_line("split", fmt::format("{} training frames, {} test frames ({})", run.split.train.size(),
                                         run.split.test.size(), fmt::join(summary.test_frames, ", ")));
    for (const RenderedSensorSummary& sensor : summary.rendered_sensors) {
        const std::string image =
            sensor.rows == 0 ? "" : fmt::format("{} rows x {} columns, ", sensor.rows, sensor.columns);
        text += format_line(
            "renders", fmt::format("{}: {}range up to {:.4g} m", sensor.name, image, sensor.max_range_m));
    }
    TableRows rows{{"file", "size"}};
    for (const auto& [name, size] : summary.files) rows.push_back({name, format_bytes(size)});
    return text + summary_text(summary.log, true) + "\n" + format_table(rows);
}

std::string format_as_json(const LogSummary& log) { return dump_json(summary_json(log)); }

/// Returns the summary of a run and its log for `relidar info --json`.
std::string format_as_json(const RunSummary& summary) {
    const Run& run = summary.run;
    Json json = {{"preset", run.config.preset},
                 {"iterations", run.config.train.iterations},
                 {"surfels", count_surfels(run.scene)},
                 {"primitive", properties_of(run.scene.surfels.primitive).name},
                 {"models", Json::array()},
                 {"train_frames", run.split.train.size()},
                 {"test_frames", summary.test_frames},
                 {"files", Json::object()},
                 {"log", summary_json(summary.log)}};
    for (const auto& [name, count] : summary.models)
        json["models"].push_back({{"name", name}, {"surfels", count}});
    json["instances"] = run.scene.instances.size();
    json["renders"] = Json::array();
    for (const RenderedSensorSummary& sensor : summary.rendered_sensors)
        json["renders"].push_back({{"name", sensor.name},
                                   {"rows", sensor.rows},
                                   {"columns", sensor.columns},
                                   {"max_range_m", sensor.max_range_m}});
    if (!run.scene.blocks.empty()) json["blocks"] = run.scene.blocks.size();
    const RayDropNetwork& network = run.drop_network;
    json["drop_network"] =
        network.empty() ? Json() : Json{{"parameters", network.parameters.size()}, {"image", network.image}};
    json["edits"] = Json::array();
    for (const EditHistoryEntry& e : run.edits) json["edits"].push_back({{"run", e.run}, {"edit", e.edit}});
    for (const auto& [name, size] : summary.files) json["files"][name] = size;
    return dump_json(json);
}

}  // namespace relidar::cli
