// SPDX-License-Identifier: Apache-2.0
// What a ScanRenderer is made of. Private to render.
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

inline constexpr int kSideBySide = 4;             // scans on a GPU
inline constexpr const char* kNative = "native";  ///< image of a network: the rays of a sensor

/// Points that were asked for.
struct AskedPoints {
    std::optional<RenderedPoints> ready = {};  ///< made on the host
    std::shared_ptr<SensorRays> rays = {};
    PoseTrack dataset_from_sensor = {};  ///< one pose where it stands
    Pose dataset_from_points = {};
    double time_s = 0.0;
    double max_range_m = 0.0;  ///< of the sensor
    double step = 0.0;         ///< of intensities, see IntensityScatter
    std::shared_ptr<PointsOnDevice::Slot> points = {};
    Renderer* renderer = nullptr;
};

/// What scans are rendered with that no other one may use meanwhile. Scans that are
/// rendered side by side have one each.
struct ScanStrand {
    std::unique_ptr<Renderer> copy = {};                  ///< of the scene; null: the scene itself
    std::vector<std::shared_ptr<SensorRays>> known_rays;  ///< of sensors, the one used last first
    PointsOnDevice points;
    std::optional<DropRefiner> refiner = {};

    explicit ScanStrand(Device& device) : known_rays{std::make_shared<SensorRays>(device)}, points(device) {}
};

struct ScanRenderer::Impl {
    const Config config;
    Scene layout;    ///< models, instances and sensor drop; no surfels
    Sequence sweep;  ///< LiDARs and boxes, no scans; where the vehicle is in the scan that is taken
    const PoseTrack log_world_from_vehicle;  ///< where it was in the log
    const glm::dvec3 first_origin_m;         ///< see first_origin()
    const std::vector<Frame> sweeps;         ///< of the log that have an azimuth shift; no scans
    std::vector<ChannelInfo> wanted;         ///< channels
    ResidentScene scene;
    std::vector<bool> shown;  ///< [instances]
    Device& device;
    ScanStrand first{device};
    std::deque<ScanStrand> others = {};  ///< as they are needed
    int most_strands = default_side_by_side(device);
    std::deque<AskedPoints> asked = {};    ///< those asked for first come first
    std::optional<Strands> together = {};  ///< of scans that were asked for and not sent
    std::size_t n_together = 0;            ///< of them
    Coverage coverage = {};
    std::vector<IntensityScatter> scatter = std::vector<IntensityScatter>(sweep.lidars.size());
    Weather weather = {};

    /// Where the sweep of a sensor's rays begins. It faces things as its pattern says, or
    /// as the LiDAR in whose place it stands.
    SweepMoment moment(const SensorChoice& sensor, double time_s) {
        Lidar& lidar = sweep.lidars[std::size_t(sensor.lidar)];
        lidar.pattern = sensor.pattern;
        return {time_s, sensor.lidar, find_start(sensor.rays, lidar)};
    }
    /// Rays of a scan if they are not those of the sensor: made for this scan, or all
    /// fired at its time.
    std::optional<RayTable> rays_of_scan(const SensorChoice& sensor, double time_s) const {
        const bool makes_rays = sensor.pattern && sensor.rays.size() == 0,
                   rolls = has_rolling_shutter(sensor, config);
        if (rolls && !makes_rays) return {};
        RayTable rays = makes_rays ? make_rays(*sensor.pattern, time_s) : sensor.rays;
        if (!rolls) std::ranges::fill(rays.time_offset_s, 0.0f);
        return rays;
    }
    /// Sub-rays and returns of a sensor.
    SensorConfig config_of(const SensorChoice& sensor) const {
        SensorConfig result = config.sensor;
        if (sensor.returns > 0) result.returns = sensor.returns;
        if (sensor.returns > 1 && result.sub_rays == 1) result.sub_rays = 9;
        return result;
    }
    Renderer& renderer_of(const ScanStrand& strand) { return strand.copy ? *strand.copy : scene.renderer(); }
    std::shared_ptr<SensorRays> rays_of(ScanStrand& strand, const SensorChoice& sensor,
                                        const RayTable& table);
    /// Rays of a sweep that the device has been told to trace and to measure.
    struct Cast {
        std::shared_ptr<SensorRays> rays;
        PoseTrack track;  ///< of the sensor, one pose where it stands
        Pose pose;        ///< at the time of the sweep
    };
    Cast record(ScanStrand& strand, const SensorChoice& sensor, const RayTable& table, double time_s,
                bool refined);
    RenderedScan cast(const SensorChoice& sensor, const RayTable& table, double time_s, bool refined = false);
    RenderedScan join(const SensorChoice& sensor, const RenderedScan& parts, const RayTable& whole,
                      SensorConfig beams);
    /// An image that a network may look at: rays of any sensor ("native") or cells of a
    /// grid.
    struct ImageOf {
        int rows, columns;
        std::string name;
    };
    bool refines(const ImageOf& image) const;
    /// Whether the network looks at the scan as the sensor's rays take it.
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
    Air air_before(const SensorChoice& sensor, const RayTable& rays) const;
    std::vector<WetRay> wet_rays(const RenderedScan& scan);
    void measure(RenderedScan& scan, const SensorChoice& sensor, const RayTable& rays,
                 std::optional<std::uint64_t> sample);
    /// Where instances are in a sweep. @param actors  where they are; null: where the
    /// run's tracks have them
    std::vector<InstancePose> place(const SweepMoment& now, const ActorPoses* actors = nullptr) {
        return actors ? place_instances(layout, sweep, now, *actors) : place_instances(layout, sweep, now);
    }
    /// The vehicle is where it has to be for the sensor to be here.
    void drive(PoseTrack world_from_sensor, const SensorChoice& sensor) {
        const Pose& vehicle_from_sensor = sweep.lidars[std::size_t(sensor.lidar)].vehicle_from_sensor;
        sweep.world_from_vehicle = moved_track(std::move(world_from_sensor), inverse(vehicle_from_sensor));
        sweep.rolling_shutter = has_rolling_shutter(sensor, config);
    }
};

}  // namespace relidar
