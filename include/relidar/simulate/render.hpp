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
#include <relidar/log/log.hpp>
#include <relidar/log/own_vehicle.hpp>
#include <relidar/log/range_image.hpp>
#include <relidar/log/scatter.hpp>
#include <relidar/read/points.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/weather.hpp>

namespace relidar {

struct Run;
struct MountedSensor;

/// Side of an actor that the log has not observed, and the number of simulated rays on
/// it.
struct UnobservedActorSide {
    std::string track;
    BoxSide side;
    std::size_t n_rays = 0;
    /// True if mirrored surfels of the other half fill the side, false if rays pass
    /// through.
    bool is_completed = false;
};
using UnobservedActorSides = std::vector<UnobservedActorSide>;

/// Numbers of rays that hit an actor or a standing object (list_standing()). A ray counts
/// if surfaces absorb at least half of its light, and if the sensor can measure the
/// range, even if that is unlikely. The ray must also end where is_on_object() is true,
/// because the soft edge of an actor reaches below the ground. If no ray ends there, all
/// rays on the model count.
///
/// The points of a standing object cannot be rendered alone. Of the rays that cross its
/// box, those that nothing stops before the box show which share hits the object. The
/// blocked rays are assumed to hit it with the same share.
struct ActorVisibility {
    std::string track;
    std::size_t n_rays = 0;  ///< rays that hit the actor first
    /// Rays that would hit the actor if no other object hid it. 0 for a standing object
    /// if rays pass through its box, but meet no surface there.
    std::size_t n_rays_alone = 0;
};
using ActorViews = std::vector<ActorVisibility>;

/// A range image with the ray of each pixel, in the sensor frame at its own firing time.
struct RenderedScan {
    /// `render.range` selects the ranges. `drop_prob` combines the drops by surfels and
    /// by the sensor itself. It is 1 if the ray hit nothing within the range limits.
    RangeImage image;
    /// [n] Distance in metres at which the transmittance T falls below 0.5, or
    /// `image.range_m` if it never does.
    std::vector<float> median_range_m;
    /// [n] Blended depth D divided by the accumulated alpha W, in metres. Equal to the
    /// median range if T never falls below 0.5.
    std::vector<float> mean_range_m;
    std::vector<float> weight;  ///< [n] alpha accumulated along the ray (W).
    /// [n] index into Scene::instances of the object that the ray hit; -1: none;
    /// kOwnVehicleInstance: the vehicle that carries the sensor
    std::vector<std::int32_t> instance;
    /// [n] firing time relative to `time_s`; 0 without a rolling shutter
    std::vector<float> time_offset_s;
    std::vector<std::uint16_t> ring;  ///< [n] beam number of the ray; 0 is the highest beam
    /// Median ranges. Empty if `sensor.returns` is not 2.
    std::vector<AdditionalReturns> second_returns = {};
    /// [n] The channels of `render.channels`, and `source` (cause of the return) in
    /// weather. A channel that cannot be computed is missing, for example "seen" of a run
    /// without observed space. Callers may append channels.
    std::vector<ScanChannel> channels = {};
    /// Fraction of rays of whose path the log observed less than half, from all rays or
    /// about a thousand of them. Empty if the run does not store the observed space, or
    /// if the background is hidden.
    std::optional<double> unseen_share = {};
    /// Set by the command `relidar render`, not by ScanRenderer.
    UnobservedActorSides unseen_sides = {};
    /// Empty if ScanRenderer::count_actor_rays() was not called.
    ActorViews actor_views = {};
    Pose world_from_sensor;  ///< pose of the sensor at the reference time, in the dataset's world frame
    /// Poses during the scan, in the dataset's world frame; a single pose if it is
    /// constant.
    PoseTrack track;
    double time_s = 0.0;
    double trace_ms = 0.0;

