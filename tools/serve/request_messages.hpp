// SPDX-License-Identifier: Apache-2.0
// Checks the scan requests of clients and converts them to requests for the renderer.
// Several threads may use these functions at the same time.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"
#include "scene_source.hpp"
#include "sensor_cache.hpp"

namespace relidar::serve {

class AssetCatalogue;
class SceneSet;
class SpawnedActorRegistry;
struct ActorToSpawn;

/// An actor that is visible in the requested scan.
struct VisibleActor {
    std::string name;   ///< Name of the actor in the request.
    std::string track;  ///< Name of the actor's track in the rendered scene.
    std::string category;
    std::size_t instance = 0;  ///< Number of the actor in the points of scans.
    glm::dvec3 size_m{0.0};
    std::size_t surfels = 0;
};

/// Name and poses of an actor that a client wants to see in the scan.
struct RequestedActor {
    /// name of the field of the request that holds the actor's name, for error messages
    std::string field;
    std::string name;
    PoseTrack dataset_from_actor;
};

/// A request for a scan after all checks.
struct RenderRequest {
    std::size_t scene = 0;  ///< Index of the scene in the list of runs.
    std::shared_ptr<const SimulatedSensor> sensor;
    ScanRequest request;
    /// Actors that are visible in the scan, in the order in which the client listed them.
    std::vector<VisibleActor> placed;
    std::optional<std::uint64_t> sample;
    /// Weather to simulate. Without a value, the renderer uses the weather with which the
    /// server was started.
    std::optional<Weather> weather;
    double points_at_s = 0.0;
    bool points = true, range_image = false, drop_probability = false, boxes = false;
};

/// Returns the names of a run's actors. They equal the names of the actors' tracks.
std::vector<std::string> list_actor_names_of_run(const TrainedRun& run);

/// Reads and checks scan requests. Caches the sensors, but keeps no other data of a
/// request. The constructor's arguments must outlive this object.
class RequestReader {
public:
    /// Creates a reader of requests for the scenes of a server.
    /// @param scenes only its thread-safe members are called
    explicit RequestReader(SceneSet& scenes);
    /// Creates a reader without a SceneSet, which would need a device.
    /// @param outlines [scenes] trained run (log, settings, scene) without surfels
    RequestReader(const std::vector<TrainedRun>& outlines, const std::vector<SceneSource>& sources,
                  const AssetCatalogue& assets, const SpawnedActorRegistry& spawned);

    /// Returns the index of the scene with this name.
    /// @param field_name_for_errors name of the field in the request, for error messages
    /// @throws RejectedRequest if the scene is unknown
    std::size_t find_scene_index_or_throw(const std::string& scene_name,
                                          const std::string& field_name_for_errors = "scene") const;
    /// Returns the index of the LiDAR with this name. For an empty name, returns 0.
    /// @param field_name_for_errors name of the field in the request, for error messages
    /// @throws RejectedRequest if the LiDAR is unknown
    int find_lidar_index_or_throw(std::size_t scene_index, const std::string& lidar_name_or_empty,
                                  const std::string& field_name_for_errors = "lidar") const;
    /// Caches a sensor that a client has described.
    /// @return a handle, with which later requests select this sensor, and the sensor
    /// @throws RejectedRequest if the description is invalid
    std::pair<std::string, std::shared_ptr<const SimulatedSensor>> cache_uploaded_sensor(
        const v1::SensorSpec& spec);
    /// Reads a request to add actors to a scene. Returns these actors.
    /// @throws RejectedRequest if a name is invalid, or if an actor or asset is unknown
    std::vector<ActorToSpawn> read_actors_to_spawn(const v1::SpawnActorsRequest& message,
                                                   std::size_t scene_index) const;
    /// Reads a request for a scan and checks all fields.
    /// @throws RejectedRequest that names the first invalid field
    RenderRequest convert_to_checked_render_request(const v1::RenderLidarRequest& message);
    /// Reads a request for several sensors on one vehicle. Returns one scan request per
    /// sensor.
    std::vector<RenderRequest> convert_to_request_per_rig_sensor(const v1::RenderRigRequest& message);
    /// Sets the actors that are visible in a scan. All other actors of the scene are
    /// hidden.
    /// @throws RejectedRequest if an actor is unknown or appears twice
    void set_visible_actors_of_request(const std::vector<RequestedActor>& requested_visible_actors,
                                       RenderRequest& render_request) const;

private:
    const std::vector<TrainedRun>& outlines_;
    const std::vector<SceneSource>& sources_;
    const AssetCatalogue& assets_;
    const SpawnedActorRegistry& spawned_;
    SensorCache uploaded_, named_;

    struct SensorRequest {
        const v1::Sensor& sensor;
        std::string field;
        std::uint32_t returns;
    };
    std::shared_ptr<const SimulatedSensor> find_requested_sensor(const SensorRequest& request,
                                                                 std::size_t scene_index, int lidar_index);
    std::shared_ptr<const SimulatedSensor> find_built_in_sensor(const std::string& sensor_name,
                                                                std::size_t scene_index, int lidar_index);
    std::vector<VisibleActor> list_actors_of_scene(std::size_t scene_index) const;
    /// Reads a scan request for one sensor.
    /// @param rig_from_sensor pose of the sensor on its rig if `message` contains the
    /// path of the rig; no value if `message` contains the path of the sensor
    RenderRequest read_request_of_one_sensor(const v1::RenderLidarRequest& message,
                                             const SensorRequest& sensor_request,
                                             const std::optional<Pose>& rig_from_sensor);
};

}  // namespace relidar::serve
