// SPDX-License-Identifier: Apache-2.0
// Checks the scan requests of clients. Thread-safe.
#pragma once

#include <utility>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "relidar/v1/render.pb.h"
#include "scene_source.hpp"
#include "sensor_messages.hpp"

namespace relidar::serve {

class AssetCatalogue;
class SceneSet;
class SpawnedActorRegistry;
struct ActorToSpawn;

struct VisibleActor {
    std::string name;   ///< Name of the actor in the request.
    std::string track;  ///< Name of the actor's track in the rendered scene.
    std::string category;
    std::size_t instance = 0;  ///< Number of the actor in the points of scans.
    glm::dvec3 size_m{0.0};
    std::size_t surfels = 0;
};

struct RequestedActor {
    std::string field;  ///< path of the name in the message, for errors
    std::string name;
    PoseTrack dataset_from_actor;
};

struct RenderRequest {
    std::size_t scene = 0;  ///< Index of the scene in the list of runs.
    SensorPtr sensor;
    ScanRequest request;
    std::vector<VisibleActor> placed;     ///< actors at poses of the request
    std::optional<std::uint64_t> sample;  ///< seed of random noise; no value: expected values
    std::optional<Weather> weather;       ///< no value: the weather of the server
    double points_at_s = 0.0;             ///< points are in the sensor frame at this time
    /// parts of a scan that the client wants
    bool points = true, range_image = false, drop_probability = false, boxes = false;
};

std::vector<std::string> run_actor_names(const Run& run);

/// Caches only the sensors. The constructor's arguments must outlive this object.
class RequestReader {
public:
    /// Reads requests for the scenes of a server.
    explicit RequestReader(SceneSet& scenes);
    /// Reads requests without a SceneSet, which would need a device.
    /// @param outlines [scenes] runs without surfels
    /// @param spawned  actors that clients have added to the scenes
    RequestReader(const std::vector<Run>& outlines, const std::vector<SceneSource>& sources,
                  const AssetCatalogue& assets, const SpawnedActorRegistry& spawned);

    std::size_t find_scene(const std::string& scene_name, const std::string& field = "scene") const;
    int find_lidar(std::size_t scene, const std::string& name, const std::string& field = "lidar") const;
    /// @return a handle, with which later requests select this sensor, and the sensor
    /// @throws RejectedRequest if the text is invalid
    std::pair<std::string, SensorPtr> cache_sensor(const v1::SensorSpec& spec);
    std::vector<ActorToSpawn> read_spawn(const v1::SpawnActorsRequest& message, std::size_t scene) const;
    RenderRequest read_request(const v1::RenderLidarRequest& message);
    std::vector<RenderRequest> read_rig(const v1::RenderRigRequest& message);
    void set_visible(const std::vector<RequestedActor>& actors, RenderRequest& render_request) const;

private:
    const std::vector<Run>& outlines_;
    const std::vector<SceneSource>& sources_;
    const AssetCatalogue& assets_;
    const SpawnedActorRegistry& spawned_;
    SensorCache uploaded_, named_;

    struct SensorRequest {
        const v1::Sensor& sensor;
        std::string field;
        std::uint32_t returns;
    };
    SensorPtr requested_sensor(const SensorRequest& request, std::size_t scene, int lidar);
    SensorPtr find_built_in(const std::string& sensor_name, std::size_t scene, int lidar);
    std::vector<VisibleActor> scene_actors(std::size_t scene) const;
    /// @param rig_from_sensor no value if `message` contains the path of the sensor
    RenderRequest read_one(const v1::RenderLidarRequest& message, const SensorRequest& sensor,
                           const std::optional<Pose>& rig_from_sensor);
};

}  // namespace relidar::serve