    /// Returns the pose of the sensor at the firing time of a ray, in the dataset's world
    /// frame.
    Pose firing_pose(std::size_t ray) const;
    /// Returns the point at the median range, in the frame of the sensor at the ray's
    /// firing time.
    template <class Real = float>
    glm::vec<3, Real> end_of(std::size_t ray) const {
        using Vector = glm::vec<3, Real>;
        return Vector(image.origin[ray]) + Real(median_range_m[ray]) * Vector(image.direction[ray]);
    }
};

/// Finds the sides of actors that the log did not observe, although at least five rays of
/// the scan reach them. Such a side has no surfels, or mirrored ones. Uses the poses of
/// the actors in the log.
UnobservedActorSides find_unseen_sides(const RenderedScan& scan, const Scene& scene, const Log& log);

/// Pose of the sensor at the firing time of each ray, interpolated once per column. Not
/// thread-safe.
class FiringPoseInterpolator {
public:
    /// Keeps a reference to the scan, which contains the poses of the sensor.
    /// @param scan must outlive this object
    /// @param target_from_dataset transform to the frame of the returned poses
    explicit FiringPoseInterpolator(const RenderedScan& scan, const Pose& target_from_dataset = {});
    /// Returns `target_from_dataset * scan.firing_pose(ray)`, valid until the next
    /// call.
    const Pose& pose_of(std::size_t ray);

private:
    struct CachedFiringPose {
        float time_offset_s;
        Pose target_from_firing;
    };
    const RenderedScan& scan_;
    const Pose target_from_dataset_;
    const bool moves_;
    /// Last pose of each column, whose rays often fire at the same time. A single entry
    /// if the scan has one row or the sensor does not move.
    std::vector<std::optional<CachedFiringPose>> cached_;
};

/// Limit of RenderedScan::unseen_share for a warning. The log's sensor on its path is
/// below 0.01, a sensor in the next lane has a few hundredths.
inline constexpr double kMuchUnseen = 0.2;

/// Returns the [n] ranges, in metres, at which the points of a scan are placed. The
/// setting `render.points` selects scan.median_range_m or scan.image.range_m.
const std::vector<float>& point_ranges(const RenderedScan& scan, const Config& config);

/// Returns |mean range - median range| of each ray, [n] metres. The value is large where
/// a ray passes an edge, and 0 if the transmittance never falls below 0.5.
std::vector<float> range_spread(const RenderedScan& scan);

/// Computes the inputs of a ray-drop network.
/// @param scan should have the channel `incidence`; without it all cosines are 0
/// @param inputs the network's inputs
/// @param origin_m [3] from first_position()
RayDropImage make_drop_image(const RenderedScan& scan, const std::vector<std::string>& inputs,
                             const glm::dvec3& origin_m);

/// Returns the first position of the log's vehicle, [3] metres, in the dataset's world
/// frame.
glm::dvec3 first_position(const Log& log);

/// Returns the values from which random intensities are drawn: rendered intensity, range,
/// spread, incidence and elevation of each ray.
RenderedIntensityImage make_noise_image(const RenderedScan& scan);

/// Replaces the expected values by a random sample. Rays return independently with
/// probability 1 - drop_prob. The noise of a range depends on the range and on the angle
/// of incidence, from neighbouring pixels. Afterwards `drop_prob` is 0 or 1, and
/// `image.range_m` equals `median_range_m`. Second returns keep their intensities. The
/// result depends only on seed and time, not on the device.
/// @param scatter if empty, intensities keep their expected values
/// @param limits returns whose noise exceeds these limits are dropped
void sample_returns(RenderedScan& scan, const RangeNoiseTable& noise, const IntensityScatterModel& scatter,
                    std::uint64_t seed, const RangeLimits& limits = {});

struct RenderedPoints {
    LidarPoints points;      ///< all returns, in the order of place_points()
    std::size_t n_rays = 0;  ///< number of rays of the scan
    /// RenderedScan::unseen_share
    std::optional<double> unseen_share = {};
};

struct SimulatedSensor {
    RayTable rays;  ///< Rays of a sweep. Empty for a rosette, because its rays differ in every scan.
    /// Simulated points are projected into this grid. Empty = one pixel per ray.
    std::optional<RangeImageGrid> grid = {};
    /// Only for LiDARs of the log, training has estimated Scene::sensor_drop.
    bool is_log_lidar = false;
    /// Only for a LiDAR of the log. If true, a scan at the time of a recorded sweep uses
    /// its measured azimuths, and a ScanRequest the nominal azimuths in `rays`.
    bool follows_sweeps = false;
    /// Calibration. Empty = ranges and intensities are not changed.
    std::vector<Beam> beams = {};
    /// Pattern of a sensor that does not spin. Generates the rays if `rays` is empty.
    std::optional<SensorPattern> pattern = {};
    RangeLimits limits = {};  ///< limits of measured ranges
    std::string name = "";
    int lidar = 0;  ///< index of the log's LiDAR that this sensor is or replaces
    /// Returns per ray. 0 = setting `sensor.returns`. Two returns need sub-rays: 9, if
    /// the settings select only 1.
    int returns = 0;
    /// False: all rays are fired at the scan's reference time. The settings can override
    /// this: see is_rolling().
    bool rolling_shutter = true;
    VehicleBody body = {};  ///< blocks rays
    /// Set for a camera (camera_sensor()), empty for a LiDAR.
    std::optional<Camera> camera = {};
};

/// Returns true if the sensor fires its rays at different times. Without a rolling
/// shutter (setting `sensor.rolling_shutter`), all points are in the sensor frame at the
/// scan's time.
bool is_rolling(const SimulatedSensor& sensor, const Config& config);

/// Sets the measured azimuths of the log's sweep at this time, if the sensor follows
/// sweeps and the log has such a sweep. ScanRenderer does this for scans without a
/// ScanRequest.
/// @param frames frames of the log with their azimuth shifts
SimulatedSensor follow_sweep(const SimulatedSensor& sensor, std::span<const Frame> frames,
                             std::span<const Lidar> lidars, double time_s);

/// Returns the LiDAR or grid that `sensor.grid` selects. With `sensor.grid_method`, the
/// rays of a grid are cast, or points of the LiDAR are binned. Range limits are those of
/// the LiDAR and of the dataset settings. A LiDAR with an unknown pattern has empty
/// `rays`.
SimulatedSensor make_sensor(const Config& config, const Log& log, int lidar = 0);
/// Returns "native" (the log's LiDAR), a built-in sensor, the sensor in a file, or a
/// range grid; `sensor.grid_method` applies to the grid "kitti360".
SimulatedSensor choose_sensor(const std::string& name, const Config& config, const Log& log, int lidar = 0);

/// Creates a sensor that replaces a LiDAR of the log. A sensor of a rig also has its
/// number of returns per ray.
SimulatedSensor simulate_sensor(const SensorModel& sensor, int lidar = 0);
SimulatedSensor simulate_sensor(const MountedSensor& mounted, int lidar = 0);

/// Merges scans of all sensors of a rig into one without image order, in the frame of the
/// rig. Beam numbers continue from scan to scan. If a scan lacks a channel, its rays get
/// the channel's value `none`.
/// @param scans scans at the same time
/// @param rig_from_sensor [scans] mounting pose of each sensor
/// @throws UsageError if two channels have the same name and different types
RenderedScan merge_scans(const std::vector<RenderedScan>& scans, const std::vector<Pose>& rig_from_sensor);

/// Number of an actor in a ScanRenderer: the index of its instance in the scene.
enum class ActorHandle : std::uint32_t {};

struct PlacedActor {
    ActorHandle actor{};
    PoseTrack dataset_from_actor;
};

/// A scan at given poses. Poses are in the dataset's world frame, times are in the time
/// of the log (Frame::time_s).
struct ScanRequest {
    double time_s = 0.0;  ///< time at which the sensor head faces forward, in seconds
    /// Each ray is fired from the pose at its firing time. A single pose: the sensor does
    /// not move.
    PoseTrack dataset_from_sensor;
    /// All actors that are present. If not set, the tracks of the run apply.
    std::optional<ActorTracksByName> dataset_from_actor = {};
    /// Further actors, by handle, which avoids the search by name. Replaces the tracks of
    /// the run.
    std::vector<PlacedActor> placed = {};
};

/// Actor that ScanRenderer::spawn() has added.
struct SpawnedActor {
    ActorHandle handle{};
    std::string name, category;  ///< category: class name in the dataset of its log
    glm::dvec3 size_m{0.0};      ///< length, width, height
};

struct DevicePoints;
using SampleSeed = std::optional<std::uint64_t>;  ///< empty: without noise

/// Only one thread may use a renderer, and two renderers of the same device must not be
/// used simultaneously. With ShDirection::surfel, each instance needs a copy of its
/// model; with ShDirection::ray, instances share it.
class ScanRenderer {
public:
    /// Creates a renderer of a scene.
    /// @throws UsageError for an unknown channel, or for a channel that needs normals in
    /// a scene of 3D Gaussians
    ScanRenderer(Device& device, const Scene& scene, const Config& config, const Log& log);
    /// Creates a renderer of a run. Also uses its observed space, surface classes and
    /// intensity scatter, and its ray-drop network if `refine.enabled` is set.
    ScanRenderer(Device& device, const Run& run);
    ~ScanRenderer();
    /// Hides instances of the scene in all following scans.
    /// @param visible_flags [instances of the run] false for an instance that is not
    /// rendered. Spawned actors are not hidden.
    void show_instances(const std::vector<bool>& visible_flags);
    /// Sets the network that corrects the drop probabilities of all following scans. An
    /// empty network switches the correction off. A network for rays needs scans in image
    /// order with enough rows and columns, and runs before a scan is binned. A network
    /// for the cells of a grid runs only on images of that grid. A drop probability of 1
    /// stays.
    /// @throws DataError if the arrays of the network do not match its shape
    void use_network(const RayDropNetwork& network);
    /// Adds channels to all following scans, in addition to those of `render.channels`.
    /// @throws UsageError for an unknown channel, or for a channel that needs normals in
    /// a scene of 3D Gaussians
    void add_channels(const std::string& comma_separated_names);
    /// Switches RenderedScan::actor_views on or off. The renderer then traces the rays
    /// near each actor a second time, in a scene that contains only this actor.
    void count_actor_rays(bool enabled = true);
    /// Sets the space from which RenderedScan::unseen_share is computed. An empty set
    /// switches this off.
    void use_observed(const ObservedVoxelSet& observed_voxels);
    /// Sets the classes for the channel `class`. With an empty map, the background is
    /// `unknown`.
    void use_classes(const SurfaceClassMap& class_map);
    bool has_classes() const;  ///< true if the classes of the background are known
    /// Sets the random intensity model of each LiDAR of the log. Scans with a random seed
    /// draw intensities from these models. Other scans round intensities to the steps of
    /// the log.
    /// @param scatter [lidars] without a model, intensities are as rendered
    void use_scatter(const std::vector<IntensityScatterModel>& scatter);
    /// Sets the weather of all following scans. Its random numbers use the seed `sample`
    /// of render(), or 0. Scans in weather have the channel `source`.
    /// @throws UsageError if all intensities of the log are 0
    /// @throws errors of check_weather()
    void set_weather(const Weather& weather);
    /// Returns true if a ray-drop network corrects the scans of this sensor.
    bool has_network_for(const SimulatedSensor& sensor) const;
    /// Adds an actor to the scene without loading the scene again. It is present only in
    /// scans whose request names it. Waits for pending scans. If a despawned actor had
    /// the same model, the new actor uses its memory.
    /// @param actor  track in the scene, or name of a spawned actor, whose model is
    /// copied
    /// @param name  not used by another actor
    /// @throws UsageError if `actor` is unknown or `name` is in use
    /// @throws OutOfDeviceMemory if memory is exhausted
    ActorHandle spawn(const std::string& actor, const std::string& name);
    /// The same with the only actor of another run, for example of an asset. Equal models
    /// are stored only once.
    /// @throws DataError if its surfels have another primitive than the scene
    ActorHandle spawn(const Run& asset, const std::string& name);
    /// Removes a spawned actor. Its memory remains for the next actor with the same
    /// model.
    /// @throws UsageError if no spawned actor has this name
    void despawn(const std::string& name);
    /// Returns the spawned actors in the order of their handles.
    std::vector<SpawnedActor> spawned() const;
    /// Returns the handle of an actor of the run, or of a spawned actor.
    /// @throws UsageError if the name is unknown
    ActorHandle find_actor(const std::string& name) const;

