// SPDX-License-Identifier: Apache-2.0
// Internal state of ScanRenderer. Private to render.
#pragma once

#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <relidar/diff/forward.hpp>
#include <relidar/run/stage_options.hpp>
#include <relidar/simulate/render.hpp>

#include "simulate/render/points_on_device.hpp"
#include "simulate/render/resident_scene.hpp"
#include "simulate/render/seen.hpp"
#include "simulate/render/sensor_rays.hpp"

namespace relidar {

inline constexpr int kSideBySide = 4;  // number of scans that a GPU renders in parallel
/// Name of the image of a network that corrects the rays of the sensor, not the cells of
/// a grid.
inline constexpr const char* kNative = "native";

/// A scan whose points were requested but not collected yet.
struct AskedPoints {
    std::optional<RenderedPoints> ready = {};  ///< points, if the host computed them
    std::shared_ptr<SensorRays> rays = {};
    /// track of the sensor; a single pose if the sensor does not move
    PoseTrack dataset_from_sensor = {};
    Pose dataset_from_points = {};
    double time_s = 0.0;
    double max_range_m = 0.0;  ///< maximum range of the sensor
    double step = 0.0;         ///< step to which intensities are rounded, see IntensityScatter
    std::shared_ptr<PointsOnDevice::Slot> points = {};
    Renderer* renderer = nullptr;
};

/// Resources that one scan uses exclusively while it is being rendered. Each of the scans
/// that are rendered in parallel has its own ScanStrand.
struct ScanStrand {
    /// copy of the scene on the device; null if the scene itself is used
    std::unique_ptr<Renderer> copy = {};
    /// Rays of recently used sensors on the device. The most recently used sensor is
    /// first.
    std::vector<std::shared_ptr<SensorRays>> known_rays;
    PointsOnDevice points;
    std::optional<DropRefiner> refiner = {};

    explicit ScanStrand(Device& device) : known_rays{std::make_shared<SensorRays>(device)}, points(device) {}
};

struct ScanRenderer::Impl {
    const Config config;
    Scene layout;  ///< models, instances and sensor drop, without surfels
    /// LiDARs and boxes of the log, without scans; the vehicle has the poses of the
    /// current scan
    Sequence sweep;
    const PoseTrack log_world_from_vehicle;  ///< recorded poses of the vehicle
    const glm::dvec3 first_origin_m;         ///< see first_origin()
    /// frames of the log whose head azimuth differs from the nominal azimuth; without
    /// scans
    const std::vector<Frame> sweeps;
    std::vector<ChannelInfo> wanted;  ///< requested channels
    ResidentScene scene;
    std::vector<bool> shown;  ///< [instances]
    Device& device;
    ScanStrand first{device};
    /// resources for further parallel scans, created when they are needed
    std::deque<ScanStrand> others = {};
    int most_strands = default_side_by_side(device);
    std::deque<AskedPoints> asked = {};  ///< requested scans, the oldest first
    /// recorded commands of scans that were requested but not submitted
    std::optional<Strands> together = {};
    std::size_t n_together = 0;  ///< number of scans in `together`
    Coverage coverage = {};
    std::vector<IntensityScatter> scatter = std::vector<IntensityScatter>(sweep.lidars.size());
    Weather weather = {};

