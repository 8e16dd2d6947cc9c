// SPDX-License-Identifier: Apache-2.0
// Renders LiDAR scans of a trained scene for any sensor, pose and time.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <relidar/diff/network.hpp>
#include <relidar/gpu/device.hpp>
#include <relidar/log/channels.hpp>
#include <relidar/log/classes.hpp>
#include <relidar/log/coverage.hpp>
#include <relidar/log/points.hpp>
#include <relidar/log/range_image.hpp>
#include <relidar/log/scatter.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/weather.hpp>

namespace relidar {

struct TrainedRun;
struct MountedSensor;

/// Side of an actor that the log has not observed, but that rays of the simulated scan
/// hit or pass through. n_rays is the number of these simulated rays.
struct UnobservedActorSide {
    std::string track;
    BoxSide side;
    std::size_t n_rays = 0;
    /// True if this side was filled with mirrored surfels of the actor's other half, so
    /// that rays hit it. False if this side has no surfels, so that rays pass through.
    bool is_completed = false;
};

/// Visibility of an actor, measured as the number of rays that hit it. A ray counts if
/// surfaces absorb at least half of its light, and if its drop probability is below 0.5
/// without the correction by a ray-drop network.
struct ActorVisibility {
    std::string track;
    std::size_t n_rays = 0;  ///< rays that hit the actor first
    /// rays that would hit the actor if no other object hid it
    std::size_t n_rays_alone = 0;
};

/// A simulated scan: a range image with the ray of each pixel. Rays are in the sensor
/// frame at their own firing times.
struct RenderedScan {
    /// Range image. The setting `render.range` selects how its ranges are computed.
    /// `drop_prob` combines two probabilities: that the hit surfels drop the ray, and
    /// that the sensor itself drops the ray. `drop_prob` is 1 if the ray hit nothing
    /// within the sensor's range limits.
    RangeImage image;
    /// [n] Median range along the ray, in metres: the distance at which the transmittance
    /// T falls below 0.5. If T never falls below 0.5, the ray's `image.range_m`.
    std::vector<float> median_range_m;
    /// [n] Mean range along the ray, in metres: the blended depth D divided by the
    /// accumulated alpha W. Equal to the median range if the transmittance T never falls
    /// below 0.5. The mean range does not depend on the setting `render.range`.
    std::vector<float> mean_range_m;
    std::vector<float> weight;  ///< [n] alpha accumulated along the ray (W).
    /// [n] Object that the ray hit, as an index into Scene::instances. -1 if the ray hit
    /// nothing.
    std::vector<std::int32_t> instance;
    /// [n] Firing time of each ray relative to `time_s`, in seconds. All times are 0 if
    /// the sensor has no rolling shutter.
    std::vector<float> time_offset_s;
    std::vector<std::uint16_t> ring;  ///< [n] beam number of the ray; 0 is the highest beam
    /// Second returns of the rays. Their ranges are median ranges, like `median_range_m`.
    /// Empty if `sensor.returns` is not 2.
    std::vector<AdditionalReturns> second_returns = {};
    /// Optional channels, with one value per ray: the channels of the setting
    /// `render.channels`, and `source` (cause of the return) if weather is set. A channel
    /// that cannot be computed is missing. For example, "seen" is missing if the run does
    /// not store which space the log observed. A caller may append channels, which are
    /// then joined, binned, merged and written like all other channels.
    std::vector<ScanChannel> channels = {};
    /// Fraction of rays that pass mostly through space that the log did not observe: the
    /// log observed less than half of their path. Computed from all rays, or from about a
    /// thousand of them. Empty if the run does not store which space the log observed, or
    /// if the scan does not show the background.
    std::optional<double> unseen_share = {};
    /// Sides of actors that the log did not observe, although rays of this scan reach
    /// them. Set by the command `relidar render`, not by ScanRenderer.
    std::vector<UnobservedActorSide> unseen_sides = {};
    /// Visibility of each actor that at least one ray would hit if no other object hid
    /// it. Empty if ScanRenderer::enable_actor_visibility() was not called.
    std::vector<ActorVisibility> actor_views = {};
    Pose world_from_sensor;  ///< pose of the sensor at the reference time, in the dataset's world frame
    /// Poses of the sensor during the scan, in the dataset's world frame. The track has a
    /// single pose if all rays are fired from the same pose.
    PoseTrack track;
    double time_s = 0.0;
    double trace_ms = 0.0;

