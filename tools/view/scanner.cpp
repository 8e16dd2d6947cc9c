// SPDX-License-Identifier: Apache-2.0
#include "scanner.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>

#include <fmt/format.h>
#include <unistd.h>
#include <nlohmann/json.hpp>

#include <relidar/log/sensor_files.hpp>
#include <relidar/run/edit.hpp>
#include <relidar/scene/labels.hpp>
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

std::vector<std::string> sensor_names() {
    std::vector<std::string> names = list_sensors();
    names.insert(names.begin(), "native");
    return names;
}

/// Returns a hash (FNV-1a) of the run's path. After a restart of the server, the web page
/// detects another run by its hash, and does not learn the path.
std::string run_path_hash(const Run& run) {
    std::uint32_t hash = 2166136261u;
    for (const char c : std::filesystem::absolute(run.folder).lexically_normal().string())
        hash = (hash ^ static_cast<unsigned char>(c)) * 16777619u;
    return fmt::format("{:08x}", hash);
}

Json copyable_actors(const Run& run) {
    Json actors = Json::array();
    for (const ModelInstance& instance : run.scene.instances) {
        if (const BoxTrack* box = find_box(run.log, instance.track))
            actors.push_back({{"track", box->id}, {"category", name_of(class_of(*box))}});
    }
    for (const BoxTrack& box : list_standing(run.scene, run.log, {}))
        actors.push_back({{"track", box.id}, {"category", box.category}});
    return actors;
}

/// Returns the frames of the log with their positions on the recorded path.
Json frames_json(const Run& run) {
    const Log& log = run.log;
    Json frames = Json::array();
    for (std::size_t i = 0; i < log.frames.size(); ++i) {
        const Frame& frame = log.frames[i];
        const glm::dvec3 position_m = log.lidar_track(frame.lidar).pose_at(frame.time_s).translation;
        frames.push_back({{"index", frame.index},
                          {"time_s", frame.time_s},
                          {"lidar", frame.lidar},
                          {"held_out", std::ranges::count(run.split.test, int(i)) > 0},
                          {"position", {position_m.x, position_m.y, position_m.z}}});
    }
    return frames;
}

/// Stores an uploaded text in a temporary file, because sensors can only be read from
/// files. The destructor removes the file.
class UploadedFile {
public:
    UploadedFile(const std::string& text, const std::string& ending) {
        std::string pattern = (std::filesystem::temp_directory_path() / "relidar-sensor-XXXXXX").string();
        if (mkdtemp(pattern.data()) == nullptr)
            throw DataError(
                "cannot read the sensor file: relidar cannot create a temporary folder in the folder for "
                "temporary files (TMPDIR)");
        folder_ = pattern;
        std::ofstream(file_path(ending), std::ios::binary) << text;
    }
    ~UploadedFile() {
        std::error_code ignored;
        std::filesystem::remove_all(folder_, ignored);
    }
    UploadedFile(const UploadedFile&) = delete;
    UploadedFile& operator=(const UploadedFile&) = delete;

    std::filesystem::path file_path(const std::string& extension) const {
        return folder_ / ("sensor" + extension);
    }

private:
    std::filesystem::path folder_;
};

/// Reads a sensor from the text of a file. Errors name the user's file.
SimulatedSensor read_uploaded_sensor(const SensorFile& file, const std::string& extension) {
    const UploadedFile upload(file.text, extension);
    const std::string path = upload.file_path(extension).string();
    try {
        return simulate_sensor(find_sensor(path));
    } catch (const Error& error) {
        std::string message = error.what();
        if (const std::size_t found = message.find(path); found != std::string::npos)
            message.replace(found, path.size(), file.name);
        throw DataError(message);
    }
}

void check_ray_count(const SimulatedSensor& sensor) {
    if (sensor.rays.size() > kMaxRays)
        fail<UsageError>(
            "cannot show the sensor {}: found {} rays per scan, expected at most {}; use `relidar render`",
            sensor.name, sensor.rays.size(), kMaxRays);
}

Json channels_json(const Config& config) {
    Json channels = Json::array();
    // The channel `source` exists only in simulated weather.
    for (const ChannelInfo& channel : parse_channels(config.render.channels + ",source"))
        channels.push_back({{"name", channel.name}, {"unit", channel.unit}, {"meaning", channel.meaning}});
    return channels;
}

