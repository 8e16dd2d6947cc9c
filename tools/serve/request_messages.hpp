// SPDX-License-Identifier: Apache-2.0
// Checks the requests of clients for scans and converts them to requests of a renderer.
// Any thread may use it.
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
class SpawnedActors;
struct ActorToSpawn;

/// An actor that is visible in the requested scan.
struct PlacedActor {
    std::string name;   ///< Name of the actor in the request.
    std::string track;  ///< Name of its track in the rendered scene.
    glm::dvec3 size_m{0.0};
    std::size_t surfels = 0;
};

/// Name and poses of an actor, as given in a request.
struct ActorRequest {
    std::string field;  ///< Field of the request that holds the actor's name. Error messages contain it.
    std::string name;
    PoseTrack dataset_from_actor;
};

/// A request for a scan after all checks.
struct RenderRequest {
    std::size_t scene = 0;  ///< Index of the scene in the list of runs.
    std::shared_ptr<const SensorChoice> sensor;
    ScanRequest request;
    /// Actors that are visible in the scan, in the order of the request.
    std::vector<PlacedActor> placed;
    std::optional<std::uint64_t> sample;
    /// Weather to simulate. Without a value, the weather with which the server was
    /// started is used.
    std::optional<Weather> weather;
    double points_at_s = 0.0;
    bool points = true, range_image = false, drop_probability = false;
};

/// Returns the tracks of a run's actors. Clients use the names of the tracks as names of
/// the actors.
std::vector<std::string> actor_names(const Run& run);

/// Reads requests. It keeps no state of a request, but it caches sensors. The objects
/// that the constructor receives must outlive this object.
class RequestReader {
public:
    /// Creates a reader for the scenes of a device.
    /// @param scenes only the members that any thread may call are used
    explicit RequestReader(SceneSet& scenes);
    /// Creates a reader for runs that are not loaded on a device.
    RequestReader(const std::vector<Run>& outlines, const std::vector<SceneSource>& sources,
                  const AssetCatalogue& assets, const SpawnedActors& spawned);

    /// Returns the index of the scene with this name.
    /// @param field name of the field in the request, used in error messages
    /// @throws Refusal if the scene is unknown
    std::size_t find_scene(const std::string& name, const std::string& field = "scene") const;
    int find_lidar(std::size_t scene, const std::string& name) const;
    /// Stores the sensor that a client has described.
    /// @return a handle for later requests, and the sensor
    /// @throws Refusal if the description is invalid
    std::pair<std::string, std::shared_ptr<const SensorChoice>> upload(const v1::SensorSpec& spec);
    /// Reads a request to spawn actors. Returns the actors.
    /// @throws Refusal if a name is invalid, or if an actor or asset is unknown
    std::vector<ActorToSpawn> read_spawns(const v1::SpawnActorsRequest& message, std::size_t scene) const;
    /// Reads a request for a scan.
    /// @throws Refusal that names an invalid field
    RenderRequest read(const v1::RenderLidarRequest& message);
    /// Reads a request for a rig and returns one scan request per sensor.
    std::vector<RenderRequest> read(const v1::RenderRigRequest& message);
    /// Sets the actors that are visible in a scan. All other actors are absent.
    /// @throws Refusal if an actor is unknown or is given twice
    void place_actors(const std::vector<ActorRequest>& wishes, RenderRequest& wanted) const;

private:
    const std::vector<Run>& outlines_;
    const std::vector<SceneSource>& sources_;
    const AssetCatalogue& assets_;
    const SpawnedActors& spawned_;
    SensorCache uploaded_, named_;

    struct SensorRequest {
        const v1::Sensor& sensor;
        std::string field;
        std::uint32_t returns;
    };
    std::shared_ptr<const SensorChoice> find_sensor(const SensorRequest& wish, std::size_t scene, int lidar);
    std::shared_ptr<const SensorChoice> find_built_in_sensor(const std::string& name, std::size_t scene,
                                                             int lidar);
    std::vector<PlacedActor> known_actors(std::size_t scene) const;
    /// Reads a scan request for one sensor.
    /// @param path_from_sensor mounting of the sensor in a rig. Without a value, the path
    /// is the path of the sensor and is used without rounding.
    RenderRequest read_scan(const v1::RenderLidarRequest& message, const SensorRequest& wish,
                            const std::optional<Pose>& path_from_sensor);
};

}  // namespace relidar::serve
