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

#include "frame.hpp"

namespace relidar::view {
namespace {

using Json = nlohmann::json;
using Clock = std::chrono::steady_clock;

// Maximum number of rays of a scan in the viewer. The message for such a scan has 28 MB.
constexpr std::size_t kMaxRays = std::size_t(1) << 20;
constexpr double kSameTime_s = 1e-6;
constexpr const char* kFileSensor = "file";

/// Returns the sensor names that choose_sensor() accepts.
std::vector<std::string> list_built_in_sensors() {
    std::vector<std::string> names = list_sensor_names();
    names.insert(names.begin(), "native");
    return names;
}

/// Lists the edits that change the surfels of the scene: run and track of each copied
/// actor, and track of each moved actor. Edits with the same list can share a renderer.
std::vector<std::pair<std::string, std::string>> list_models(const ActorEdits& edits) {
    std::vector<std::pair<std::string, std::string>> models;
    for (const ActorEdits::Copy& copy : edits.copies) models.emplace_back(copy.from, copy.of);
    for (const auto& [track, by] : edits.moves) models.emplace_back(track, "");
    return models;
}

/// Returns a hash (FNV-1a) of the run's path, so that clients do not learn the path.
/// After a restart, the web page compares the hash to detect another run.
std::string make_identity(const Run& run) {
    std::uint32_t hash = 2166136261u;
    for (const char c : std::filesystem::absolute(run.folder).lexically_normal().string())
        hash = (hash ^ static_cast<unsigned char>(c)) * 16777619u;
    return fmt::format("{:08x}", hash);
}

/// Returns a JSON list of the actors that the user can copy.
Json make_actors_json(const Run& run) {
    Json actors = Json::array();
    for (const Instance& instance : run.scene.instances) {
        if (const BoxTrack* box = find_box(run.sequence, instance.track))
            actors.push_back({{"track", box->id}, {"category", box->category}});
    }
    return actors;
}

Json make_other_runs_json(const OtherRuns& other_runs) {
    Json result = Json::array();
    for (const auto& [name, run] : other_runs)
        result.push_back({{"name", name}, {"actors", make_actors_json(run)}});
    return result;
}

bool is_identity(const Pose& pose) {
    return pose.translation == glm::dvec3(0.0) && std::abs(pose.rotation.w) == 1.0;
}

/// A file in a private temporary folder. The destructor removes both the file and the
/// folder.
class UploadedFile {
public:
    /// Writes a text to a new temporary file.
    /// @param ending extension of the file, ".csv" or ".json"
    UploadedFile(const std::string& text, const std::string& ending) {
        std::string pattern = (std::filesystem::temp_directory_path() / "relidar-sensor-XXXXXX").string();
        if (mkdtemp(pattern.data()) == nullptr)
            throw DataError("cannot read the sensor file: creating a temporary folder failed");
        folder_ = pattern;
        std::ofstream(path(ending), std::ios::binary) << text;
    }
    ~UploadedFile() {
        std::error_code ignored;
        std::filesystem::remove_all(folder_, ignored);
    }
    UploadedFile(const UploadedFile&) = delete;
    UploadedFile& operator=(const UploadedFile&) = delete;

