// SPDX-License-Identifier: Apache-2.0
// Any pose, time and sensor to a scan.
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
#include <relidar/log/coverage.hpp>
#include <relidar/log/points.hpp>
#include <relidar/log/range_image.hpp>
#include <relidar/log/scatter.hpp>
#include <relidar/log/sequence.hpp>
#include <relidar/run/config.hpp>
#include <relidar/scene/scene.hpp>
#include <relidar/simulate/weather.hpp>

namespace relidar {

struct Run;
struct MountedSensor;

/// A simulated scan: a range image with the ray of each pixel, in the sensor's frame at
/// the ray's firing time.
struct RenderedScan {
    /// range as config.render.range says; drop_prob from the two logits (M6), 1 if
    /// nothing was met in range
    RangeImage image;
    /// [n] of the dominant surface, along the ray: where T crosses 0.5; if it never does,
    /// the image's
    std::vector<float> median_range_m;
    /// [n] D / W along the ray, whatever render.range says; the median where T never
    /// crosses 0.5
    std::vector<float> mean_range_m;
    std::vector<float> weight;  ///< [n] accumulated alpha W
    /// [n] whose surface was met: index into Scene::instances, -1 where none was
    std::vector<std::int32_t> instance;
    /// [n] firing time of each ray from time_s; 0 without a rolling shutter
    std::vector<float> time_offset_s;
    std::vector<std::uint16_t> ring;  ///< [n] number of the beam, 0 = highest
    /// second returns with sensor.returns = 2; of the dominant surfaces
    std::vector<SecondReturn> second_returns = {};
    /// [n] each: those of config.render.channels, in weather `source`, but for what the
    /// run does not know ("seen" without a Coverage), and what a caller adds of his own,
    /// which goes through joins, grids, merges and into every output like the others
    std::vector<ScanChannel> channels = {};
    /// share of the rays of which less than half of the way is seen, of all or of a
    /// thousand; nothing where the run does not know
    std::optional<double> unseen_share = {};
    Pose world_from_sensor;  ///< at the reference time, in the dataset's world
    /// of the sensor, in the dataset's world; a single pose where all rays were fired
    /// from it
    PoseTrack track;
    double time_s = 0.0;
    double trace_ms = 0.0;

