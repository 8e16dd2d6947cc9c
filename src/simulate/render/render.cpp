// SPDX-License-Identifier: Apache-2.0
// Renders a scan. Computes the rays of the sensor at their firing times, traces them, and
// computes range, intensity and ray-drop.
#include <relidar/simulate/render.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/accel.hpp>
#include <relidar/run/run.hpp>
#include "gpu/context.hpp"
#include "simulate/render/channel_makers.hpp"
#include "simulate/render/empty_scan.hpp"
#include "simulate/render/footprint.hpp"
#include "simulate/render/scan_renderer.hpp"
#include "simulate/weather/air.hpp"

namespace relidar {

namespace {

constexpr double kFarthest = 1e10;  // limit for coordinates in metres and for times in seconds since 1970

void check_has_normals(const Config& config, const ChannelInfo& channel, const char* doing) {
    if (!channel.needs_normals || kind_of(config.image.primitive).has_normals) return;
    throw UsageError(
        fmt::format("{}: the channel {} needs normals, but image.primitive={} has none; use surfels or other "
                    "channels",
                    doing, channel.name, kind_of(config.image.primitive).name));
}

TraceOptions traced_with(const Config& config) {
    for (const ChannelInfo& channel : wanted_channels(config.render.channels))
        check_has_normals(config, channel, "setting render.channels");
    return rendering_trace_options(config);
}

/// Checks the track of a sensor or an actor.
/// @param thing name of the object in the error message
/// @throws DataError if poses or times are invalid
void check_track(const PoseTrack& track, const std::string& thing) {
    const auto fail = [&](const std::string& found, const char* expected) {
        throw DataError(
            fmt::format("cannot render a scan: poses of {}: found {}, expected {}", thing, found, expected));
    };
    const std::size_t n = track.pose.size();
    if (n == 0 || n != track.time_s.size())
        fail(fmt::format("{} poses at {} times", n, track.time_s.size()),
             "the same number of both, and at least one");
    for (std::size_t i = 0; i < n; ++i) {
        const auto& [q, t] = track.pose[i];
        bool is_pose = std::abs(glm::length(q) - 1.0) < 1e-3;
        for (const double x : {t.x, t.y, t.z, track.time_s[i]}) is_pose = is_pose && std::abs(x) <= kFarthest;
        if (!is_pose)
            fail(fmt::format("an invalid pose at entry {}", i),
                 "a unit quaternion, and metres and seconds of at most 1e10");
        if (i > 0 && !(track.time_s[i] > track.time_s[i - 1])) {
            fail(fmt::format("time {} after {}", track.time_s[i], track.time_s[i - 1]), "increasing times");
        }
    }
}

Sequence without_scans(const Sequence& sequence) {
    Sequence result;
    result.lidars = sequence.lidars;
    result.boxes = sequence.boxes;
    result.world_offset_m = sequence.world_offset_m;
    result.intensity_response = sequence.intensity_response;
    return result;
}

std::vector<Frame> shifted_sweeps(const Sequence& sequence) {
    std::vector<Frame> sweeps;
    for (const Frame& frame : sequence.frames) {
        if (frame.azimuth_shift_rad.empty()) continue;
        sweeps.push_back(without_scan(frame));
    }
    return sweeps;
}

/// Returns several sub-rays for each beam, spread over its footprint. Returns nothing if
/// each beam has a single ray.
/// @throws UsageError for a beam without divergence
std::optional<RayTable> split_beams(const RayTable& rays, const SensorConfig& config,
                                    const std::string& sensor) {
    if (config.sub_rays == 1 && config.returns > 1)
        throw UsageError(
            "sensor.returns=2 needs sensor.sub_rays of 5 or 9, because a single ray has only one "
            "return");
    if (config.sub_rays == 1) return {};
    if (config.sub_rays != 5 && config.sub_rays != 9)
        throw UsageError(fmt::format("sensor.sub_rays: found {}, expected 1, 5 or 9", config.sub_rays));
    if (!(config.divergence_mrad > 0.0 || rays.largest_divergence() > 0.0))
        throw UsageError(fmt::format(
            "sensor.sub_rays: the beam divergence of {} is unknown; set sensor.divergence_mrad", sensor));
    if (rays.size() * std::size_t(config.sub_rays) > kMaxRays)
        throw UsageError(
            fmt::format("sensor.sub_rays: found {} for {} rays, expected at most {} rays in total",
                        config.sub_rays, rays.size(), kMaxRays));
    return split_rays(rays, config.sub_rays, 1e-3 * config.divergence_mrad);
}

/// Copies the measurements of the rays to the arrays of a scan.
void fill_scan(RenderedScan& scan, std::span<const shared::MeasuredRay> measured) {
    const std::size_t n = measured.size();
    for (std::vector<float>* values : {&scan.image.range_m, &scan.median_range_m, &scan.mean_range_m,
                                       &scan.image.intensity, &scan.image.drop_prob, &scan.weight})
        values->resize(n);
    scan.instance.resize(n);
    for (std::size_t i = 0; i < n; ++i) {
        const shared::MeasuredRay& ray = measured[i];
        scan.image.range_m[i] = ray.range_m;
        scan.median_range_m[i] = ray.median_range_m;
        scan.mean_range_m[i] = ray.mean_range_m;
        scan.image.intensity[i] = ray.intensity;
        scan.image.drop_prob[i] = ray.drop_prob;
        scan.weight[i] = ray.weight;
        scan.instance[i] = ray.instance == RELIDAR_NO_INSTANCE ? -1 : static_cast<std::int32_t>(ray.instance);
    }
}

/// Drops beams whose range is outside the sensor's limits. The range of a beam can be
/// outside although some of its sub-rays are inside.
void drop_beyond(RenderedScan& scan, const RangeLimits& limits) {
    for (std::size_t i = 0; i < scan.image.drop_prob.size(); ++i)
        if (!limits.contains(scan.image.range_m[i]) || !limits.contains(scan.median_range_m[i]))
            scan.image.drop_prob[i] = 1.0f;
}

/// Replaces the drop probabilities of a scan by the output of a network. Keeps a
/// probability of 1, because such a ray hit nothing that the sensor can measure.
void take_refined(RenderedScan& scan, std::span<const float> refined) {
    std::vector<float>& drop_prob = scan.image.drop_prob;
    for (std::size_t i = 0; i < drop_prob.size(); ++i)
        if (drop_prob[i] < 1.0f) drop_prob[i] = refined[i];
}

}  // namespace

Pose RenderedScan::world_from_firing(std::size_t ray) const {
    return track.pose.empty() ? world_from_sensor
                              : track.at(time_s + static_cast<double>(time_offset_s[ray]));
}

const std::vector<float>& point_ranges(const RenderedScan& scan, const Config& config) {
    return config.render.points == "median" ? scan.median_range_m : scan.image.range_m;
}

std::vector<float> range_spread(const RenderedScan& scan) {
    std::vector<float> spread_m(scan.mean_range_m.size());
    for (std::size_t i = 0; i < spread_m.size(); ++i)
        spread_m[i] = std::abs(scan.median_range_m[i] - scan.mean_range_m[i]);
    return spread_m;
}

ScanRenderer::ScanRenderer(Device& device, const Scene& scene, const Config& config, const Sequence& sequence)
    : impl_(new Impl{with_farthest(config, sequence), layout_of(scene), without_scans(sequence),
                     sequence.world_from_vehicle, first_origin(sequence), shifted_sweeps(sequence),
                     wanted_channels(config.render.channels),
                     ResidentScene(device, scene, config, {.accel = {}, .trace = traced_with(config)}),
                     std::vector<bool>(scene.instances.size(), true), device}) {}
ScanRenderer::ScanRenderer(Device& device, const Run& run)
    : ScanRenderer(device, run.scene, run.config, run.sequence) {
    if (run.config.refine.enabled && !run.drop_network.empty()) refine_drops(run.drop_network);
    compare_with(run.coverage);
    scatter_intensities(run.intensity_scatter);
}

void ScanRenderer::show_only(const std::vector<bool>& shown) {
    if (shown.size() != impl_->shown.size())
        throw UsageError(
            fmt::format("cannot select the rendered instances: found {} choices, expected {}, one for each "
                        "instance",
                        shown.size(), impl_->shown.size()));
    impl_->shown = shown;
}

void ScanRenderer::refine_drops(const DropNetwork& network) {
    drop_channels(network.inputs);  // throws an error if the network has inputs that cannot be rendered
    impl_->settle();
    impl_->first.refiner.reset();
    for (ScanStrand& strand : impl_->others) strand.refiner.reset();
    if (!network.empty()) impl_->first.refiner.emplace(impl_->device, network);
}

void ScanRenderer::want_channels(const std::string& names) {
    for (const ChannelInfo& channel : wanted_channels(names)) {
        if (impl_->wants(channel.name)) continue;
        check_has_normals(impl_->config, channel, "choosing channels");
        impl_->wanted.push_back(channel);
    }
}

void ScanRenderer::side_by_side(int n) {
    if (n < 1)
        throw UsageError(fmt::format(
            "cannot render several scans at the same time: found {} scans, expected at least 1", n));
    impl_->settle();
    impl_->most_strands = n;
    while (std::ssize(impl_->others) >= n) impl_->others.pop_back();
}

int ScanRenderer::default_side_by_side(const Device& device) {
    return impl_of(device).forced.side_by_side.value_or(device.info().type == "CPU" ? 1 : kSideBySide);
}

int ScanRenderer::side_by_side() const { return impl_->layout.blocks.empty() ? impl_->most_strands : 1; }

void ScanRenderer::compare_with(const Coverage& coverage) { impl_->coverage = coverage; }

void ScanRenderer::scatter_intensities(const std::vector<IntensityScatter>& scatter) {
    impl_->scatter = scatter;
    impl_->scatter.resize(impl_->sweep.lidars.size());
}

void ScanRenderer::set_weather(const Weather& weather) {
    check_weather(weather);
    if (!weather.clear() && !impl_->has_intensities())
        throw UsageError(
            "weather cannot be simulated, because the log of the run has no intensities, which "
            "define the brightness of surfaces");
    impl_->weather = weather;
}

bool ScanRenderer::refines(const SensorChoice& sensor) const {
    const RangeGrid* grid = sensor.grid ? &*sensor.grid : nullptr;
    return impl_->refines({sensor.rays.rows, sensor.rays.columns, kNative}) ||
           impl_->refines({grid ? grid->rows : sensor.rays.rows, grid ? grid->columns : sensor.rays.columns,
                           grid ? grid->name : sensor.name});
}

const KernelTimes& ScanRenderer::times() const { return impl_->scene.times(); }

RenderedScan ScanRenderer::render(const SensorChoice& sensor, double time_s, const Pose& sensor_offset,
                                  std::optional<std::uint64_t> sample) {
    Impl& s = *impl_;
    const SensorChoice followed = sensor_in_sweep(sensor, s.sweeps, s.sweep.lidars, time_s);
    s.sweep.world_from_vehicle = s.log_world_from_vehicle;
    const bool is_elsewhere =
        sensor_offset.translation != glm::dvec3(0.0) || sensor_offset.rotation != Pose{}.rotation;
    const PoseTrack log = s.sweep.world_from_sensor(sensor.lidar);
    s.drive(is_elsewhere ? moved_track(with_fine_turns(log), sensor_offset) : log, followed);
    return take(followed, time_s, s.place(s.moment(followed, time_s)), sample);
}

std::vector<InstancePose> ScanRenderer::drive(const SensorChoice& sensor, const ScanRequest& request) {
    Impl& s = *impl_;
    const auto in_world = [&](const PoseTrack& dataset_from_thing, const std::string& thing) {
        check_track(dataset_from_thing, thing);
        return shifted_track(dataset_from_thing, -s.sweep.world_offset_m);
    };
    if (!(std::abs(request.time_s) <= kFarthest)) {
        throw DataError(
            fmt::format("cannot render a scan: time_s: found {}, expected a finite time of at most {:.0e} s",
                        request.time_s, kFarthest));
    }
    s.drive(in_world(request.dataset_from_sensor, "the sensor"), sensor);
    const SweepMoment sweep = s.moment(sensor, request.time_s);
    if (!request.dataset_from_actor) return s.place(sweep);
    ActorPoses world_from_actor;
    for (const auto& [name, track] : *request.dataset_from_actor)
        world_from_actor[name] = in_world(track, "actor " + name);
    return s.place(sweep, &world_from_actor);
}

RenderedScan ScanRenderer::render(const SensorChoice& sensor, const ScanRequest& request,
                                  std::optional<std::uint64_t> sample) {
    return take(sensor, request.time_s, drive(sensor, request), sample);
}

/// Returns the rays of a sensor as arrays on the device. Keeps the rays of the most
/// recently used sensors on the device.
std::shared_ptr<SensorRays> ScanRenderer::Impl::rays_of(ScanStrand& strand, const SensorChoice& sensor,
                                                        const RayTable& table) {
    constexpr std::size_t kMostSensors = 8, kMostRays = std::size_t(1) << 21;  // 0.2 GB of device memory
    std::vector<std::shared_ptr<SensorRays>>& known_rays = strand.known_rays;
    const std::string name = fmt::format("{}, LiDAR {}, {}", sensor.name, sensor.lidar, sensor.is_own);
    const auto found =
        std::ranges::find_if(known_rays, [&](const auto& rays) { return rays->has(table, name); });
    if (found != known_rays.end()) {
        std::rotate(known_rays.begin(), found, found + 1);
        return known_rays.front();
    }
    // The rays of a pending scan must not be replaced.
    const auto is_free = [&](const std::shared_ptr<SensorRays>& rays) {
        return rays.use_count() == 1 && (rays->table().size() == 0 || rays->sensor() == name);
    };
    // Reuses the entry of the same sensor if the sensor has different rays in every scan.
    auto place = std::ranges::find_if(known_rays, is_free);
    if (place == known_rays.end()) place = known_rays.insert(place, std::make_shared<SensorRays>(device));
    std::rotate(known_rays.begin(), place, place + 1);
    const std::shared_ptr<SensorRays> rays = known_rays.front();
    rays->take(table, name,
               [&](std::size_t i) { return never_seen(sensor, table.channel[i], table.direction[i]); });
    std::size_t n_rays = 0, n_kept = 0;
    for (const auto& kept : known_rays)
        if ((n_rays += kept->table().size()) <= kMostRays && n_kept < kMostSensors) ++n_kept;
    known_rays.resize(std::max<std::size_t>(n_kept, 1));
    return rays;
}

/// Records GPU commands that trace the rays of a sensor and compute the measurements. The
/// instances must have been moved to their poses before.
/// @param refined true to run the ray-drop network too
ScanRenderer::Impl::Cast ScanRenderer::Impl::record(ScanStrand& strand, const SensorChoice& sensor,
                                                    const RayTable& table, double time_s, bool refined) {
    Cast cast{rays_of(strand, sensor, table), sweep.world_from_sensor(sensor.lidar), {}};
    cast.pose = cast.track.at(time_s);
    if (!sweep.rolling_shutter) cast.track = {{time_s}, {cast.pose}};
    Renderer& renderer = renderer_of(strand);
    cast.rays->fire(renderer.stream(), cast.track, time_s);
    renderer.record_forward(cast.rays->batch());
    cast.rays->measure(
        renderer.stream(), renderer.rendered(),
        {config.render.range, sensor.beams, sweep.intensity_response, sensor.limits, kMinWeight});
    if (refined) {
        if (!strand.refiner) strand.refiner.emplace(device, first.refiner->network());
        cast.rays->refine(renderer.stream(), strand.refiner->pass(),
                          glm::vec3(cast.pose.translation + sweep.world_offset_m - first_origin_m));
    }
    return cast;
}

/// Renders the rays of a sensor and waits for the result. The scan does not contain the
/// drop probabilities of the network yet.
RenderedScan ScanRenderer::Impl::cast(const SensorChoice& sensor, const RayTable& table, double time_s,
                                      bool refined) {
    Renderer& renderer = scene.renderer();
    const auto start = std::chrono::steady_clock::now();
    Cast cast = record(first, sensor, table, time_s, refined);
    const std::span<const shared::MeasuredRay> measured = cast.rays->wait(renderer.stream());
    renderer.check_passes();

    RenderedScan scan = empty_scan(table);
    scan.trace_ms =
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
    fill_scan(scan, measured);
    scan.track = shifted_track(std::move(cast.track), sweep.world_offset_m);
    scan.world_from_sensor = {cast.pose.rotation, cast.pose.translation + sweep.world_offset_m};
    scan.time_s = time_s;
    const std::vector<ChannelInfo> channels = rendered_channels();
    add_ray_channels(scan, measured, needs_rendering(channels) ? renderer.download_rendering() : Rendering{},
                     channels);
    return scan;
}

/// Joins the sub-rays of each beam to one return. Renders beams that hit several surfaces
/// again with more sub-rays.
RenderedScan ScanRenderer::Impl::join(const SensorChoice& sensor, const RenderedScan& parts,
                                      const RayTable& whole, SensorConfig beams) {
    RenderedScan scan = join_footprints(parts, whole, beams);
    const std::vector<std::size_t> edges = find_edges(parts, whole, beams);
    if (!edges.empty() && edges.size() * kEdgeParts <= kMaxRays) {
        const RayTable rays = some_rays(whole, edges);
        beams.sub_rays = kEdgeParts;
        const RenderedScan better =
            cast(sensor, split_rays(rays, kEdgeParts, 1e-3 * beams.divergence_mrad), parts.time_s);
        replace_rays(scan, edges, join_footprints(better, rays, beams));
    }
    drop_beyond(scan, sensor.limits);
    return scan;
}

bool ScanRenderer::Impl::refines(const ImageOf& image) const {
    if (!first.refiner || first.refiner->network().image != image.name) return false;
    const DropNetwork& network = first.refiner->network();
    // A network with 1 x 1 convolutions processes each ray separately, so it needs no
    // image.
    const int side = network.taps == 1 ? 1 : std::max(2, network.smallest_side());
    return image.rows >= side && image.columns >= side;
}

bool ScanRenderer::Impl::refines_rays(const SensorChoice& sensor, const RayTable& whole) const {
    return refines({whole.rows, whole.columns, kNative}) ||
           (!sensor.grid && refines({whole.rows, whole.columns, sensor.name}));
}

/// Returns the channels that are computed for each ray. These are the requested channels
/// and the inputs of a network on the host.
std::vector<ChannelInfo> ScanRenderer::Impl::rendered_channels() const {
    std::vector<ChannelInfo> channels = wanted;
    if (first.refiner && !wants(kIncidence)) channels.push_back(wanted_channels(kIncidence).front());
    return channels;
}

/// Runs the ray-drop network on the host, and replaces the drop probabilities of a scan
/// by its output.
void ScanRenderer::Impl::refine(RenderedScan& scan) {
    take_refined(scan,
                 first.refiner->refine(drop_image(scan, first.refiner->network().inputs, first_origin_m)));
}

/// Returns the probability that the sensor itself never gets a return in a direction, for
/// example because the vehicle blocks it.
float ScanRenderer::Impl::never_seen(const SensorChoice& sensor, std::uint16_t channel,
                                     const glm::vec3& direction) const {
    const auto own_beam = sensor.is_own ? sweep.beam_number(sensor.lidar, channel) : std::nullopt;
    return own_beam ? layout.sensor_drop.at(*own_beam, direction) : 0.0f;
}

/// Returns the range limits of a sensor. If the sensor has no maximum range, returns the
/// maximum range of the log.
RangeLimits ScanRenderer::Impl::limits_of(const SensorChoice& sensor) const {
    return {sensor.limits.min_m,
            std::isfinite(sensor.limits.max_m) ? sensor.limits.max_m : config.dataset.max_range_m};
}

/// Returns the properties of a sensor that determine how weather affects its scans.
/// @param rays rays of the sensor, which define the beam divergence
WeatherSensor ScanRenderer::Impl::weather_sensor(const SensorChoice& sensor, const RayTable& rays) const {
    WeatherSensor result;
    const double step = scatter[std::size_t(sensor.lidar)].step, divergence_rad = rays.largest_divergence();
    if (config.sensor.divergence_mrad > 0.0) result.divergence_rad = 1e-3 * config.sensor.divergence_mrad;
    else if (divergence_rad > 0.0) result.divergence_rad = divergence_rad;
    if (step > 0.0) result.darkest = 0.5 * step;
    // An intensity that the sensor reports as 0 lies between 0 and half a step. This is
    // the middle of the interval.
    result.weakest_reflectivity = 0.5 * result.darkest;
    result.separation_m = config.sensor.return_separation_m;
    result.min_range_m = limits_of(sensor).min_m, result.max_range_m = limits_of(sensor).max_m;
    return result;
}

/// Converts expected values to measured values. Samples the returns, adds weather, and
/// rounds intensities to the steps of the sensor.
void ScanRenderer::Impl::measure(RenderedScan& scan, const SensorChoice& sensor, const RayTable& rays,
                                 std::optional<std::uint64_t> sample) {
    const IntensityScatter& own = scatter[std::size_t(sensor.lidar)];
    if (sample) sample_returns(scan, sweep.lidars[std::size_t(sensor.lidar)].range_noise, own, *sample);
    if (!weather.clear() || find_values<std::int32_t>(scan.channels, "source")) {
        const WeatherSensor in_weather = weather_sensor(sensor, rays);
        WeatherInput input{
            .weather = weather,
            .sensor = in_weather,
            .scan = scan,
            .response = sweep.intensity_response,
            .world_offset_m = sweep.world_offset_m,
            .trace = [this](const WorldRays& traced) { return scene.renderer().forward(traced); },
            .seed = sample.value_or(0)};
        for (std::size_t i = 0; i < scan.ring.size(); ++i)
            input.blind.push_back(never_seen(sensor, scan.ring[i], scan.image.direction[i]) >=
                                  kDropThreshold);
        add_weather(scan, input);
    }
    if (!sample || !weather.clear())
        for (float& intensity : scan.image.intensity) intensity = own.quantised(intensity);
    for (SecondReturn& echo : scan.second_returns)
        for (float& intensity : echo.intensity) intensity = own.quantised(intensity);
}

/// Uploads the scene around the sensor, and moves the instances to their poses. Leaves
/// out hidden instances.
void ScanRenderer::Impl::bring(const ScanStrand& strand, const SensorChoice& sensor, double time_s,
                               std::vector<InstancePose> placed) {
    // Waits for pending scans, because loading blocks can replace the renderer that they
    // use.
    if (!layout.blocks.empty()) settle();
    for (std::size_t i = 0; i < placed.size(); ++i) placed[i].present = placed[i].present && shown[i];
    const glm::vec3 sensor_m(sweep.world_from_sensor(sensor.lidar).at(time_s).translation);
    scene.bring(sensor_m, limits_of(sensor).max_m);
    renderer_of(strand).move(placed, sensor_m);
}

/// Renders a scan. The track of the sensor must have been set before.
/// @param placed poses of the instances at the time of the scan
RenderedScan ScanRenderer::take(const SensorChoice& sensor, double time_s, std::vector<InstancePose> placed,
                                std::optional<std::uint64_t> sample) {
    Impl& s = *impl_;
    const std::optional<RayTable> of_now = s.rays_of_scan(sensor, time_s);
    const RayTable& whole = of_now ? *of_now : sensor.rays;
    const SensorConfig config = s.config_of(sensor);
    if (sensor.grid && config.returns > 1)
        throw UsageError(fmt::format(
            "sensor.returns: found 2 for {}, expected 1, because its image has one range per pixel",
            sensor.name));
    const std::optional<RayTable> parts = split_beams(whole, config, sensor.name);
    const RayTable& table = parts ? *parts : whole;
    if (table.size() == 0)
        throw UsageError(
            fmt::format("cannot render {}: this sensor does not spin and defines no rays; use another sensor",
                        sensor.name));
    s.send();
    s.bring(s.first, sensor, time_s, std::move(placed));
    const bool of_rays = s.refines_rays(sensor, whole);
    RenderedScan scan = s.cast(sensor, table, time_s, of_rays && !parts);
    if (parts) scan = s.join(sensor, scan, whole, config);
    const SeenByLog log{s.coverage, s.sweep.world_offset_m,
                        std::min(sensor.limits.max_m, double(s.config.dataset.max_range_m))};
    add_scan_channels(scan, log, s.wanted);
    tell_unseen(scan, log);
    if (of_rays && parts) s.refine(scan);
    else if (of_rays) take_refined(scan, s.first.known_rays.front()->refined(s.scene.renderer().stream()));
    const bool of_cells =
        sensor.grid && s.refines({sensor.grid->rows, sensor.grid->columns, sensor.grid->name});
    if (of_cells) {
        scan = project_scan(scan, *sensor.grid);
        s.refine(scan);
    }
    if (!s.wants(kIncidence))
        std::erase_if(scan.channels,
                      [](const ScanChannel& channel) { return channel.info.name == kIncidence; });
    s.measure(scan, sensor, whole, sample);
    return sensor.grid && !of_cells ? project_scan(scan, *sensor.grid) : scan;
}

}  // namespace relidar
