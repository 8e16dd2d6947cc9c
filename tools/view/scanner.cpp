// SPDX-License-Identifier: Apache-2.0
#include "scanner.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>

#include <fmt/format.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>
#include <relidar/run/edit.hpp>
#include "base/fail.hpp"

#include "frame.hpp"

namespace relidar::view {
namespace {

using Json = nlohmann::json;
using Clock = std::chrono::steady_clock;

// Maximum number of rays of a scan in the viewer. The message for such a scan has 28 MB.
constexpr std::size_t kMaxRays = std::size_t(1) << 20;
constexpr double kSameTime_s = 1e-6;
constexpr const char* kFileSensor = "file";

std::vector<std::string> list_native_and_built_in_sensor_names() {
    std::vector<std::string> names = list_sensor_names();
    names.insert(names.begin(), "native");
    return names;
}

/// FNV-1a, so that clients do not learn the path. After a restart, the web page compares
/// the hash to detect another run.
std::string compute_hash_text_of_run_path(const TrainedRun& run) {
    std::uint32_t hash = 2166136261u;
    for (const char c : std::filesystem::absolute(run.folder).lexically_normal().string())
        hash = (hash ^ static_cast<unsigned char>(c)) * 16777619u;
    return fmt::format("{:08x}", hash);
}

Json make_copyable_actors_json(const TrainedRun& run) {
    Json actors = Json::array();
    for (const ModelInstance& instance : run.scene.instances) {
        if (const BoxTrack* box = find_box_track_by_id(run.sequence, instance.track))
            actors.push_back({{"track", box->id}, {"category", box->category}});
    }
    return actors;
}

/// In a private temporary folder. The destructor removes both.
class UploadedFile {
public:
    /// @param ending extension of the file, ".csv" or ".json"
    UploadedFile(const std::string& text, const std::string& ending) {
        std::string pattern = (std::filesystem::temp_directory_path() / "relidar-sensor-XXXXXX").string();
        if (mkdtemp(pattern.data()) == nullptr)
            throw DataError(
                "cannot read the sensor file: relidar cannot create a temporary folder in the folder for "
                "temporary files (TMPDIR)");
        folder_ = pattern;
        std::ofstream(get_file_path(ending), std::ios::binary) << text;
    }
    ~UploadedFile() {
        std::error_code ignored;
        std::filesystem::remove_all(folder_, ignored);
    }
    UploadedFile(const UploadedFile&) = delete;
    UploadedFile& operator=(const UploadedFile&) = delete;