/// Returns true if the user has moved an actor of the run, not only selected it.
bool is_moved(const ActorEdits& edits, const std::string& track) {
    const auto move = edits.moves.find(track);
    return move != edits.moves.end() && move->second != std::array<double, 4>{};
}

}  // namespace

BrowserScanRenderer::BrowserScanRenderer(Run run, OtherRunsByName others, Device& device)
    : run_(std::move(run)), others_(std::move(others)), device_(device), recorded_(run_) {}

/// Returns the first message to a web page ("hello"), without the save folder, which
/// ViewerSession adds. It describes the run, its frames and path, the available sensors,
/// the actors of other runs, and the device.
Json BrowserScanRenderer::page_data() const {
    const Log& log = run_.log;
    Json lidars = Json::array(), others = Json::array();
    for (const Lidar& lidar : log.lidars)
        lidars.push_back({{"name", lidar.name}, {"sensor", lidar.sensor.name}});
    for (const auto& [name, run] : others_)
        others.push_back({{"name", name}, {"actors", copyable_actors(run)}});
    std::string weather_examples = "clear";
    for (const WeatherEffectEntry* effect : kWeatherEffects)
        weather_examples += fmt::format(" {}", effect->examples);
    return {{"kind", "hello"},
            {"run", run_.folder.filename().empty() ? run_.folder.parent_path().filename().string()
                                                   : run_.folder.filename().string()},
            {"identity", run_path_hash(run_)},
            {"log", log.name},
            {"actors", copyable_actors(run_)},
            {"others", others},
            {"surfels", count_surfels(run_.scene)},
            {"device", device_.info().name},
            {"frames", frames_json(run_)},
            {"lidars", lidars},
            {"sensors", sensor_names()},
            {"max_range_m", run_.config.dataset.max_range_m},
            {"channels", channels_json(run_.config)},
            {"weather", {{"help", weather_help()}, {"examples", weather_examples}}}};
}

/// Returns the sensor that a browser tab has selected. Reuses the sensor of the previous
/// scan, because computing its rays takes time.
SimulatedSensor BrowserScanRenderer::tab_sensor(TabCache& tab_cache, const LiveScanRequest& request) const {
    if (request.lidar < 0 || std::size_t(request.lidar) >= run_.log.lidars.size())
        fail<UsageError>("cannot select a LiDAR: found the index {}, but the log has {} LiDARs",
                         request.lidar, run_.log.lidars.size());
    if (request.sensor == kFileSensor) {
        if (!tab_cache.file_sensor)
            throw UsageError("cannot use a sensor file: none is loaded; choose a file first");
        SimulatedSensor sensor = *tab_cache.file_sensor;
        sensor.lidar = request.lidar;
        return sensor;
    }
    const std::string key = fmt::format("{}/{}", request.lidar, request.sensor);
    if (tab_cache.sensor && tab_cache.sensor->first == key) return tab_cache.sensor->second;
    // Rejects paths, so that clients cannot read files of the server.
    if (std::ranges::count(sensor_names(), request.sensor) == 0)
        fail<UsageError>("unknown sensor \"{}\"; expected a name from the list of sensors", request.sensor);
    tab_cache.sensor.emplace(key, choose_sensor(request.sensor, run_.config, run_.log, request.lidar));
    check_ray_count(tab_cache.sensor->second);
    return tab_cache.sensor->second;
}

/// Reads a sensor file that a user has uploaded, and stores the sensor for later scans of
/// the tab. Returns the size of its scans for the page.
Json BrowserScanRenderer::store_sensor(TabCache& tab_cache, const SensorFile& file) const {
    const std::string extension = std::filesystem::path(file.name).extension().string();
    if (extension != ".csv" && extension != ".json")
        fail<UsageError>("cannot read {}: expected a file name that ends in .csv or .json", file.name);
    // Does not read the rig, because it can name files of the server.
    const Json json = extension == ".json" ? Json::parse(file.text, nullptr, false) : Json();
    if (json.is_object() && json.contains("sensors"))
        fail<UsageError>("cannot show {}: it describes a rig of several sensors; choose one of its sensors",
                         file.name);
    SimulatedSensor sensor = read_uploaded_sensor(file, extension);
    check_ray_count(sensor);
    sensor.name = file.name;
    // Rays that change from scan to scan are not stored in the sensor.
    const bool has_rays = sensor.rays.size() > 0 || !sensor.pattern;
    const RayTable rays = has_rays ? sensor.rays : make_rays(*sensor.pattern, 0.0);
    tab_cache.file_sensor = std::move(sensor);
    return {{"name", file.name}, {"rows", rays.rows}, {"columns", rays.columns}, {"rays", rays.size()}};
}