    /// Where the sensor was when a ray was fired, in the dataset's world.
    Pose world_from_firing(std::size_t ray) const;
};

/// Where the sensor was when the rays of a scan were fired, for one thread that asks ray
/// by ray. Many sensors fire the rays of a column at the same time: the pose of such a
/// column is interpolated once.
class FiringPoses {
public:
    /// @param scan  outlives this @param target_from_dataset  the frame that poses are
    /// wanted in
    explicit FiringPoses(const RenderedScan& scan, const Pose& target_from_dataset = {});
    /// target_from_dataset * scan.world_from_firing(ray), until the next call.
    const Pose& at(std::size_t ray);

private:
    struct Made {
        float time_offset_s;  ///< not a number: none yet
        Pose target_from_firing;
    };
    const RenderedScan& scan_;
    const Pose target_from_dataset_;
    const bool moves_;
    /// the last one of each column; a single one of a scan without rows, or of a sensor
    /// that stands
    std::vector<Made> made_;
};

/// Above this share of rays that look where no ray of the log did
/// (RenderedScan::unseen_share), a user is warned. The log's own sensor on its way has
/// less than a hundredth of them, in the next lane some hundredths.
inline constexpr double kMuchUnseen = 0.2;

/// [n] Ranges of the points of a scan, by config.render.points: of the dominant surface,
/// or those of the image.
const std::vector<float>& point_ranges(const RenderedScan& scan, const Config& config);

/// [n] How far apart along a ray the surfaces are that its range is of, metres: |mean -
/// median| of the range, near 0 on one surface and large where a ray passes an edge; 0
/// where T never crosses 0.5.
std::vector<float> range_spread(const RenderedScan& scan);

/// Inputs of a ray-drop network. @param scan  has the channel `incidence`, otherwise
/// cosines are 0
/// @param channels  of the network, see drop_channel_names()
/// @param first_origin_m [3] dataset's world: where origins count from, see
/// first_origin()
DropImage drop_image(const RenderedScan& scan, const std::vector<std::string>& channels,
                     const glm::dvec3& first_origin_m);

/// Where a log's vehicle was first, in the dataset's world. @return [3] metres
glm::dvec3 first_origin(const Sequence& sequence);

/// What a sensor's intensities scatter about: those of a scan, and what of it they depend
/// on.
RenderedIntensities rendered_intensities(const RenderedScan& scan);

/// Draws one scan from what a rendering says is likely: a ray returns with probability 1
/// - drop_prob, independently of the others, its range off by the noise at its range and
/// angle of incidence (from neighbouring pixels), its intensity as the LiDAR's scatter.
/// Afterwards drop_prob is 0 or 1, and image.range_m is the dominant surface's, as
/// median_range_m. Second returns keep their likeliest intensities. The same for the same
/// seed and time, whatever the device. @param scatter  an empty one: intensities stay the
/// likeliest
void sample_returns(RenderedScan& scan, const RangeNoise& noise, const IntensityScatter& scatter,
                    std::uint64_t seed);

/// What wet ground makes of a ray that meets it.
struct WetRay {
    double through_water = 1.0;  ///< share of the ground's light that comes back: wet over dry
    Echo mirrored{};             ///< what the ray meets when the ground mirrors it
};
/// Rays that meet weather otherwise than most. An empty list: there are none.
struct RaysInWeather {
    /// [n] 1 for rays that see nothing of the air, since something at the sensor blocks
    /// them
    std::span<const std::uint8_t> blind{};
    std::span<const WetRay> wet{};      ///< [n]
    std::span<const Echo> stray{};      ///< [n] of retro-reflectors elsewhere
    std::span<const float> from_sun{};  ///< [n] radians
};

/// Puts weather between a sensor and its scan. Surfaces are darker or none; where
/// something in the air is what a ray returns, its range and intensity are of that, it
/// belongs to no instance, and channels that say something of surfaces say nothing. The
/// channel `source` says why there is a point; clear air changes nothing else. The same
/// for the same seed and time, on any number of threads.
/// @param response  how bright the sensor reports the same surface at a range
void add_weather(RenderedScan& scan, const Air& air, const IntensityResponse& response,
                 const RaysInWeather& special, std::uint64_t seed);

/// The points of a scan, without the scan.
struct RenderedPoints {
    Points points;                            ///< all returns, see place_points()
    std::size_t n_rays = 0;                   ///< of the scan
    std::optional<double> unseen_share = {};  ///< see RenderedScan
};

/// The sensor whose scan is wanted.
struct SensorChoice {
    RayTable rays;                       ///< none of a Rosette, which has others in every scan
    std::optional<RangeGrid> grid = {};  ///< bin the simulated points into this grid afterwards
    bool is_own = false;                 ///< a LiDAR of the log: its sensor-level ray-drop applies
    /// the rays are the nominal ones of that LiDAR: at the time of one of its sweeps they
    /// point where its head did (find_azimuth_shift()), unless it is driven (ScanRequest)
    bool follows_sweeps = false;
    /// of the rays' beams, what these add to ranges and make of intensities; none: they
    /// measure what is there
    std::vector<Beam> beams = {};
    /// of one that does not spin: when it faces what; without `rays`, those of each scan
    std::optional<SensorPattern> pattern = {};
    RangeLimits limits = {};  ///< of measured ranges
    std::string name = "";
    int lidar = 0;  ///< of the log, which it is or in whose place it stands
    /// of each ray, 1 or 2, the latter by 9 sub-rays where config has 1; 0: as
    /// config.sensor.returns says
    int returns = 0;
    /// false: all rays are fired at the scan's time, like those of a motion-compensated
    /// log. See has_rolling_shutter()
    bool rolling_shutter = true;
};

/// Whether rays of a sensor are fired at different times: SensorChoice::rolling_shutter,
/// unless config.sensor.rolling_shutter is `no`. In scans without a rolling shutter all
/// time offsets are 0, and all points are in the sensor's frame at the scan's time.
bool has_rolling_shutter(const SensorChoice& sensor, const Config& config);

/// A sensor that follows the log's sweeps, as its head pointed in the log's sweep at a
/// time. Any other sensor, and at any other time: the same sensor. ScanRenderer does this
/// itself for scans without a ScanRequest.
/// @param frames  of the log, with their azimuth shifts
SensorChoice sensor_in_sweep(const SensorChoice& sensor, std::span<const Frame> frames,
                             std::span<const Lidar> lidars, double time_s);

/// What config.sensor says: a LiDAR of the log, or the grid in its place by projection or
/// by casting. The log's LiDAR sees what lies within its own range limits and those of
/// config.dataset. Of one that is known by its scans alone there are no rays: those of a
/// scan have to be put in.
SensorChoice configured_sensor(const Config& config, const Sequence& sequence, int lidar = 0);
/// "native", or a sensor by name, CSV file or grid name. "kitti360" follows
/// config.sensor.grid_method.
SensorChoice choose_sensor(const std::string& name_or_file, const Config& config, const Sequence& sequence,
                           int lidar = 0);

/// A sensor in the place of a LiDAR of the log.
SensorChoice sensor_choice(const SensorModel& sensor, int lidar = 0);
/// The same of a rig's sensor, with its returns.
SensorChoice sensor_choice(const MountedSensor& mounted, int lidar = 0);

/// Scans of a rig's sensors, taken together, as one without image order: rays in the
/// frame of the rig, which is the sensor of the scan; rings are counted through; a
/// channel that some scans have is `none` in the others. @param scans  at the same time
/// @param rig_from_sensor [scans] as they were mounted
/// @throws UsageError for channels of one name and two types
RenderedScan merge_scans(const std::vector<RenderedScan>& scans, const std::vector<Pose>& rig_from_sensor);

/// A scan to be taken, wherever its sensor was driven: by a file, or by a simulator that
/// owns the traffic too. Poses are in the dataset's world, times in the log's
/// (Frame::time_s).
struct ScanRequest {
    double time_s = 0.0;  ///< when the head faces forward
    /// also through the sweep: with a rolling shutter a ray is fired from where the
    /// sensor is then; one pose: it stands
    PoseTrack dataset_from_sensor;
    /// of all actors that are there; not given: where the run's tracks have them at the
    /// time
    std::optional<ActorPoses> dataset_from_actor = {};
};

/// Renders scans of a trained scene. A renderer serves one thread at a time; renderers of
/// one device may not be used at once either. With ShDirection::surfel a model placed n
/// times is held n times (own_models): each placement is lit from where the sensor stands
/// to it; ShDirection::ray needs one copy alone.
class ScanRenderer {
public:
    /// @throws UsageError for unknown channels, and for those of 3D Gaussians that are
    /// made of normals, which they do not have
    ScanRenderer(Device& device, const Scene& scene, const Config& config, const Sequence& sequence);
    /// Uses the run's coverage, how its intensities scatter, and its ray-drop network
    /// where it has one and config.refine.enabled says so.
    ScanRenderer(Device& device, const Run& run);
    ~ScanRenderer();
    /// Leaves out every instance that is not shown, from the next scan on. @param shown
    /// [instances]
    void show_only(const std::vector<bool>& shown);
    /// Corrects ray-drop by a network from the next scan on; an empty one: no longer. A
    /// network of the sensor's rays works on every scan with image order, rows and
    /// columns enough, before it is binned into a grid; one of a grid's cells on images
    /// of that grid alone. What the sensor cannot see it does not bring back.
    /// @throws DataError where its arrays do not fit its shape
    void refine_drops(const DropNetwork& network);
    /// Adds channels to every scan from now on, beside those of config.render.channels.
    /// @throws UsageError for an unknown one, and for one that needs normals, which are
    /// traced for those of the config alone
    void want_channels(const std::string& names);
    /// Says of every scan from now on what of it the log has seen
    /// (RenderedScan::unseen_share); an empty one: no longer.
    void compare_with(const Coverage& coverage);
    /// How intensities scatter, of each LiDAR of the log, from the next scan on: sampled
    /// scans draw them, the likeliest have them in the log's steps.
    /// @param scatter [lidars] none, or an empty one: intensities are as the scene has
    /// them
    void scatter_intensities(const std::vector<IntensityScatter>& scatter);
    /// The weather from the next scan on, drawn by the seed of sampled scans and 0 for
    /// the likeliest. Its scans have the channel `source`.
    /// @throws UsageError as check_weather(), and for weather on a log whose intensities
    /// are all 0
    void set_weather(const Weather& weather);
    /// Whether scans of a sensor are refined.
    bool refines(const SensorChoice& sensor) const;
    /// @param sensor_offset  of the simulated sensor in the frame of the log's LiDAR
    /// (identity = where the real one was)
    /// @param sample  seed of sample_returns(); not given: the likeliest scan, free of
    /// noise
    RenderedScan render(const SensorChoice& sensor, double time_s, const Pose& sensor_offset = {},
                        std::optional<std::uint64_t> sample = {});
    /// @throws DataError for poses or times that are not finite, that lie beyond 1e10 m
    /// or s, or times that do not rise; UsageError for an actor that is not in the scene
    RenderedScan render(const SensorChoice& sensor, const ScanRequest& request,
                        std::optional<std::uint64_t> sample = {});
    /// When the device is told of a scan that is asked for.
    enum class Send { now, with_next };
    /// Requests the points of a scan, in the sensor's frame at a time of its path, and
    /// does not wait for them: while the device renders one scan, the caller can request
    /// another and take the points of an earlier one. The device also makes the points
    /// if the scan needs nothing but its sensor's own rays (no sub-rays, grid, channels,
    /// weather or sample). Otherwise place_points() makes them, with the same bits.
    /// @param when  with_next: scans of a rig, or of several requests, go to the device
    /// together with the next one that is asked for, and those it makes the points of are
    /// rendered side by side
    /// @throws UsageError where kScansInFlight scans have been asked for that were not
    /// taken, and as render()
    void ask_points(const SensorChoice& sensor, const ScanRequest& request, double points_at_s,
                    std::optional<std::uint64_t> sample = {}, Send when = Send::now);
    /// How many scans may have been asked for and not been taken. Two are enough for the
    /// device never to wait.
    static constexpr std::size_t kScansInFlight = 64;
    /// How many scans that go to the device together are rendered side by side: 4 on a
    /// GPU, which one scan alone does not fill; 1 on a CPU and with a scene in blocks.
    /// Each but the first needs a copy of the scene on the device; where its memory does
    /// not do for so many, there are fewer.
    int side_by_side() const;
    static int default_side_by_side(const Device& device);
    /// @throws UsageError for less than 1
    void side_by_side(int n);
    /// The points that were asked for first. @param memory  of earlier ones, to be used
    /// again @throws UsageError where none are
    RenderedPoints take_points(Points memory = {});
    const KernelTimes& times() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;

    /// Drives the sensor as a request says. @return instances at their moments
    std::vector<InstancePose> drive(const SensorChoice& sensor, const ScanRequest& request);
    /// What a sensor sees whose path has been set.
    RenderedScan take(const SensorChoice& sensor, double time_s, std::vector<InstancePose> placed,
                      std::optional<std::uint64_t> sample);
};

/// Bins a simulated scan into a grid as the dataset's points were: points lie on the
/// dominant surfaces of rays, the nearest that returned wins a cell, and the cell is
/// dropped where all rays in it are. Neighbours are dropped for the same reason: its
/// probability is the smallest of theirs (their product would be right for independent
/// drops). Empty cells are dropped.
RenderedScan project_scan(const RenderedScan& scan, const RangeGrid& grid);

/// The real image of a frame on the pixels of the configured sensor, for comparison with
/// a rendering. The native grid returns the scan as it is; a grid bins its points.
RangeImage real_image(const Config& config, const Scan& scan);

}  // namespace relidar