    std::filesystem::path get_file_path(const std::string& extension) const {
        return folder_ / ("sensor" + extension);
    }

private:
    std::filesystem::path folder_;
};

void require_ray_count_within_viewer_limit(const SimulatedSensor& sensor) {
    if (sensor.rays.size() > kMaxRays)
        fail<UsageError>(
            "cannot show the sensor {}: found {} rays per scan, expected at most {}; use `relidar render`",
            sensor.name, sensor.rays.size(), kMaxRays);
}

Json make_channels_json(const Config& config) {
    Json channels = Json::array();
    // The channel `source` exists only in simulated weather.
    for (const ChannelInfo& channel : parse_channel_names(config.render.channels + ",source"))
        channels.push_back({{"name", channel.name}, {"unit", channel.unit}, {"meaning", channel.meaning}});
    return channels;
}

}  // namespace

BrowserScanRenderer::BrowserScanRenderer(TrainedRun run, OtherRunsByName other_runs, Device& device)
    : run_(std::move(run)), others_(std::move(other_runs)), device_(device), real_(run_) {}

Json BrowserScanRenderer::make_initial_page_data_json() const {
    const LidarSequence& log = run_.sequence;
    Json frames = Json::array(), lidars = Json::array();
    for (std::size_t i = 0; i < log.frames.size(); ++i) {
        const LidarFrame& frame = log.frames[i];
        const glm::dvec3 p =
            log.get_world_from_sensor(frame.lidar).interpolate_pose(frame.time_s).translation;
        const bool held_out =
            std::find(run_.split.test.begin(), run_.split.test.end(), int(i)) != run_.split.test.end();
        frames.push_back({{"index", frame.index},
                          {"time_s", frame.time_s},
                          {"lidar", frame.lidar},
                          {"held_out", held_out},
                          {"position", {p.x, p.y, p.z}}});
    }
    for (const Lidar& lidar : log.lidars)
        lidars.push_back({{"name", lidar.name}, {"sensor", lidar.sensor.name}});
    Json others = Json::array();
    for (const auto& [name, run] : others_)
        others.push_back({{"name", name}, {"actors", make_copyable_actors_json(run)}});
    std::string weather_examples = "clear";
    for (const WeatherEffectEntry* effect : kWeatherEffects)
        weather_examples += fmt::format(" {}", effect->examples);
    return {{"kind", "hello"},
            {"run", run_.folder.filename().empty() ? run_.folder.parent_path().filename().string()
                                                   : run_.folder.filename().string()},
            {"identity", compute_hash_text_of_run_path(run_)},
            {"log", log.name},
            {"actors", make_copyable_actors_json(run_)},
            {"others", others},
            {"surfels", count_surfels(run_.scene)},
            {"device", device_.info().name},
            {"frames", frames},
            {"lidars", lidars},
            {"sensors", list_native_and_built_in_sensor_names()},
            {"max_range_m", run_.config.dataset.max_range_m},
            {"channels", make_channels_json(run_.config)},
            {"weather", {{"help", make_weather_help()}, {"examples", weather_examples}}}};
}

SimulatedSensor BrowserScanRenderer::make_sensor_for_tab(TabCache& tab_cache,
                                                         const LiveScanRequest& request) const {
    if (request.lidar < 0 || std::size_t(request.lidar) >= run_.sequence.lidars.size())
        fail<UsageError>("cannot select a LiDAR: found the index {}, but the log has {} LiDARs",
                         request.lidar, run_.sequence.lidars.size());
    if (request.sensor == kFileSensor) {
        if (!tab_cache.file_sensor)
            throw UsageError("cannot use a sensor file: none is loaded; choose a file first");
        SimulatedSensor sensor = *tab_cache.file_sensor;
        sensor.lidar = request.lidar;
        return sensor;
    }
    const std::string key = fmt::format("{}/{}", request.lidar, request.sensor);
    if (!tab_cache.sensor || tab_cache.sensor->first != key) {
        // Clients cannot read files of the server.
        const std::vector<std::string> names = list_native_and_built_in_sensor_names();
        if (std::find(names.begin(), names.end(), request.sensor) == names.end())
            fail<UsageError>("unknown sensor \"{}\"; expected a name from the list of sensors",
                             request.sensor);
        tab_cache.sensor.emplace(
            key, find_or_load_sensor(request.sensor, run_.config, run_.sequence, request.lidar));
        require_ray_count_within_viewer_limit(tab_cache.sensor->second);
    }
    return tab_cache.sensor->second;
}

Json BrowserScanRenderer::store_uploaded_sensor_and_describe_it(TabCache& tab_cache,
                                                                const SensorFile& file) const {
    const std::string ending = std::filesystem::path(file.name).extension().string();
    if (ending != ".csv" && ending != ".json")
        fail<UsageError>("cannot read {}: expected a file name that ends in .csv or .json", file.name);
    // Does not read the rig, because it can name files of the server.
    const Json json = ending == ".json" ? Json::parse(file.text, nullptr, false) : Json();
    if (json.is_object() && json.contains("sensors"))
        fail<UsageError>("cannot show {}: it describes a rig of several sensors; choose one of its sensors",
                         file.name);
    const UploadedFile upload(file.text, ending);
    SimulatedSensor sensor;
    try {
        sensor = make_simulated_sensor(find_sensor(upload.get_file_path(ending).string()));
        // The error message must contain the name of the user's file.
    } catch (const Error& error) {
        std::string message = error.what();
        const std::string path = upload.get_file_path(ending).string();
        if (const std::size_t at = message.find(path); at != std::string::npos)
            message.replace(at, path.size(), file.name);
        throw DataError(message);
    }
    require_ray_count_within_viewer_limit(sensor);
    sensor.name = file.name;
    tab_cache.file_sensor = std::move(sensor);
    const SimulatedSensor& stored_sensor = *tab_cache.file_sensor;
    const RayTable rays = stored_sensor.rays.size() == 0 && stored_sensor.pattern
                              ? make_rays(*stored_sensor.pattern, 0.0)
                              : stored_sensor.rays;
    return {{"name", file.name}, {"rows", rays.rows}, {"columns", rays.columns}, {"rays", rays.size()}};
}

/// Creates a new renderer if an actor is copied or moved for the first time, because the
/// surfels change. Other edits reuse the renderer.
ScanRenderer& BrowserScanRenderer::get_renderer_for_edited_scene(const EditedTraffic& traffic) {
    // Scenes with equal lists of copied and moved actors can share a renderer.
    std::vector<std::pair<std::string, std::string>> models;
    for (const ActorEdits::ActorCopy& copy : traffic.get_edits().copies)
        models.emplace_back(copy.from, copy.of);
    for (const auto& [track, by] : traffic.get_edits().moves)
        if (by != std::array<double, 4>{}) models.emplace_back(track, "");
    if (!renderer_ || rendered_ != models) {
        renderer_.reset();  // Frees the memory of the old renderer before a new one is created.
        actor_notes_.clear();
        if (models.empty()) {
            renderer_.emplace(device_, run_);
        } else {
            TrainedRun run = run_;
            SceneWithLog driving = add_copied_actors_with_surfels({std::move(run.scene), run.sequence},
                                                                  others_, traffic.get_edits().copies);
            // `run` then has no earlier track of the copied and moved actors.
            std::erase_if(run.sequence.boxes, [&](const BoxTrack& box) {
                return std::ranges::find(models, std::pair(box.id, std::string())) != models.end();
            });
            run.replace_driving_scene(std::move(driving));
            for (const ModelInstance& instance : run.scene.instances) {
                const bool is_recorded = find_box_track_by_id(run_.sequence, instance.track) &&
                                         !traffic.get_edits().moves.contains(instance.track);
                const std::string note =
                    is_recorded ? "" : describe_unobserved_sides(run.scene, instance.track);
                if (!note.empty()) actor_notes_.push_back(note);
            }
            renderer_.emplace(device_, run);
        }
        rendered_ = models;
        launches_.clear();
    }
    return *renderer_;
}

/// The nearest in time. Null if measured scans are missing or not requested.
const LidarFrame* BrowserScanRenderer::find_measured_frame_to_compare_with(
    const LiveScanRequest& request) const {
    const LidarSequence* log = real_.get_log_with_scans_or_null();
    if (!log || !request.real) return nullptr;
    const LidarFrame* nearest = nullptr;
    for (const LidarFrame& frame : log->frames)
        if (frame.lidar == request.lidar && (!nearest || std::abs(frame.time_s - request.time_s) <
                                                             std::abs(nearest->time_s - request.time_s)))
            nearest = &frame;
    return nearest;
}

RenderedScan BrowserScanRenderer::render_simulated_scan(const EditedTraffic& edited_traffic,
                                                        const LiveScanRequest& wish,
                                                        const SimulatedSensor& sensor) {
    const LidarSequence& log = run_.sequence;
    ScanRequest request;
    request.time_s = wish.time_s;
    request.dataset_from_sensor = add_offset_to_track_positions(
        compute_mounted_track(log.get_world_from_sensor(wish.lidar), wish.sensor_offset), log.world_offset_m);
    request.dataset_from_actor = edited_traffic.get_poses_of_visible_actors(wish.time_s);
    ScanRenderer& renderer = get_renderer_for_edited_scene(edited_traffic);
    renderer.set_weather(wish.weather);
    return renderer.render(sensor, request);
}

/// Milliseconds of the last launch of each kernel whose list of times has grown. A list
/// with kFull entries cannot grow, so its kernel is always included.
Json BrowserScanRenderer::make_kernel_times_json() {
    constexpr std::size_t kFull = 4096;
    Json times = Json::array();
    for (const auto& [kernel, launches] : renderer_->times().milliseconds) {
        std::size_t& n_reported_launches = launches_[kernel];
        if (launches.empty() || (launches.size() == n_reported_launches && n_reported_launches < kFull))
            continue;
        n_reported_launches = launches.size();
        times.push_back({kernel, launches.back()});
    }
    return times;
}

std::string BrowserScanRenderer::render_scan_as_binary_message(TabCache& tab_cache,
                                                               const LiveScanRequest& request) {
    const auto start = Clock::now();
    // An invalid sensor causes an error before anything is rendered.
    SimulatedSensor sensor = make_sensor_for_tab(tab_cache, request);
    if (!tab_cache.traffic || tab_cache.traffic->get_edits() != request.edits)
        tab_cache.traffic.emplace(run_, others_, request.edits);
    const LidarSequence& log = run_.sequence;
    const LidarFrame* real = find_measured_frame_to_compare_with(request);
    const bool on_frame = real && std::abs(real->time_s - request.time_s) < kSameTime_s;
    const bool is_at_log_pose = request.sensor_offset.translation == glm::dvec3(0.0) &&
                                std::abs(request.sensor_offset.rotation.w) == 1.0;
    const bool is_matched =
        on_frame && sensor.is_log_lidar && !sensor.grid && is_at_log_pose && request.simulate;
    const Pose log_pose = log.get_world_from_sensor(request.lidar).interpolate_pose(request.time_s);
    Json names = Json::array();
    for (const ModelInstance& instance : tab_cache.traffic->get_instances())
        names.push_back(instance.track.empty() ? "background" : instance.track);
    Json header{{"id", request.id},
                {"time_s", request.time_s},
                {"sensor", sensor.name},
                {"log_pose", convert_pose_to_column_major_json(log_pose)},
                {"pose", convert_pose_to_column_major_json(log_pose * request.sensor_offset)},
                {"actors", tab_cache.traffic->list_actors_as_json(request.time_s)},
                {"instances", names},
                {"matched", is_matched}};
    std::optional<ScanColumns> simulated, measured;
    if (real) {
        header["real_frame"] = real->index;
        measured = convert_measured_scan_to_columns(*real_.get_log_with_scans_or_null(), *real);
    }
    if (request.simulate) {
        if (is_matched) {
            sensor.rays = real->scan.rays;
            sensor.follows_sweeps = false;
        }
        const RenderedScan scan = render_simulated_scan(*tab_cache.traffic, request, sensor);
        header["trace_ms"] = scan.trace_ms;
        header["actor_notes"] = actor_notes_;
        if (scan.unseen_share) {
            header["unseen"] = *scan.unseen_share;
            header["much_unseen"] = *scan.unseen_share > kMuchUnseen;
        }
        header["kernels"] = make_kernel_times_json();
        simulated = convert_simulated_scan_to_columns(scan, run_.config, log.world_offset_m);
    }
    header["total_ms"] = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
    return encode_scans_as_binary_message(std::move(header), simulated ? &*simulated : nullptr,
                                          measured ? &*measured : nullptr);
}

}  // namespace relidar::view