/// Returns the run with the surfels that the edits need: those of copied actors, and
/// mirrored surfels on the unseen sides of copied and moved actors. Moved actors keep
/// their poses. Adds notes about unseen sides to actor_notes_.
Run BrowserScanRenderer::make_edited_run(const ActorEdits& edits) {
    Run run = run_;
    run.set_driving_scene(release_edited(run.driving_scene(), edits, &actor_notes_));
    SceneWithLog with_copies = add_copies({std::move(run.scene), run.log}, others_, edits.copies);
    // set_driving_scene() mirrors surfels only for actors without an equal box in `run`.
    // Afterwards, `run` has all boxes of `with_copies`.
    std::erase_if(run.log.boxes, [&](const BoxTrack& box) { return is_moved(edits, box.id); });
    run.set_driving_scene(std::move(with_copies));
    for (const ModelInstance& instance : run.scene.instances) {
        const bool is_copy = !find_box(run_.log, instance.track);
        if (!is_copy && !edits.moves.contains(instance.track)) continue;
        const std::string note = describe_unseen(run.scene, instance.track);
        if (!note.empty()) actor_notes_.push_back(note);
    }
    return run;
}

/// Returns a renderer for the scene with all edits. Creates a new renderer only if an
/// actor is copied or moved, or a standing object is edited, for the first time, because
/// the surfels change.
ScanRenderer& BrowserScanRenderer::edited_renderer(const EditedTraffic& traffic) {
    // Scenes with equal lists of copied and moved actors can share a renderer.
    std::vector<std::pair<std::string, std::string>> models;
    for (const ActorEdits::ActorCopy& copy : traffic.edits().copies) models.emplace_back(copy.from, copy.of);
    for (const auto& [track, by] : traffic.edits().moves)
        if (is_moved(traffic.edits(), track)) models.emplace_back(track, "");
    for (const BoxTrack& box : list_standing(run_.scene, run_.log, {}))
        if (std::ranges::count(traffic.instances(), box.id, &ModelInstance::track) > 0)
            models.emplace_back(box.id, "released");
    if (renderer_ && rendered_ == models) return *renderer_;

    renderer_.reset();  // Frees the memory of the old renderer before a new one is created.
    actor_notes_.clear();
    if (models.empty()) renderer_.emplace(device_, run_);
    else renderer_.emplace(device_, make_edited_run(traffic.edits()));
    rendered_ = models;
    launches_.clear();
    return *renderer_;
}

/// Returns the measured scan that is nearest to the requested time. Null if the user does
/// not want it, or if the log is not loaded.
const Frame* BrowserScanRenderer::measured_frame(const LiveScanRequest& request) const {
    const Log* log = recorded_.log();
    if (!log || !request.real) return nullptr;
    const Frame* nearest = nullptr;
    const auto distance_s = [&](const Frame& frame) { return std::abs(frame.time_s - request.time_s); };
    for (const Frame& frame : log->frames) {
        if (frame.lidar != request.lidar) continue;
        if (!nearest || distance_s(frame) < distance_s(*nearest)) nearest = &frame;
    }
    return nearest;
}

/// Renders a scan of the edited scene, with the sensor at its offset from the LiDAR.
RenderedScan BrowserScanRenderer::render_scan(const EditedTraffic& traffic, const LiveScanRequest& request,
                                              const SimulatedSensor& sensor) {
    const Log& log = run_.log;
    const PoseTrack sensor_track = mount_track(log.lidar_track(request.lidar), request.sensor_offset);
    ScanRequest scan;
    scan.time_s = request.time_s;
    scan.dataset_from_sensor = shift_track(sensor_track, log.world_offset_m);
    scan.dataset_from_actor = traffic.visible_poses(request.time_s);
    ScanRenderer& renderer = edited_renderer(traffic);
    renderer.set_weather(request.weather);
    return renderer.render(sensor, scan);
}