    /// Returns the time and the start azimuth of a sensor's sweep. The start azimuth
    /// comes from the pattern of the sensor, or from the LiDAR that the sensor replaces.
    SweepMoment moment(const SensorChoice& sensor, double time_s) {
        Lidar& lidar = sweep.lidars[std::size_t(sensor.lidar)];
        lidar.pattern = sensor.pattern;
        return {time_s, sensor.lidar, find_start(sensor.rays, lidar)};
    }
    /// Returns the rays of a scan if they differ from the sensor's table. They differ if
    /// a pattern generates new rays for each scan, or if all rays are fired at the same
    /// time.
    std::optional<RayTable> rays_of_scan(const SensorChoice& sensor, double time_s) const {
        const bool makes_rays = sensor.pattern && sensor.rays.size() == 0,
                   rolls = has_rolling_shutter(sensor, config);
        if (rolls && !makes_rays) return {};
        RayTable rays = makes_rays ? make_rays(*sensor.pattern, time_s) : sensor.rays;
        if (!rolls) std::ranges::fill(rays.time_offset_s, 0.0f);
        return rays;
    }
    /// Returns the sensor settings with the numbers of sub-rays and returns of this
    /// sensor.
    SensorConfig config_of(const SensorChoice& sensor) const {
        SensorConfig result = config.sensor;
        if (sensor.returns > 0) result.returns = sensor.returns;
        if (sensor.returns > 1 && result.sub_rays == 1) result.sub_rays = 9;
        return result;
    }
    Renderer& renderer_of(const ScanStrand& strand) { return strand.copy ? *strand.copy : scene.renderer(); }
    std::shared_ptr<SensorRays> rays_of(ScanStrand& strand, const SensorChoice& sensor,
                                        const RayTable& table);
    /// Rays of a sweep. The commands that trace and measure them have been recorded.
    struct Cast {
        std::shared_ptr<SensorRays> rays;
        PoseTrack track;  ///< track of the sensor; a single pose if the sensor does not move
        Pose pose;        ///< pose of the sensor at the time of the sweep
    };
    Cast record(ScanStrand& strand, const SensorChoice& sensor, const RayTable& table, double time_s,
                bool refined);
    RenderedScan cast(const SensorChoice& sensor, const RayTable& table, double time_s, bool refined = false);
    RenderedScan join(const SensorChoice& sensor, const RenderedScan& parts, const RayTable& whole,
                      SensorConfig beams);
    /// Describes an image that a network can process: the rays of any sensor ("native"),
    /// or the cells of a grid.
    struct ImageOf {
        int rows, columns;
        std::string name;
    };
    bool refines(const ImageOf& image) const;
    /// Returns true if the network corrects the rays of the sensor before they are binned
    /// into a grid.
    bool refines_rays(const SensorChoice& sensor, const RayTable& whole) const;
    bool gathers_points(const SensorChoice& sensor, bool sampled) const;
    void bring(const ScanStrand& strand, const SensorChoice& sensor, double time_s,
               std::vector<InstancePose> placed);
    ScanStrand& next_strand();
    void send();
    RenderedPoints points_of(AskedPoints& scan, Points memory = {});
    void settle();
    bool wants(const std::string& channel) const {
        return std::ranges::find(wanted, channel, &ChannelInfo::name) != wanted.end();
    }
    std::vector<ChannelInfo> rendered_channels() const;
    /// Returns false if every return of the log has intensity 0.
    bool has_intensities() const {
        const auto is_dark = [](const IntensityScatter& lidar) {
            return !lidar.empty() &&
                   std::ranges::all_of(lidar.values, [](float value) { return value == 0.0f; });
        };
        return scatter.empty() || !std::ranges::all_of(scatter, is_dark);
    }
    void refine(RenderedScan& scan);
    float never_seen(const SensorChoice& sensor, std::uint16_t channel, const glm::vec3& direction) const;
    RangeLimits limits_of(const SensorChoice& sensor) const;
    WeatherSensor weather_sensor(const SensorChoice& sensor, const RayTable& rays) const;
    void measure(RenderedScan& scan, const SensorChoice& sensor, const RayTable& rays,
                 std::optional<std::uint64_t> sample);
    /// Returns the poses of all instances during a sweep.
    /// @param actors poses of the actors; null: uses the tracks of the run
    std::vector<InstancePose> place(const SweepMoment& now, const ActorPoses* actors = nullptr) {
        return actors ? place_instances(layout, sweep, now, *actors) : place_instances(layout, sweep, now);
    }
    /// Sets the track of the vehicle so that the mounted sensor follows the given track.
    void drive(PoseTrack world_from_sensor, const SensorChoice& sensor) {
        const Pose& vehicle_from_sensor = sweep.lidars[std::size_t(sensor.lidar)].vehicle_from_sensor;
        sweep.world_from_vehicle = moved_track(std::move(world_from_sensor), inverse(vehicle_from_sensor));
        sweep.rolling_shutter = has_rolling_shutter(sensor, config);
    }
};

}  // namespace relidar
