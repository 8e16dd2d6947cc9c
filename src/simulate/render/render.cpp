// SPDX-License-Identifier: Apache-2.0
// Renders a scan: computes the sweep of the sensor, traces its rays, joins sub-rays,
// corrects the ray-drop, and adds noise and weather. ScanRenderer::Impl::render() runs
// these steps.
#include <relidar/simulate/render.hpp>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <span>
#include <utility>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/diff/accel.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include "gpu/context.hpp"
#include "simulate/render/channel_makers.hpp"
#include "simulate/render/empty_scan.hpp"
#include "simulate/render/footprint.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"
#include "simulate/weather/air.hpp"

namespace relidar {

namespace {

constexpr int kSideBySide = 4;  // number of scans that a GPU renders in parallel

void check_has_normals(const Config& config, const ChannelInfo& channel, const char* action) {
    if (!channel.needs_normals || get_primitive_kind(config.image.primitive).has_normals) return;
    throw UsageError(
        fmt::format("{}: the channel {} needs normals, but image.primitive={} has none; use surfels or other "
                    "channels",
                    action, channel.name, get_primitive_kind(config.image.primitive).name));
}

TraceOptions make_trace_options(const Config& config) {
    for (const ChannelInfo& channel : parse_channels(config.render.channels))
        check_has_normals(config, channel, "setting render.channels");
    return make_rendering_trace_options(config);
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

/// Drops beams whose range is outside the sensor's limits. Before, only the ranges of
/// their sub-rays were compared with the limits.
void drop_out_of_range_beams(RenderedScan& scan, const RangeLimits& limits) {
    for (std::size_t i = 0; i < scan.image.drop_prob.size(); ++i)
        if (!limits.contains(scan.image.range_m[i]) || !limits.contains(scan.median_range_m[i]))
            scan.image.drop_prob[i] = 1.0f;
}

/// Replaces the drop probabilities of a scan by the output of a network. A probability of
/// 1 stays, because such a ray hit nothing that the sensor can measure.
void replace_drop_probabilities(RenderedScan& scan, std::span<const float> refined) {
    std::vector<float>& drop_prob = scan.image.drop_prob;
    for (std::size_t i = 0; i < drop_prob.size(); ++i)
        if (drop_prob[i] < 1.0f) drop_prob[i] = refined[i];
}

/// Returns the properties of a sensor that determine how weather affects its scans.
/// @param rays rays of the sensor, which define the beam divergence
/// @param step quantisation step of the intensities, or 0
WeatherSensor make_weather_sensor(const Config& config, const RayTable& rays, const RangeLimits& limits,
                                  double step) {
    WeatherSensor result;
    const double divergence_rad = rays.find_largest_divergence();
    if (config.sensor.divergence_mrad > 0.0) result.divergence_rad = 1e-3 * config.sensor.divergence_mrad;
    else if (divergence_rad > 0.0) result.divergence_rad = divergence_rad;
    if (step > 0.0) result.darkest = 0.5 * step;
    // The sensor reports every intensity below half a step as 0. Uses the middle of this
    // interval.
    result.weakest_reflectivity = 0.5 * result.darkest;
    result.separation_m = config.sensor.return_separation_m;
    result.min_range_m = limits.min_m, result.max_range_m = limits.max_m;
    return result;
}

/// Returns false if every return of the log has intensity 0.
bool has_intensities(const std::vector<IntensityScatter>& scatter) {
    const auto is_dark = [](const IntensityScatter& lidar) {
        return !lidar.empty() && std::ranges::all_of(lidar.values, [](float value) { return value == 0.0f; });
    };
    return scatter.empty() || !std::ranges::all_of(scatter, is_dark);
}

}  // namespace

Pose RenderedScan::get_firing_pose(std::size_t ray) const {
    return track.pose.empty() ? world_from_sensor
                              : track.at(time_s + static_cast<double>(time_offset_s[ray]));
}

const std::vector<float>& select_point_ranges(const RenderedScan& scan, const Config& config) {
    return config.render.points == "median" ? scan.median_range_m : scan.image.range_m;
}

std::vector<float> compute_range_spread(const RenderedScan& scan) {
    std::vector<float> spread_m(scan.mean_range_m.size());
    for (std::size_t i = 0; i < spread_m.size(); ++i)
        spread_m[i] = std::abs(scan.median_range_m[i] - scan.mean_range_m[i]);
    return spread_m;
}

ScanRenderer::Impl::Impl(Device& on, const Scene& all, const Config& settings_of_run,
                         const Sequence& sequence)
    : device(on),
      config(use_farthest_return(settings_of_run, sequence)),
      first_origin_m(get_first_origin(sequence)),
      settings{.channels = parse_channels(config.render.channels),
               .scatter = std::vector<IntensityScatter>(sequence.lidars.size())},
      sweeps(config, all, sequence),
      scene(device, all, settings_of_run, {.accel = {}, .trace = make_trace_options(config)}),
      lanes(std::make_unique<RenderLanes>(device, scene)) {}

ScanPlan ScanRenderer::Impl::plan(const Sweep& sweep, bool is_sampled) const {
    return plan_scan(sweep.sensor, sweep.rays(), config, settings, lanes->network(), is_sampled);
}

bool ScanRenderer::Impl::has_channel(const std::string& name) const {
    return std::ranges::find(settings.channels, name, &ChannelInfo::name) != settings.channels.end();
}

SeenByLog ScanRenderer::Impl::compute_seen_by_log(const SensorChoice& sensor) const {
    return {settings.coverage, sweeps.log().world_offset_m,
            std::min(sensor.limits.max_m, double(config.dataset.max_range_m))};
}

/// Returns the data from which the channels of a scan are computed.
ScanContext ScanRenderer::Impl::make_scan_context(const Sweep& sweep) {
    ScanContext context{compute_seen_by_log(sweep.sensor), sweeps.log().world_from_sensor(sweep.sensor.lidar),
                        sweep.instances};
    if (!has_channel("class")) return context;
    context.classes = compute_instance_classes(sweeps.layout(), sweeps.log());
    if (!class_finder && !class_map.empty()) class_finder = std::make_unique<ClassFinder>(class_map);
    context.background = class_finder.get();
    return context;
}

/// Loads the part of the scene around the sensor, and moves the instances to their poses.
void ScanRenderer::Impl::load_scene(const RenderLane& lane, const Sweep& sweep) {
    // Waits for pending scans, because loading parts of the scene can replace the
    // renderer that these scans use.
    if (!sweeps.layout().blocks.empty()) finish_pending();
    const glm::vec3 sensor_m(sweep.pose.translation);
    scene.make_resident(sensor_m, sweeps.get_limits(sweep.sensor).max_m);
    lanes->renderer(lane).move(sweep.instances, sensor_m);
}

/// Records GPU commands that trace rays and compute the measurements. Call load_scene()
/// before.
/// @param corrects_drops true to run the ray-drop network as well
std::shared_ptr<SensorRays> ScanRenderer::Impl::record(RenderLane& lane, const Sweep& sweep,
                                                       const RayTable& rays, bool corrects_drops) try {
    const SensorChoice& sensor = sweep.sensor;
    const std::shared_ptr<SensorRays> recorded = lane.upload(device, sensor, rays, [&](std::size_t index) {
        return sweeps.get_permanent_drop_probability(sensor, rays.channel[index], rays.direction[index]);
    });
    Renderer& renderer = lanes->renderer(lane);
    recorded->fire(renderer.stream(), sweep.world_from_sensor, sweep.time_s);
    renderer.record_forward(recorded->batch());
    recorded->measure(
        renderer.stream(), renderer.rendered(),
        {config.render.range, sensor.beams, sweeps.log().intensity_response, sensor.limits, kMinWeight});
    if (corrects_drops)
        recorded->refine(renderer.stream(), lanes->refiner(lane).pass(),
                         glm::vec3(sweep.pose.translation + sweeps.log().world_offset_m - first_origin_m));
    return recorded;
} catch (...) {
    wait_for_device();  // because the next scan may replace arrays that recorded commands use
    throw;
}

/// Traces rays and waits for the result.
/// @param corrects_drops true to run the ray-drop network as well
ScanRenderer::Impl::TracedScan ScanRenderer::Impl::trace(const Sweep& sweep, const RayTable& table,
                                                         bool corrects_drops) {
    Renderer& renderer = scene.renderer();
    const auto start = std::chrono::steady_clock::now();
    const std::shared_ptr<SensorRays> rays = record(lanes->first(), sweep, table, corrects_drops);
    const std::span<const shared::MeasuredRay> measured = rays->wait(renderer.stream());
    renderer.check_pass_cap();

    RenderedScan scan = make_scan_without_measurements(table);
    scan.trace_ms =
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
    fill_scan(scan, measured);
    const glm::dvec3& offset_m = sweeps.log().world_offset_m;
    scan.track = shift_track(sweep.world_from_sensor, offset_m);
    scan.world_from_sensor = {sweep.pose.rotation, sweep.pose.translation + offset_m};
    scan.time_s = sweep.time_s;
    // If there is a ray-drop network, adds the incidence channel, because it is an input
    // of the network.
    std::vector<ChannelInfo> channels = settings.channels;
    if (lanes->network() && !has_channel(kIncidence)) channels.push_back(parse_channels(kIncidence).front());
    add_ray_channels(scan, measured, needs_rendering(channels) ? renderer.download_rendering() : Rendering{},
                     channels);
    return {std::move(scan), corrects_drops ? rays->refined(renderer.stream()) : std::span<const float>{}};
}

/// Traces several sub-rays for each beam and joins them to one return. If a beam hits
/// several surfaces, traces it again with more sub-rays.
RenderedScan ScanRenderer::Impl::trace_beams(const Sweep& sweep, SensorConfig beams) {
    const RayTable& rays = sweep.rays();
    const auto split = [&](const RayTable& some) {
        return split_rays(some, beams.sub_rays, 1e-3 * beams.divergence_mrad);
    };
    const RenderedScan parts = trace(sweep, split(rays)).scan;
    RenderedScan scan = join_footprints(parts, rays, beams);
    const std::vector<std::size_t> edges = find_multi_surface_beams(parts, rays, beams);
    if (!edges.empty() && edges.size() * kEdgeParts <= kMaxRays) {
        const RayTable edge_rays = select_rays(rays, edges);
        beams.sub_rays = kEdgeParts;
        replace_scan_rays(scan, edges,
                          join_footprints(trace(sweep, split(edge_rays)).scan, edge_rays, beams));
    }
    drop_out_of_range_beams(scan, sweep.sensor.limits);
    return scan;
}

/// Runs the ray-drop network on the host.
void ScanRenderer::Impl::correct_drops(RenderedScan& scan) {
    replace_drop_probabilities(scan,
                               lanes->refiner(lanes->first())
                                   .refine(make_drop_image(scan, lanes->network()->inputs, first_origin_m)));
}

/// Converts expected values to measured values. Draws random returns, adds weather, and
/// rounds intensities to the steps of the sensor.
void ScanRenderer::Impl::measure(RenderedScan& scan, const Sweep& sweep,
                                 std::optional<std::uint64_t> sample) {
    const SensorChoice& sensor = sweep.sensor;
    const Sequence& log = sweeps.log();
    const IntensityScatter& scatter = settings.scatter[std::size_t(sensor.lidar)];
    if (sample) sample_returns(scan, log.lidars[std::size_t(sensor.lidar)].range_noise, scatter, *sample);
    if (!settings.weather.clear() || find_values<std::int32_t>(scan.channels, "source")) {
        const WeatherSensor in_weather =
            make_weather_sensor(config, sweep.rays(), sweeps.get_limits(sensor), scatter.step);
        WeatherInput input{.weather = settings.weather,
                           .sensor = in_weather,
                           .scan = scan,
                           .response = log.intensity_response,
                           .world_offset_m = log.world_offset_m,
                           .trace = [this](const WorldRays& rays) { return scene.renderer().forward(rays); },
                           .seed = sample.value_or(0)};
        for (std::size_t i = 0; i < scan.ring.size(); ++i)
            input.blind.push_back(sweeps.get_permanent_drop_probability(
                                      sensor, scan.ring[i], scan.image.direction[i]) >= kDropThreshold);
        add_weather(scan, input);
    }
    if (!sample || !settings.weather.clear())
        for (float& intensity : scan.image.intensity) intensity = scatter.round_to_step(intensity);
    for (SecondReturn& echo : scan.second_returns)
        for (float& intensity : echo.intensity) intensity = scatter.round_to_step(intensity);
}

/// Renders the scan of a sweep, from tracing the rays to weather and rounding.
RenderedScan ScanRenderer::Impl::render(const Sweep& sweep, std::optional<std::uint64_t> sample) {
    using Network = ScanPlan::Network;
    const SensorChoice& sensor = sweep.sensor;
    const ScanPlan plan = this->plan(sweep, sample.has_value());
    lanes->submit_batch();
    load_scene(lanes->first(), sweep);
    auto [scan, drops] = plan.splits_beams() ? TracedScan{trace_beams(sweep, plan.beams), {}}
                                             : trace(sweep, sweep.rays(), plan.network == Network::device);
    add_scan_channels(scan, make_scan_context(sweep), settings.channels);
    set_unseen_share(scan, compute_seen_by_log(sensor));
    std::vector<ActorView> views;
    if (settings.has_views) views = count_first_hits(scan);
    if (plan.network == Network::cells) scan = project_scan(scan, *sensor.grid);
    if (plan.network == Network::device) replace_drop_probabilities(scan, drops);
    else if (plan.network != Network::none) correct_drops(scan);
    // Traces more rays, so `drops` is invalid afterwards.
    if (settings.has_views) count_isolated_actor_hits(sweep, plan, views);
    if (!has_channel(kIncidence))
        std::erase_if(scan.channels,
                      [](const ScanChannel& channel) { return channel.info.name == kIncidence; });
    measure(scan, sweep, sample);
    if (sensor.grid && plan.network != Network::cells) scan = project_scan(scan, *sensor.grid);
    scan.actor_views = std::move(views);
    return scan;
}

ScanRenderer::ScanRenderer(Device& device, const Scene& scene, const Config& config, const Sequence& sequence)
    : impl_(new Impl(device, scene, config, sequence)) {}
ScanRenderer::ScanRenderer(Device& device, const Run& run)
    : ScanRenderer(device, run.scene, run.config, run.sequence) {
    if (run.config.refine.enabled && !run.drop_network.empty()) refine_drops(run.drop_network);
    set_observed_space(run.coverage);
    classify_background(run.classes);
    set_intensity_scatter(run.intensity_scatter);
}

void ScanRenderer::set_visible_instances(const std::vector<bool>& shown) {
    impl_->sweeps.set_visible_instances(shown);
}

void ScanRenderer::refine_drops(const DropNetwork& network) {
    // The result is not used. The call throws an error if the network has inputs that
    // cannot be rendered.
    list_drop_channel_indices(network.inputs);
    impl_->finish_pending();
    impl_->lanes->set_network(network);
}

void ScanRenderer::enable_channels(const std::string& names) {
    for (const ChannelInfo& channel : parse_channels(names)) {
        if (impl_->has_channel(channel.name)) continue;
        check_has_normals(impl_->config, channel, "choosing channels");
        impl_->settings.channels.push_back(channel);
    }
}

void ScanRenderer::side_by_side(int count) {
    if (count < 1)
        throw UsageError(fmt::format(
            "cannot render several scans at the same time: found {} scans, expected at least 1", count));
    impl_->finish_pending();
    impl_->lanes->set_max_lanes(count);
}

int ScanRenderer::choose_max_lanes(const Device& device) {
    return device.impl().forced.side_by_side.value_or(device.info().type == "CPU" ? 1 : kSideBySide);
}

int ScanRenderer::side_by_side() const {
    return impl_->sweeps.layout().blocks.empty() ? impl_->lanes->most() : 1;
}

void ScanRenderer::enable_actor_views(bool enabled) { impl_->settings.has_views = enabled; }

void ScanRenderer::classify_background(const ClassMap& map) {
    impl_->class_map = map;
    impl_->class_finder.reset();
}

bool ScanRenderer::has_classes() const { return !impl_->class_map.empty(); }

void ScanRenderer::set_observed_space(const Coverage& coverage) { impl_->settings.coverage = coverage; }

void ScanRenderer::set_intensity_scatter(const std::vector<IntensityScatter>& scatter) {
    impl_->settings.scatter = scatter;
    impl_->settings.scatter.resize(impl_->sweeps.log().lidars.size());
}

void ScanRenderer::set_weather(const Weather& weather) {
    check_weather(weather);
    if (!weather.clear() && !has_intensities(impl_->settings.scatter))
        throw UsageError(
            "weather cannot be simulated, because the log of the run has no intensities, which "
            "define the brightness of surfaces");
    impl_->settings.weather = weather;
}

bool ScanRenderer::refines(const SensorChoice& sensor) const {
    return is_drop_correction_used(impl_->lanes->network(), sensor);
}

const KernelTimes& ScanRenderer::times() const { return impl_->scene.times(); }

RenderedScan ScanRenderer::render(const SensorChoice& sensor, double time_s, const Pose& sensor_offset,
                                  std::optional<std::uint64_t> sample) {
    const SensorChoice followed = impl_->sweeps.align_with_log(sensor, time_s);
    return impl_->render(impl_->sweeps.make(followed, time_s, sensor_offset), sample);
}

RenderedScan ScanRenderer::render(const SensorChoice& sensor, const ScanRequest& request,
                                  std::optional<std::uint64_t> sample) {
    return impl_->render(impl_->sweeps.make(sensor, request), sample);
}

}  // namespace relidar