/// Returns the duration in milliseconds of the last launch of each kernel that has run
/// since the previous call. A kernel has run if its list of launch times has grown. A
/// list with kMaxLaunchTimes entries cannot grow, so its kernel is always included.
Json BrowserScanRenderer::kernel_times() {
    constexpr std::size_t kMaxLaunchTimes = 4096;
    Json times = Json::array();
    for (const auto& [kernel, launches] : renderer_->times().milliseconds) {
        std::size_t& n_reported_launches = launches_[kernel];
        const bool has_grown = launches.size() != n_reported_launches;
        const bool is_full = n_reported_launches >= kMaxLaunchTimes;
        if (launches.empty() || (!has_grown && !is_full)) continue;
        n_reported_launches = launches.size();
        times.push_back({kernel, launches.back()});
    }
    return times;
}

/// Returns the part of the answer that needs no rendering: poses, actors and names.
Json BrowserScanRenderer::scan_header(const EditedTraffic& traffic, const LiveScanRequest& request,
                                      const SimulatedSensor& sensor) const {
    const Pose log_pose = run_.log.lidar_track(request.lidar).pose_at(request.time_s);
    Json names = Json::array();
    for (const ModelInstance& instance : traffic.instances())
        names.push_back(instance.track.empty() ? "background" : instance.track);
    return {{"id", request.id},
            {"time_s", request.time_s},
            {"sensor", sensor.name},
            {"log_pose", pose_json(log_pose)},
            {"pose", pose_json(log_pose * request.sensor_offset)},
            {"actors", traffic.actors_json(request.time_s)},
            {"instances", names}};
}

/// Renders the requested scan and encodes it with the measured scan nearest in time.
std::string BrowserScanRenderer::render_message(TabCache& tab_cache, const LiveScanRequest& request) {
    const auto start = Clock::now();
    // An invalid sensor causes an error before anything is rendered.
    SimulatedSensor sensor = tab_sensor(tab_cache, request);
    if (!tab_cache.traffic || tab_cache.traffic->edits() != request.edits)
        tab_cache.traffic.emplace(run_, others_, request.edits);
    const EditedTraffic& traffic = *tab_cache.traffic;

    // The simulated scan can be compared ray by ray if the sensor, its pose and its time
    // are those of the measured scan. It then uses the measured rays. |w| = 1: no turn.
    const Frame* real_frame = measured_frame(request);
    const bool is_at_frame_time = real_frame && std::abs(real_frame->time_s - request.time_s) < kSameTime_s;
    const bool is_at_log_pose = request.sensor_offset.translation == glm::dvec3(0.0) &&
                                std::abs(request.sensor_offset.rotation.w) == 1.0;
    const bool is_matched =
        is_at_frame_time && is_at_log_pose && sensor.is_log_lidar && !sensor.grid && request.simulate;
    Json header = scan_header(traffic, request, sensor);
    header["matched"] = is_matched;
    std::optional<ScanColumns> simulated, measured;
    if (real_frame) {
        header["real_frame"] = real_frame->index;
        measured = measured_columns(*recorded_.log(), *real_frame);
    }
    if (request.simulate) {
        if (is_matched) {
            sensor.rays = real_frame->scan.rays;
            sensor.follows_sweeps = false;
        }
        const RenderedScan scan = render_scan(traffic, request, sensor);
        header["trace_ms"] = scan.trace_ms;
        header["actor_notes"] = actor_notes_;
        if (scan.unseen_share) {
            header["unseen"] = *scan.unseen_share;
            header["much_unseen"] = *scan.unseen_share > kMuchUnseen;
        }
        header["kernels"] = kernel_times();
        simulated = simulated_columns(scan, run_.config, run_.log.world_offset_m);
    }
    header["total_ms"] = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
    return encode_scans(std::move(header), simulated ? &*simulated : nullptr,
                        measured ? &*measured : nullptr);
}

}  // namespace relidar::view