    /// Returns the pose of the sensor at the firing time of a ray, in the dataset's world
    /// frame.
    Pose get_firing_pose(std::size_t ray) const;
};

/// Finds the sides of actors that the log did not observe, although at least five rays of
/// the scan reach them. If such a side has no surfels, these rays pass through it. The
/// side may instead have surfels that were mirrored from the actor's other half. Then the
/// rays hit these surfels. Uses the poses of the actors in the log.
std::vector<UnobservedActorSide> find_unobserved_actor_sides(const RenderedScan& scan, const Scene& scene,
                                                             const LidarSequence& sequence);

/// Computes the pose of the sensor at the firing time of each ray. Many sensors fire all
/// rays of a column at the same time, so the pose is interpolated once per column. Only
/// one thread may use an object of this class.
class FiringPoseInterpolator {
public:
    /// Stores a reference to the scan, which contains the poses of the sensor.
    /// @param scan must outlive this object
    /// @param target_from_dataset transform to the frame in which compute_firing_pose()
    /// returns poses
    explicit FiringPoseInterpolator(const RenderedScan& scan, const Pose& target_from_dataset = {});
    /// Returns the sensor pose at the firing time of a ray: `target_from_dataset *
    /// scan.get_firing_pose(ray)`. The reference is valid until the next call.
    const Pose& compute_firing_pose(std::size_t ray);

private:
    struct CachedFiringPose {
        float time_offset_s;  ///< NaN if no pose is stored yet
        Pose target_from_firing;
    };
    const RenderedScan& scan_;
    const Pose target_from_dataset_;
    const bool moves_;
    /// Last computed pose of each column, which is reused because rays of a column often
    /// fire at the same time. Only one entry if the scan has one row or the sensor does
    /// not move.
    std::vector<CachedFiringPose> made_;
};

/// Limit for the fraction of rays through space that the log did not observe. The program
/// prints a warning above this limit. The log's sensor on its recorded path has a
/// fraction below 0.01, and a sensor in the next lane a few hundredths.
inline constexpr double kMuchUnseen = 0.2;

/// Returns the [n] ranges, in metres, at which the points of a scan are placed. The
/// setting `render.points` selects scan.median_range_m or scan.image.range_m.
const std::vector<float>& select_point_ranges(const RenderedScan& scan, const Config& config);

/// Returns |mean range - median range| of each ray, [n] metres. The value is near 0 on a
/// single surface, and large where a ray passes an edge. It is 0 if the transmittance
/// never falls below 0.5.
std::vector<float> compute_range_spread(const RenderedScan& scan);

/// Computes the inputs of a ray-drop network for a scan.
/// @param scan should have the channel `incidence`; without it all cosines are 0
/// @param channel_names names of the network's input channels
/// @param first_vehicle_position_m [3] result of get_first_vehicle_position(). Sensor
/// positions are relative to this point
RayDropImage make_network_input_image(const RenderedScan& scan, const std::vector<std::string>& channel_names,
                                      const glm::dvec3& first_vehicle_position_m);

/// Returns the first position of the log's vehicle, in the dataset's world frame.
/// @return [3] metres
glm::dvec3 get_first_vehicle_position(const LidarSequence& sequence);

/// Returns the values from which random intensities are drawn: rendered intensity, range,
/// spread, incidence and elevation of each ray.
RenderedIntensityImage make_rendered_intensity_image(const RenderedScan& scan);

/// Replaces the expected values of a scan by one random sample. A ray returns with
/// probability 1 - drop_prob, independently of other rays. Random noise is added to the
/// range of each ray. Its standard deviation depends on the range and on the angle of
/// incidence, which is computed from neighbouring pixels. The intensity is drawn from the
/// intensity model of the LiDAR. Afterwards `drop_prob` is 0 or 1, and `image.range_m`
/// equals `median_range_m`. Second returns keep their expected intensities. The result
/// depends only on seed and time, not on the device.
/// @param intensity_scatter if empty, intensities keep their expected values
/// @param limits returns whose noise exceeds these limits are dropped
void replace_expected_returns_by_sample(RenderedScan& scan, const RangeNoiseTable& range_noise,
                                        const IntensityScatterModel& intensity_scatter, std::uint64_t seed,
                                        const RangeLimits& limits = {});

/// The points of a scan without its other arrays.
struct RenderedPoints {
    LidarPoints points;      ///< all returns, in the order of convert_scan_to_points()
    std::size_t n_rays = 0;  ///< number of rays of the scan
    /// Fraction of rays that pass mostly through space that the log did not observe.
    /// Empty if RenderedScan::unseen_share is.
    std::optional<double> unseen_share = {};
};

/// The sensor to simulate.
struct SimulatedSensor {
    RayTable rays;  ///< Rays of a sweep. Empty for a rosette, because its rays differ in every scan.
    /// Range grid of the output image. After rendering, the simulated points are
    /// projected into this grid. Empty = the image has one pixel per ray.
    std::optional<RangeImageGrid> grid = {};
    /// True for a LiDAR of the log. Only for these LiDARs, training has estimated how
    /// often the sensor itself drops a ray (Scene::sensor_drop).
    bool is_log_lidar = false;
    /// Only for a LiDAR of the log, whose nominal azimuths are in `rays`. If true, a scan
    /// at the time of a recorded sweep uses the azimuths measured in this sweep instead.
    /// A scan at given poses (ScanRequest) keeps the nominal azimuths.
    bool follows_sweeps = false;
    /// Calibration of the beams: range offsets, intensity gains and offsets. Empty =
    /// ranges and intensities are not changed.
    std::vector<Beam> beams = {};
    /// Scan pattern of a sensor that does not spin: directions and firing times. If
    /// `rays` is empty, the rays of each scan are generated from this pattern.
    std::optional<SensorPattern> pattern = {};
    RangeLimits limits = {};  ///< limits of measured ranges
    std::string name = "";
    int lidar = 0;  ///< index of the log's LiDAR that this sensor is or replaces
    /// Number of returns per ray, 1 or 2. 0 = use the setting `sensor.returns`. Two
    /// returns are computed from several sub-rays of each ray. If the settings select
    /// only 1 sub-ray, 9 sub-rays are used.
    int returns = 0;
    /// True: each ray is fired at its own time. False: all rays are fired at the scan's
    /// reference time, as if the scan were motion-compensated. A setting can also switch
    /// rolling shutter off, so use fires_rays_at_different_times() to read the result.
    bool rolling_shutter = true;
};

/// Returns true if the sensor fires its rays at different times. The setting
/// `sensor.rolling_shutter` = `no` overrides SimulatedSensor::rolling_shutter. Without a
/// rolling shutter, all rays are fired at the scan's time, and all points are in the
/// sensor frame at this time.
bool fires_rays_at_different_times(const SimulatedSensor& sensor, const Config& config);

/// Returns a copy of the sensor with the measured azimuths of the log's sweep at this
/// time. If the sensor does not follow the sweeps of the log, or if the log has no sweep
/// at this time, returns the sensor unchanged. ScanRenderer calls this function for scans
/// without a ScanRequest.
/// @param frames frames of the log with their azimuth shifts
SimulatedSensor copy_sensor_with_azimuths_of_sweep(const SimulatedSensor& sensor,
                                                   std::span<const LidarFrame> frames,
                                                   std::span<const Lidar> lidars, double time_s);

/// Returns the sensor that the setting `sensor.grid` selects: a LiDAR of the log, or a
/// grid. For a grid, `sensor.grid_method` selects the method. Either the rays of the grid
/// are cast, or the points of the LiDAR are binned into the grid. The range limits of the
/// LiDAR are intersected with those of the dataset settings. A LiDAR with an unknown scan
/// pattern has empty `rays`, so the caller must set the rays of each scan.
SimulatedSensor make_sensor_from_config(const Config& config, const LidarSequence& sequence, int lidar = 0);
/// Returns the sensor with this name or in this file. Possible values: "native" (the
/// log's LiDAR), a built-in sensor, a sensor file, or a range grid. For the grid
/// "kitti360", the setting `sensor.grid_method` applies.
SimulatedSensor find_or_load_sensor(const std::string& name_or_file, const Config& config,
                                    const LidarSequence& sequence, int lidar = 0);

/// Creates a SimulatedSensor for a sensor that replaces a LiDAR of the log.
SimulatedSensor make_simulated_sensor(const SensorModel& sensor, int lidar = 0);
/// Creates a SimulatedSensor for a sensor of a rig. Copies its number of returns per ray.
SimulatedSensor make_simulated_sensor(const MountedSensor& mounted, int lidar = 0);

/// Merges scans of all sensors of a rig into one scan without image order. Rays are in
/// the frame of the rig, as if the rig were a single sensor. The beam numbers of each
/// scan continue after those of the previous scan. If a scan lacks a channel, its rays
/// get the default value `none` of the channel.
/// @param scans scans at the same time
/// @param rig_from_sensor [scans] mounting pose of each sensor
/// @throws UsageError if two channels have the same name and different types
RenderedScan merge_scans(const std::vector<RenderedScan>& scans, const std::vector<Pose>& rig_from_sensor);

/// Request for a scan at given poses, for example from a trajectory file or a traffic
/// simulator. Poses are in the dataset's world frame, times are in the time of the log
/// (LidarFrame::time_s).
struct ScanRequest {
    double time_s = 0.0;  ///< time at which the sensor head faces forward, in seconds
    /// Poses of the sensor during the sweep. With a rolling shutter, each ray is fired
    /// from the pose at the firing time of the ray. If the track has a single pose, the
    /// sensor does not move.
    PoseTrack dataset_from_sensor;
    /// Poses of all actors that are present. If not set, the actors have the poses of
    /// their tracks at the time of the scan.
    std::optional<ActorTracksByName> dataset_from_actor = {};
};

/// Renders scans of a trained scene. Only one thread may use a renderer, and two
/// renderers of the same device must not be used simultaneously. With
/// ShDirection::surfel, intensities depend on the direction from the sensor to an
/// instance, so each instance needs a copy of its model. With ShDirection::ray, instances
/// share a model.
class ScanRenderer {
public:
    /// Creates a renderer of a scene.
    /// @throws UsageError for an unknown channel, or for a channel that needs normals in
    /// a scene of 3D Gaussians, which have no normals
    ScanRenderer(Device& device, const Scene& scene, const Config& config, const LidarSequence& sequence);
    /// Creates a renderer of a trained scene. Also uses other data of the run: the
    /// observed part of space, the surface classes and the random scatter of intensities.
    /// Applies the ray-drop network if the run has one and `refine.enabled` is set.
    ScanRenderer(Device& device, const TrainedRun& run);
    ~ScanRenderer();
    /// Hides instances of the scene in all following scans.
    /// @param visible_flags [instances] false for an instance that is not rendered
    void set_visible_instances(const std::vector<bool>& visible_flags);
    /// Sets the network that corrects the drop probabilities of all following scans. An
    /// empty network switches the correction off. A network for the sensor's rays needs
    /// scans in image order with enough rows and columns. It runs before a scan is binned
    /// into a grid. A network for the cells of a grid runs only on images of that grid. A
    /// ray whose drop probability is 1 stays dropped.
    /// @throws DataError if the arrays of the network do not match its shape
    void set_drop_network(const RayDropNetwork& network);
    /// Adds channels to all following scans, in addition to those of the setting
    /// `render.channels`.
    /// @throws UsageError for an unknown channel, or for a channel that needs normals in
    /// a scene of 3D Gaussians
    void enable_optional_channels(const std::string& comma_separated_names);
    /// Switches the visibility of actors (RenderedScan::actor_views) on or off for all
    /// following scans. The renderer then traces the rays near each actor a second time,
    /// in a scene that contains only this actor.
    void enable_actor_visibility(bool enabled = true);
    /// Sets the voxels that the log observed. For each following scan, the renderer
    /// computes how many rays pass mostly outside these voxels
    /// (RenderedScan::unseen_share). An empty set switches this off.
    void set_observed_voxels(const ObservedVoxelSet& observed_voxels);
    /// Sets the classes of the background for the channel `class` of all following scans.
    /// With an empty map, the class of the background is `unknown`.
    void set_background_classes(const SurfaceClassMap& class_map);
    bool has_background_classes() const;  ///< true if the classes of the background are known
    /// Sets the random intensity model of each LiDAR of the log, for all following scans.
    /// A scan that render() computes with the random seed `sample` draws intensities from
    /// this model. Other scans round intensities to the quantisation steps of the log.
    /// @param scatter [lidars] if the model of a LiDAR is missing or empty, its
    /// intensities are as rendered
    void set_intensity_scatter_models(const std::vector<IntensityScatterModel>& scatter);
    /// Sets the weather of all following scans. Its random numbers use the seed that is
    /// passed to render() as `sample`, or the seed 0 if none is passed. Scans with
    /// weather have the channel `source` (cause of each return).
    /// @throws UsageError if all intensities of the log are 0
    /// @throws errors of require_valid_weather()
    void set_weather(const Weather& weather);
    /// Returns true if a ray-drop network corrects the drop probabilities of this
    /// sensor's scans.
    bool has_drop_network_for(const SimulatedSensor& sensor) const;
    /// Renders a scan on the recorded path of the log's vehicle.
    /// @param sensor_offset pose of the simulated sensor in the frame of the log's LiDAR.
    /// Identity = the same pose.
    /// @param sample random seed for replace_expected_returns_by_sample(). If not set,
    /// the scan has expected values without noise
    RenderedScan render(const SimulatedSensor& sensor, double time_s, const Pose& sensor_offset = {},
                        std::optional<std::uint64_t> sample = {});
    /// Renders a scan from the poses of a request.
    /// @throws DataError if poses or times are not finite or exceed 1e10 m or s, or if
    /// times do not increase
    /// @throws UsageError for an actor that is not in the scene
    RenderedScan render(const SimulatedSensor& sensor, const ScanRequest& request,
                        std::optional<std::uint64_t> sample = {});
    /// When a requested scan is submitted to the GPU: immediately, or together with the
    /// next request.
    enum class SubmissionTiming { now, with_next };
    /// Requests the points of a scan and returns without waiting for the result. The
    /// points are in the sensor's frame at a time of the sensor's path. While the device
    /// renders this scan, the caller can request more scans and collect earlier points.
    /// The device computes the points if the scan has no sub-rays, grid, channels,
    /// weather or sample. Otherwise convert_scan_to_points() computes the points on the
    /// host. Both results are bitwise equal.
    /// @param point_frame_time_s time of the sensor frame in which the points are
    /// expressed
    /// @param submission_timing with `with_next`, the scan is submitted together with the
    /// next request. Scans whose points the device computes are then rendered in
    /// parallel.
    /// @throws UsageError if kScansInFlight requested scans were not collected, and as
    /// render()
    void submit_points(const SimulatedSensor& sensor, const ScanRequest& request, double point_frame_time_s,
                       std::optional<std::uint64_t> sample_seed = {},
                       SubmissionTiming submission_timing = SubmissionTiming::now);
    /// Maximum number of scans that were requested and not yet collected with
    /// wait_for_points(). Fewer are enough: two such scans keep the device busy.
    static constexpr std::size_t kScansInFlight = 64;
    /// Returns the maximum number of scans that the device renders in parallel. The
    /// default is 4 on a GPU, because a single scan does not use the GPU fully. The
    /// default is 1 on a CPU. For a scene in blocks, the number is 1. Each additional
    /// scan needs a copy of the scene on the device. If device memory is exhausted, the
    /// number is reduced.
    int get_max_parallel_scans() const;
    static int choose_max_parallel_scans(const Device& device);
    /// Sets the maximum number of scans that the device renders in parallel.
    /// @throws UsageError if `count` is less than 1
    void set_max_parallel_scans(int count);
    /// Waits for the oldest requested scan and returns its points.
    /// @param memory earlier points, whose memory is reused for the result
    /// @throws UsageError if no scan was requested
    RenderedPoints wait_for_points(LidarPoints memory = {});
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Bins a simulated scan into a grid, in the same way as the dataset bins its real
/// points. Points are placed at the median ranges of the rays. A cell holds its nearest
/// returned point. A cell is dropped if it is empty or if all its rays are dropped. The
/// drop probability of a cell is the smallest probability of its rays. A product of
/// probabilities would assume independent drops, but neighbouring rays are dropped for
/// the same reason.
RenderedScan project_points_into_grid_image(const RenderedScan& scan, const RangeImageGrid& grid);

/// Returns the measured range image of a frame, for comparison with a rendered image of
/// the configured sensor. For the native grid, its pixels are the rays of the scan. For
/// any other grid, the points of the scan are projected into the grid.
RangeImage make_measured_image(const Config& config, const Scan& scan);

}  // namespace relidar