    /// Renders a scan on the recorded path of the log's vehicle.
    /// @param offset pose of the sensor in the frame of the log's LiDAR
    /// @param sample random seed for sample_returns(). If not set,
    /// the scan has expected values
    RenderedScan render(const SimulatedSensor& sensor, double time_s, const Pose& offset = {},
                        SampleSeed sample = {});
    /// Renders a scan at the poses of a request.
    /// @throws DataError if poses or times are not finite or exceed 1e10 m or s, or if
    /// times do not increase
    /// @throws UsageError for an actor that is not in the scene
    RenderedScan render(const SimulatedSensor& sensor, const ScanRequest& request, SampleSeed sample = {});
    enum class SubmissionTiming { now, with_next };
    enum class PointMemory { host, device };
    /// Requests the points of a scan without waiting. While the device renders, the
    /// caller can request more scans and collect earlier points. The device computes the
    /// points if the scan has no sub-rays, grid, channels, weather or sample, otherwise
    /// place_points() does. Both are bitwise equal.
    /// @param points_time_s time of the sensor frame in which the points are
    /// expressed
    /// @param timing with `with_next`, the scan is submitted together with the
    /// next request, and rendered in parallel if the device computes its points
    /// @param memory  with `device`, wait_for_device_points() returns the points
    /// @throws UsageError if kScansInFlight requested scans were not collected, and as
    /// render()
    void submit_points(const SimulatedSensor& sensor, const ScanRequest& request, double points_time_s,
                       SampleSeed seed = {}, SubmissionTiming timing = SubmissionTiming::now,
                       PointMemory memory = PointMemory::host);
    /// Maximum number of requested scans. Two keep the device busy.
    static constexpr std::size_t kScansInFlight = 64;
    /// Returns the number of scans that the device renders in parallel: 4 on a GPU, 1 on
    /// a CPU and for a scene in blocks. Each further scan needs a copy of the scene; the
    /// number falls if memory is exhausted.
    int max_parallel() const;
    static int default_parallel(const Device& device);
    /// Sets the maximum number of scans that the device renders in parallel.
    /// @throws UsageError if `count` is less than 1
    void set_parallel(int count);
    /// Waits for the oldest requested scan and returns its points.
    /// @param memory earlier points, whose memory is reused
    /// @throws UsageError if no scan was requested, or if its points stay on the device
    RenderedPoints wait_for_points(LidarPoints memory = {});
    /// The same for a scan that was requested with PointMemory::device. Only the number
    /// of points is copied to the host if the device computes the points. DevicePoints is
    /// in <relidar/simulate/device_points.hpp>.
    DevicePoints wait_for_device_points();
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Bins a scan into a grid as the dataset bins its points, at the median ranges. A cell
/// holds its nearest returned point. Its drop probability is the smallest of its rays,
/// not a product, because neighbouring rays are dropped for the same reason.
RenderedScan project_scan(const RenderedScan& scan, const RangeImageGrid& grid);

/// Returns the measured image of a frame for comparison with a rendered one: the rays of
/// the scan, or its points in the configured grid.
RangeImage measured_image(const Config& config, const Scan& scan);

}  // namespace relidar