    std::filesystem::path path(const std::string& ending) const { return folder_ / ("sensor" + ending); }

private:
    std::filesystem::path folder_;
};

Json make_sensor_json(const SensorChoice& sensor, double time_s) {
    const RayTable rays =
        sensor.rays.size() == 0 && sensor.pattern ? make_rays(*sensor.pattern, time_s) : sensor.rays;
    return {{"name", sensor.name}, {"rows", rays.rows}, {"columns", rays.columns}, {"rays", rays.size()}};
}

void check_size(const SensorChoice& sensor) {
    if (sensor.rays.size() > kMaxRays)
        throw UsageError(fmt::format(
            "{} has {} rays per scan, expected at most {} in the viewer; use `relidar render` for "
            "this sensor",
            sensor.name, sensor.rays.size(), kMaxRays));
}

Json make_channels_json(const Config& config) {
    Json channels = Json::array();
    // The channel `source` is not in the settings, because it exists only in simulated
    // weather.
    for (const ChannelInfo& channel : parse_channels(config.render.channels + ",source"))
        channels.push_back({{"name", channel.name}, {"unit", channel.unit}, {"meaning", channel.meaning}});
    return channels;
}

/// Returns the help text and the examples for the weather field of the web page.
Json make_weather_json() {
    std::string examples = "clear";
    for (const WeatherEffect* effect : kWeatherEffects) examples += fmt::format(" {}", effect->examples);
    return {{"help", make_weather_help()}, {"examples", examples}};
}

}  // namespace

Scanner::Scanner(Run run, OtherRuns other_runs, Device& device)
    : run_(std::move(run)), others_(std::move(other_runs)), device_(device), real_(run_) {}

Json Scanner::describe() const {
    const Sequence& log = run_.sequence;
    Json frames = Json::array(), lidars = Json::array();
    for (std::size_t i = 0; i < log.frames.size(); ++i) {
        const Frame& frame = log.frames[i];
        const glm::dvec3 p = log.world_from_sensor(frame.lidar).at(frame.time_s).translation;
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
    return {{"kind", "hello"},
            {"run", run_.folder.filename().empty() ? run_.folder.parent_path().filename().string()
                                                   : run_.folder.filename().string()},
            {"identity", make_identity(run_)},
            {"log", log.name},
            {"actors", make_actors_json(run_)},
            {"others", make_other_runs_json(others_)},
            {"surfels", count_surfels(run_.scene)},
            {"device", device_.info().name},
            {"frames", frames},
            {"lidars", lidars},
            {"sensors", list_built_in_sensors()},
            {"max_range_m", run_.config.dataset.max_range_m},
            {"channels", make_channels_json(run_.config)},
            {"weather", make_weather_json()}};
}

SensorChoice Scanner::make_sensor_for_tab(TabCache& tab, const LiveScanRequest& request) const {
    if (request.lidar < 0 || std::size_t(request.lidar) >= run_.sequence.lidars.size())
        throw UsageError(fmt::format("lidar: found {}, expected the index of one of {} LiDARs", request.lidar,
                                     run_.sequence.lidars.size()));
    if (request.sensor == kFileSensor) {
        if (!tab.file_sensor) throw UsageError("sensor: no sensor file is loaded; choose a file first");
        SensorChoice sensor = *tab.file_sensor;
        sensor.lidar = request.lidar;
        return sensor;
    }
    const std::string key = fmt::format("{}/{}", request.lidar, request.sensor);
    if (!tab.sensor || tab.sensor->first != key) {
        // Accepts only the names of built-in sensors, so that clients cannot read files
        // of the server.
        const std::vector<std::string> names = list_built_in_sensors();
        if (std::find(names.begin(), names.end(), request.sensor) == names.end())
            throw UsageError(fmt::format(
                "sensor: \"{}\" is unknown, expected a name from the list of sensors", request.sensor));
        tab.sensor.emplace(key, choose_sensor(request.sensor, run_.config, run_.sequence, request.lidar));
        check_size(tab.sensor->second);
    }
    return tab.sensor->second;
}

Json Scanner::read_sensor(TabCache& tab, const SensorFile& file) const {
    const std::string ending = std::filesystem::path(file.name).extension().string();
    if (ending != ".csv" && ending != ".json")
        throw UsageError(
            fmt::format("cannot read {}: expected a file name that ends in .csv or .json", file.name));
    const UploadedFile upload(file.text, ending);
    SensorChoice sensor;
    try {
        sensor = make_sensor_choice(find_sensor(upload.path(ending).string()));
        // Replaces the path of the temporary file in the error message by the name of the
        // user's file.
    } catch (const Error& error) {
        std::string message = error.what();
        const std::string path = upload.path(ending).string();
        if (const std::size_t at = message.find(path); at != std::string::npos)
            message.replace(at, path.size(), file.name);
        throw DataError(message);
    }
    check_size(sensor);
    sensor.name = file.name;
    tab.file_sensor = std::move(sensor);
    return make_sensor_json(*tab.file_sensor, 0.0);
}

/// Returns a renderer whose scene contains the copied actors. Creates a new renderer also
/// when an actor is moved for the first time, because its unseen sides are then
/// completed. Other moves and removals reuse the renderer.
ScanRenderer& Scanner::find_renderer(const Traffic& traffic) {
    const auto models = list_models(traffic.edits());
    if (!renderer_ || rendered_ != models) {
        renderer_.reset();  // Frees the memory of the old renderer before a new one is created.
        if (models.empty()) {
            renderer_.emplace(device_, run_);
        } else {
            Run run = run_;
            DrivingScene driving = apply_copies({std::move(run.scene), std::move(run.sequence)}, others_,
                                                traffic.edits().copies);
            for (const auto& [track, by] : traffic.edits().moves)
                driving = move_track(std::move(driving), track, {});
            run.replace(std::move(driving));
            renderer_.emplace(device_, run);
        }
        rendered_ = models;
        launches_.clear();
    }
    return *renderer_;
}

/// Returns the measured frame of the requested LiDAR that is nearest in time. Returns
/// null if measured scans are missing or not requested.
const Frame* Scanner::find_nearest_real_frame(const LiveScanRequest& request) const {
    const Sequence* log = real_.sequence();
    if (!log || !request.real) return nullptr;
    const Frame* nearest = nullptr;
    for (const Frame& frame : log->frames)
        if (frame.lidar == request.lidar && (!nearest || std::abs(frame.time_s - request.time_s) <
                                                             std::abs(nearest->time_s - request.time_s)))
            nearest = &frame;
    return nearest;
}

RenderedScan Scanner::render(const Traffic& traffic, const LiveScanRequest& wish,
                             const SensorChoice& sensor) {
    const Sequence& log = run_.sequence;
    ScanRequest request;
    request.time_s = wish.time_s;
    request.dataset_from_sensor = shift_track(
        mount_on_track(log.world_from_sensor(wish.lidar), wish.sensor_offset), log.world_offset_m);
    request.dataset_from_actor = traffic.placed(wish.time_s);
    ScanRenderer& renderer = find_renderer(traffic);
    renderer.set_weather(wish.weather);
    return renderer.render(sensor, request);
}

/// Returns the time of the last launch of each kernel that has run since the previous
/// call, in milliseconds. A kernel has run if its list of times has grown. A full list
/// cannot grow, so its kernel is always included.
Json Scanner::kernel_times() {
    constexpr std::size_t kFull = 4096;
    Json times = Json::array();
    for (const auto& [kernel, launches] : renderer_->times().milliseconds) {
        std::size_t& known = launches_[kernel];
        if (launches.empty() || (launches.size() == known && known < kFull)) continue;
        known = launches.size();
        times.push_back({kernel, launches.back()});
    }
    return times;
}

std::string Scanner::scan(TabCache& tab, const LiveScanRequest& request) {
    const auto start = Clock::now();
    // Finds the sensor first, so that an invalid sensor causes an error before anything
    // is rendered.
    SensorChoice sensor = make_sensor_for_tab(tab, request);
    if (!tab.traffic || tab.traffic->edits() != request.edits)
        tab.traffic.emplace(run_, others_, request.edits);
    const Sequence& log = run_.sequence;
    const Frame* real = find_nearest_real_frame(request);
    const bool on_frame = real && std::abs(real->time_s - request.time_s) < kSameTime_s;
    const bool is_matched =
        on_frame && sensor.is_own && !sensor.grid && is_identity(request.sensor_offset) && request.simulate;
    const Pose log_pose = log.world_from_sensor(request.lidar).at(request.time_s);
    Json names = Json::array();
    for (const Instance& instance : tab.traffic->instances())
        names.push_back(instance.track.empty() ? "background" : instance.track);
    Json header{{"id", request.id},
                {"time_s", request.time_s},
                {"sensor", sensor.name},
                {"log_pose", make_matrix_json(log_pose)},
                {"pose", make_matrix_json(log_pose * request.sensor_offset)},
                {"actors", tab.traffic->describe(request.time_s)},
                {"instances", names},
                {"matched", is_matched}};
    std::optional<ScanColumns> simulated, measured;
    if (real) {
        header["real_frame"] = real->index;
        measured = make_measured_columns(*real_.sequence(), *real);
    }
    if (request.simulate) {
        if (is_matched) sensor.rays = real->scan.rays, sensor.follows_sweeps = false;
        const RenderedScan scan = render(*tab.traffic, request, sensor);
        header["trace_ms"] = scan.trace_ms;
        if (scan.unseen_share)
            header["unseen"] = *scan.unseen_share, header["much_unseen"] = *scan.unseen_share > kMuchUnseen;
        header["kernels"] = kernel_times();
        simulated = make_simulated_columns(scan, run_.config, log.world_offset_m);
    }
    header["total_ms"] = std::chrono::duration<double, std::milli>(Clock::now() - start).count();
    return encode_frame(std::move(header), simulated ? &*simulated : nullptr,
                        measured ? &*measured : nullptr);
}

}  // namespace relidar::view
