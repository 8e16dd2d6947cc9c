// SPDX-License-Identifier: Apache-2.0
// Renders a scan: traces the rays of a sweep, joins sub-rays, corrects the ray-drop, and
// adds noise and weather. ScanRenderer::Impl::render_sweep() runs these steps.
#include <relidar/simulate/render.hpp>

#include <relidar/log/sensor_pattern.hpp>
#include <relidar/run/run.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/scene/labels.hpp>
#include "base/fail.hpp"
#include "gpu/context.hpp"
#include "simulate/channels/channel_pairs.hpp"
#include "simulate/render/footprint.hpp"
#include "simulate/render/render_lanes.hpp"
#include "simulate/render/scan_renderer.hpp"
#include "simulate/weather/air.hpp"

namespace relidar {

namespace {

constexpr int kSideBySide = 4;  // number of scans that a GPU renders in parallel
// Visible at the maximum range, as in the data sheets of the HDL-64E and of the OS1.
constexpr double kSpecifiedReflectivity = 0.8;
// Visible at short range: an assumption. Corresponds to receivers that collect a constant
// share of light within 6 to 8 m.
constexpr double kNearReflectivity = 0.0025;
// Noise: half a step of an 8-bit intensity at 80 m. The limit of stray light belongs to
// the constants of bloom, which were fitted to KITTI's intensities.
constexpr double kNoisePower = 0.5 / 255.0 / (80.0 * 80.0), kStrayPower = 0.005 / (80.0 * 80.0);

/// Checks that the primitives of the scene can provide a channel.
/// @throws UsageError for a channel that needs normals in a scene of 3D Gaussians
void check_channel(const Config& config, const ChannelInfo& channel, const char* error_prefix) {
    if (!channel.needs_normals || properties_of(config.image.primitive).has_normals) return;
    fail<UsageError>("{}: the channel {} needs normals, which image.primitive={} has not; expected surfel",
                     error_prefix, channel.name, properties_of(config.image.primitive).name);
}

/// Returns the options of the renderer. First rejects channels that the scene cannot
/// provide, so that the error precedes the slow upload of the scene.
TraceOptions trace_options(const Config& config) {
    for (const ChannelInfo& channel : parse_channels(config.render.channels))
        check_channel(config, channel, "setting render.channels");
    return rendering_options(config);
}

/// Copies the measurements of the device to the arrays of a scan, one value per ray.
void copy_measurements(RenderedScan& scan, std::span<const shared::MeasuredRay> measured) {
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

/// Replaces the drop probabilities by those of the ray-drop network. Keeps a probability
/// of 1, because such a ray hits nothing that the sensor can measure.
void replace_drop(RenderedScan& scan, std::span<const float> network_drop_probabilities) {
    std::vector<float>& drop_prob = scan.image.drop_prob;
    for (std::size_t i = 0; i < drop_prob.size(); ++i)
        if (drop_prob[i] < 1.0f) drop_prob[i] = network_drop_probabilities[i];
}

/// Removes the second returns of dropped beams. Network and range limits drop beams after
/// their sub-rays were joined.
void drop_second_returns(RenderedScan& scan) {
    for (AdditionalReturns& second : scan.second_returns)
        for (std::size_t i = 0; i < second.range_m.size(); ++i)
            if (!is_ray_returned(scan.image.drop_prob[i], scan.median_range_m[i]))
                second.range_m[i] = second.intensity[i] = 0.0f;
}

/// Returns the properties of a sensor that determine how weather affects its scans.
/// Powers are relative: a surface returns its reflectivity / range^2.
/// @param rays rays of the sensor, which define the beam divergence
/// @param name name of the sensor; selects the maximum range of its data sheet
WeatherSensorProperties weather_properties(const Config& config, const RayTable& rays,
                                           const RangeLimits& limits, const std::string& name) {
    const double specified_m = nominal_max_range_m(name).value_or(limits.max_m);
    WeatherSensorProperties result{
        .separation_m = config.sensor.return_separation_m,
        .min_range_m = limits.min_m,
        .max_range_m = limits.max_m,
        .darkest = kNoisePower * limits.max_m * limits.max_m,  // its power at max_m is kNoisePower
        .weakest_reflectivity = kNearReflectivity,
        .min_specified_power = kSpecifiedReflectivity / (specified_m * specified_m),
        .min_stray_power = kStrayPower};
    // The setting replaces the divergence of the sensor. Without both, the default stays.
    if (config.sensor.divergence_mrad > 0.0) result.divergence_rad = 1e-3 * config.sensor.divergence_mrad;
    else if (rays.max_divergence_rad() > 0.0) result.divergence_rad = rays.max_divergence_rad();
    return result;
}

/// Returns RayDropNetwork::actor_logits of the beams of a sensor. Only sensors of the log
/// have the lasers that the network knows.
std::vector<float> actor_logits_of(const RayDropNetwork* network, const Log& log,
                                   const SimulatedSensor& sensor) {
    std::vector<float> logits;
    if (!network || !sensor.is_log_lidar) return logits;
    for (std::uint16_t k = 0; const auto beam = log.find_global_beam(sensor.lidar, k); ++k)
        if (*beam < network->actor_logits.size()) logits.push_back(network->actor_logits[*beam]);
    return logits;
}

}  // namespace

Pose RenderedScan::firing_pose(std::size_t ray) const {
    return track.pose.empty() ? world_from_sensor
                              : track.pose_at(time_s + static_cast<double>(time_offset_s[ray]));
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

/// Uploads the scene, or later its blocks. Sets no network, weather or observed space.
/// @param log gives the sensors, and the recorded paths of vehicle and actors
ScanRenderer::Impl::Impl(Device& gpu, const Scene& full_scene, const Config& run_config, const Log& log)
    : device(gpu),
      config(with_max_range(run_config, log)),
      first_origin_m(first_position(log)),
      settings{.channels = parse_channels(config.render.channels),
               .scatter = std::vector<IntensityScatterModel>(log.lidars.size())},
      sweeps(config, full_scene, log),
      standing(list_standing(full_scene, log, config.init)),
      scene(device, full_scene, config, {.accel = {}, .trace = trace_options(config)}),
      lanes(std::make_unique<RenderLanes>(device, scene)) {}

ScanRenderPlan ScanRenderer::Impl::plan_sweep(const SimulatedSweep& sweep, bool sampled) const {
    return plan_scan(sweep.sensor, sweep.rays(), config, settings, lanes->drop_network(), sampled);
}

bool ScanRenderer::Impl::has_channel(const std::string& name) const {
    return std::ranges::find(settings.channels, name, &ChannelInfo::name) != settings.channels.end();
}

LogObservedSpace ScanRenderer::Impl::observed_space_of(const SimulatedSensor& sensor) const {
    return {settings.coverage, sweeps.log().world_offset_m,
            std::min(sensor.limits.max_m, double(config.dataset.max_range_m))};
}

/// Returns the data for all channels. Looks up classes only for the channel "class".
ChannelInputs ScanRenderer::Impl::channel_inputs(const SimulatedSweep& sweep) {
    ChannelInputs context{observed_space_of(sweep.sensor),
                          {sweeps.log().lidar_track(sweep.sensor.lidar), sweep.instances}};
    if (!has_channel("class")) return context;
    context.classes = instance_classes(sweeps.layout(), sweeps.log());
    if (!class_finder && !class_map.empty()) class_finder = std::make_unique<SurfaceClassLookup>(class_map);
    context.background = class_finder.get();
    return context;
}

/// Loads the part of the scene around the sensor, and moves the instances to their poses.
void ScanRenderer::Impl::prepare_scene(RenderLane& lane, const SimulatedSweep& sweep) {
    // Loading blocks can replace the renderer that pending scans use.
    if (scene.has_blocks()) finish_pending();
    const glm::vec3 sensor_m(sweep.pose.translation);
    scene.load_near(sensor_m, sweeps.limits_of(sweep.sensor).max_m);
    lane.renderer().record_poses(sweep.instances, sensor_m);
}

/// Records GPU commands that trace rays of a sweep and compute their measurements. Call
/// prepare_scene() before.
/// @param with_network true to run the ray-drop network as well
/// @return rays whose measurements the caller can wait for
std::shared_ptr<DeviceSensorRays> ScanRenderer::Impl::record_trace(RenderLane& lane,
                                                                   const SimulatedSweep& sweep,
                                                                   const RayTable& ray_table,
                                                                   bool with_network) {
    const SimulatedSensor& sensor = sweep.sensor;
    const Log& log = sweeps.log();
    Renderer& renderer = lane.renderer();
    Stream& stream = renderer.stream();
    const std::shared_ptr<DeviceSensorRays> rays = lane.upload_rays(sensor, ray_table, [&](std::size_t ray) {
        return sweeps.permanent_drop(sensor, ray_table.channel[ray], ray_table.direction[ray]);
    });
    rays->place(stream, sweep.world_from_sensor, sweep.time_s);
    renderer.record_forward(rays->world_batch());
    // A camera has no beams, and its surfaces are equally bright at all distances.
    const IntensityResponse response = sensor.camera ? IntensityResponse{} : log.intensity_response;
    const std::vector<Beam> beams =
        sensor.is_log_lidar || sensor.camera
            ? sensor.beams
            : mean_responses(ray_table, log.lidars[std::size_t(sensor.lidar)].sensor.beams);
    rays->record_measure(stream, renderer.last_batch(),
                         {.range = config.render.range,
                          .beams = beams,
                          .response = response,
                          .limits = sensor.limits,
                          .min_weight = kMinWeight,
                          .actor_logits = actor_logits_of(lanes->drop_network(), log, sensor)});
    if (with_network) {
        const glm::dvec3 sensor_m = sweep.pose.translation + log.world_offset_m - first_origin_m;
        rays->record_drop(stream, lane.refiner->inference(), glm::vec3(sensor_m));
    }
    return rays;
}

/// Traces rays and waits for the result. The scan has the poses of the dataset frame,
/// whereas the scene is shifted by Log::world_offset_m.
ScanRenderer::Impl::TracedScan ScanRenderer::Impl::trace_rays(const SimulatedSweep& sweep,
                                                              const RayTable& ray_table,
                                                              ScanRenderPlan::RayDropStage network) {
    using Network = ScanRenderPlan::RayDropStage;
    Renderer& renderer = scene.renderer();
    const auto start = std::chrono::steady_clock::now();
    const std::shared_ptr<DeviceSensorRays> rays =
        record_trace(lanes->first(), sweep, ray_table, network == Network::device);
    const auto [measured, network_drops] = rays->wait_measured(renderer.stream());
    renderer.check_truncation();

    RenderedScan scan = empty_scan(ray_table);
    scan.trace_ms =
        std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
    copy_measurements(scan, measured);
    const glm::dvec3& offset_m = sweeps.log().world_offset_m;
    scan.track = shift_track(sweep.world_from_sensor, offset_m);
    scan.world_from_sensor = {sweep.pose.rotation, sweep.pose.translation + offset_m};
    scan.time_s = sweep.time_s;
    // A network that runs on the host needs the channel "incidence", even if it is not
    // requested. render_sweep() removes it afterwards.
    std::vector<ChannelInfo> channels = settings.channels;
    const bool is_for_host = network == Network::beams || network == Network::cells;
    if (is_for_host && !has_channel(kIncidenceChannel))
        channels.push_back(parse_channels(kIncidenceChannel).front());
    add_ray_channels(scan, measured,
                     needs_rendering(channels) ? renderer.download_rays() : RenderedRayValues{}, channels);
    return {std::move(scan), {network_drops.begin(), network_drops.end()}};
}

/// Traces sub-rays (parts) of each beam and joins them to returns. Beams at edges, which
/// hit several surfaces, are traced again with more sub-rays if kMaxRays allows them.
RenderedScan ScanRenderer::Impl::trace_footprint(const SimulatedSweep& sweep, const ScanRenderPlan& plan) {
    const RayTable& rays = sweep.rays();
    const auto trace_parts = [&](const RayTable& beams, int sub_rays_per_beam) {
        const RayTable split = split_rays(beams, sub_rays_per_beam, 1e-3 * plan.beams.divergence_mrad);
        return trace_rays(sweep, split, plan.network).scan;
    };
    const WeatherSensorProperties detection =
        weather_properties(config, rays, sweeps.limits_of(sweep.sensor), sweep.sensor.name);
    const RenderedScan parts = trace_parts(rays, plan.beams.sub_rays);
    const IntensityResponse& response = sweeps.log().intensity_response;
    RenderedScan scan = join_sub_rays(parts, rays, plan.beams, response, detection);
    const std::vector<std::size_t> edges = find_edge_beams(parts, rays, plan.beams);
    if (!edges.empty() && edges.size() * kEdgeParts <= kMaxRays) {
        SensorConfig edge_config = plan.beams;
        edge_config.sub_rays = kEdgeParts;
        const RayTable edge_rays = select_rays(rays, edges);
        const RenderedScan edge_parts = trace_parts(edge_rays, kEdgeParts);
        replace_rays(scan, edges, join_sub_rays(edge_parts, edge_rays, edge_config, response, detection));
    }
    // The sensor does not report beams whose joined range is outside its limits.
    const RangeLimits& limits = sweep.sensor.limits;
    for (std::size_t i = 0; i < scan.image.drop_prob.size(); ++i)
        if (!limits.contains(scan.image.range_m[i]) || !limits.contains(scan.median_range_m[i]))
            scan.image.drop_prob[i] = 1.0f;
    return scan;
}

/// Adds the effects of the weather to a scan, and sets the channel `source`, the cause of
/// each return.
void ScanRenderer::Impl::simulate_weather(RenderedScan& scan, const SimulatedSweep& sweep,
                                          std::uint64_t seed) {
    const SimulatedSensor& sensor = sweep.sensor;
    const Log& log = sweeps.log();
    // The data sheet is that of the LiDAR, not of a grid into which points are binned.
    const std::string& name =
        sensor.is_log_lidar ? log.lidars[std::size_t(sensor.lidar)].sensor.name : sensor.name;
    const WeatherSensorProperties detection =
        weather_properties(config, sweep.rays(), sweeps.limits_of(sensor), name);
    const MotionDuringScan motion{log.lidar_track(sensor.lidar), sweep.instances};
    WeatherInput input{.weather = settings.weather,
                       .sensor = detection,
                       .scan = scan,
                       .response = log.intensity_response,
                       .world_offset_m = log.world_offset_m,
                       // for rays that the weather adds, for example mirrored rays
                       .trace = [this](const WorldRays& rays) { return scene.renderer().render_rays(rays); },
                       .seed = seed,
                       .motion = &motion};
    // A ray that is always dropped is blocked near the sensor, so it hits no rain.
    for (std::size_t i = 0; i < scan.ring.size(); ++i)
        input.is_blocked.push_back(sweeps.permanent_drop(sensor, scan.ring[i], scan.image.direction[i]) >=
                                   kDropThreshold);
    add_weather(scan, input);
}

/// Converts expected values to random measurements: draws returns, adds weather, and
/// rounds intensities to the steps of the sensor.
/// @param seed without a value, the scan keeps its expected values
void ScanRenderer::Impl::apply_noise(RenderedScan& scan, const SimulatedSweep& sweep, SampleSeed seed) {
    const SimulatedSensor& sensor = sweep.sensor;
    const Lidar& lidar = sweeps.log().lidars[std::size_t(sensor.lidar)];
    const IntensityScatterModel& scatter = settings.scatter[std::size_t(sensor.lidar)];
    const bool is_clear = settings.weather.is_clear();
    // Weather is always random. Without a seed, it uses the seed 0.
    if (seed) sample_returns(scan, lidar.range_noise, scatter, *seed, sweeps.limits_of(sensor));
    // In clear air, sets only the channel `source`.
    if (!is_clear || has_channel("source")) simulate_weather(scan, sweep, seed.value_or(0));
    const auto quantise = [&](std::vector<float>& intensities) {
        for (float& intensity : intensities) intensity = scatter.quantise(intensity);
    };
    if (sensor.camera) return;
    // Sampled intensities already have the steps, unless weather changed them. Second
    // returns keep their expected intensities.
    if (!seed || !is_clear) quantise(scan.image.intensity);
    for (AdditionalReturns& second : scan.second_returns) quantise(second.intensity);
}

/// Renders the scan of a sweep: traces rays, computes channels, corrects the ray-drop,
/// adds noise and weather, and projects the scan onto the grid of the sensor.
RenderedScan ScanRenderer::Impl::render_sweep(const SimulatedSweep& sweep, SampleSeed seed) {
    using Network = ScanRenderPlan::RayDropStage;
    const WaitOnError wait_on_error{*this};
    const SimulatedSensor& sensor = sweep.sensor;
    const ScanRenderPlan plan = plan_sweep(sweep, seed.has_value());
    lanes->submit_batch();
    prepare_scene(lanes->first(), sweep);
    TracedScan traced = plan.has_sub_rays() ? TracedScan{trace_footprint(sweep, plan)}
                                            : trace_rays(sweep, sweep.rays(), plan.network);
    RenderedScan scan = std::move(traced.scan);
    // Channels and views need the drop probabilities before the network changes them.
    add_beam_channels(scan, channel_inputs(sweep), settings.channels);
    if (sweeps.is_background_shown()) set_unseen_share(scan, observed_space_of(sensor));
    block_rays(scan, sensor.body, sensor.limits);  // rays that hit the own vehicle
    if (settings.has_views) scan.actor_views = count_views(sweep, plan, scan);
    // Without a network for the cells of the grid, the scan is projected last.
    if (plan.network == Network::cells) scan = project_scan(scan, *sensor.grid);
    if (plan.network == Network::device) replace_drop(scan, traced.network_drops);
    else if (plan.network != Network::none)
        replace_drop(scan, lanes->first().refiner->predict_drops(
                               make_drop_image(scan, lanes->drop_network()->inputs, first_origin_m)));
    // trace_rays() may have added this channel for the network.
    if (!has_channel(kIncidenceChannel))
        std::erase_if(scan.channels,
                      [](const ScanChannel& channel) { return channel.info.name == kIncidenceChannel; });
    // Noise draws drops from the probabilities, so it also returns some of these beams.
    if (!seed) drop_second_returns(scan);
    apply_noise(scan, sweep, seed);
    block_rays(scan, sensor.body, sensor.limits);  // removes noise from points of the body
    if (sensor.grid && plan.network != Network::cells) scan = project_scan(scan, *sensor.grid);
    return scan;
}

/// Gives each instance its own model if surfels depend on the pose of the instance: if SH
/// are evaluated for each surfel, or if surfels bend with a walking actor.
ScanRenderer::ScanRenderer(Device& device, const Scene& scene, const Config& config, const Log& log)
    : impl_(config.image.sh_direction == ShDirection::surfel || scene.surfels.bends
                ? new Impl(device, unshare_models(scene), config, log)
                : new Impl(device, scene, config, log)) {}

/// Also uses what the run learned from its log about ray-drop, space and surfaces.
ScanRenderer::ScanRenderer(Device& device, const Run& run)
    : ScanRenderer(device, run.scene, run.config, run.log) {
    if (run.config.refine.enabled && !run.drop_network.empty()) use_network(run.drop_network);
    use_observed(run.coverage);
    use_classes(run.classes);
    use_scatter(run.intensity_scatter);
}

void ScanRenderer::show_instances(const std::vector<bool>& visible_flags) {
    impl_->sweeps.show_instances(visible_flags);
}

void ScanRenderer::use_network(const RayDropNetwork& network) {
    // Only throws an error if the network has inputs that cannot be rendered.
    channel_numbers(network.inputs);
    impl_->finish_pending();
    impl_->lanes->use_network(network);
}

void ScanRenderer::add_channels(const std::string& comma_separated_names) {
    for (const ChannelInfo& channel : parse_channels(comma_separated_names)) {
        if (impl_->has_channel(channel.name)) continue;
        check_channel(impl_->config, channel, "cannot enable channels");
        impl_->settings.channels.push_back(channel);
    }
}

void ScanRenderer::set_parallel(int count) {
    if (count < 1)
        fail<UsageError>("cannot render several scans at the same time: found {} scans, expected at least 1",
                         count);
    impl_->finish_pending();
    impl_->lanes->set_limit(count);
}

int ScanRenderer::default_parallel(const Device& device) {
    return device.impl().forced.side_by_side.value_or(device.info().type == "CPU" ? 1 : kSideBySide);
}

int ScanRenderer::max_parallel() const { return impl_->lanes->parallel_limit(); }

void ScanRenderer::count_actor_rays(bool enabled) { impl_->settings.has_views = enabled; }

void ScanRenderer::use_classes(const SurfaceClassMap& class_map) {
    impl_->class_map = class_map;
    impl_->class_finder.reset();
}

bool ScanRenderer::has_classes() const { return !impl_->class_map.empty(); }

void ScanRenderer::use_observed(const ObservedVoxelSet& observed_voxels) {
    impl_->settings.coverage = observed_voxels;
}

void ScanRenderer::use_scatter(const std::vector<IntensityScatterModel>& scatter) {
    impl_->settings.scatter = scatter;
    impl_->settings.scatter.resize(impl_->sweeps.log().lidars.size());
}

void ScanRenderer::set_weather(const Weather& weather) {
    check_weather(weather);
    // A LiDAR is dark if all its returns in the log have intensity 0.
    const auto is_dark = [](const IntensityScatterModel& lidar) {
        return !lidar.empty() && std::ranges::all_of(lidar.values, [](float value) { return value == 0.0f; });
    };
    const std::vector<IntensityScatterModel>& scatter = impl_->settings.scatter;
    if (!weather.is_clear() && !scatter.empty() && std::ranges::all_of(scatter, is_dark))
        throw UsageError(
            "weather cannot be simulated, because the log of the run has no intensities, which define the "
            "brightness of surfaces");
    impl_->settings.weather = weather;
}

bool ScanRenderer::has_network_for(const SimulatedSensor& sensor) const {
    return corrects_drop(impl_->lanes->drop_network(), sensor);
}

const KernelTimes& ScanRenderer::times() const { return impl_->scene.kernel_times(); }

RenderedScan ScanRenderer::render(const SimulatedSensor& sensor, double time_s, const Pose& offset,
                                  SampleSeed sample) {
    const SimulatedSensor followed = impl_->sweeps.follow_log(sensor, time_s);
    return impl_->render_sweep(impl_->sweeps.on_recorded_path(followed, time_s, offset), sample);
}

RenderedScan ScanRenderer::render(const SimulatedSensor& sensor, const ScanRequest& at, SampleSeed sample) {
    return impl_->render_sweep(impl_->sweeps.of_request(sensor, at), sample);
}

}  // namespace relidar
