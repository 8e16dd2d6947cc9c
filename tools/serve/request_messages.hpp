// SPDX-License-Identifier: Apache-2.0
// Checks requests for scans and converts them to requests of a renderer. May be used from
// any thread.
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
#include "sensor_shelf.hpp"

namespace relidar::serve {

class AssetShelf;
class SceneSet;
class SpawnedActors;
struct SpawnWish;

/// An actor that a request places in the scene.
struct PlacedActor {
    std::string name;   ///< Name in the request.
    std::string track;  ///< Track in the rendered scene.
    glm::dvec3 size_m{0.0};
    std::size_t surfels = 0;
};

/// Name and poses of an actor in a request.
struct ActorWish {
    std::string field;  ///< Field of the actor's name, for messages.
    std::string name;
    PoseTrack dataset_from_actor;
};

/// A valid request for a scan.
struct WantedScan {
    std::size_t scene = 0;  ///< Index into the outlines.
    std::shared_ptr<const SensorChoice> sensor;
    ScanRequest request;
    std::vector<PlacedActor> placed;  ///< The actors of request.dataset_from_actor.
    std::optional<std::uint64_t> sample;
    std::optional<Weather> weather;  ///< No value: the weather that the server was started with.
    double points_at_s = 0.0;
    bool points = true, range_image = false, drop_probability = false;
};

/// Returns the tracks of the actors of a run, which are the names for clients.
std::vector<std::string> actor_names(const Run& run);

/// Reads requests. Stores no state of a request. The objects given to the constructor
/// must outlive it.
class RequestReader {
public:
    /// Creates a reader for the scenes of a device.
    /// @param scenes only its thread-safe members are used
    explicit RequestReader(SceneSet& scenes);
    /// Creates a reader without a device.
    RequestReader(const std::vector<Run>& outlines, const std::vector<SceneSource>& sources,
                  const AssetShelf& assets, const SpawnedActors& spawned);

    /// Returns the index of a scene.
    /// @param field name of the field in the request, for messages
    /// @throws Refusal for an unknown scene
    std::size_t find_scene(const std::string& name, const std::string& field = "scene") const;
    int find_lidar(std::size_t scene, const std::string& name) const;
    /// Stores a sensor that a client describes.
    /// @return handle of the sensor, and the sensor
    /// @throws Refusal for an invalid sensor
    std::pair<std::string, std::shared_ptr<const SensorChoice>> upload(const v1::SensorSpec& spec);
    /// Returns the actors to spawn in a scene.
    /// @throws Refusal for invalid names, and for an unknown actor or asset
    std::vector<SpawnWish> read_spawns(const v1::SpawnActorsRequest& message, std::size_t scene) const;
    /// Reads a request for a scan.
    /// @throws Refusal that names an invalid field
    WantedScan read(const v1::RenderLidarRequest& message);
    /// Returns one request for each sensor.
    std::vector<WantedScan> read(const v1::RenderRigRequest& message);
    /// Sets the actors of a scan; all other actors are absent.
    /// @throws Refusal for an unknown actor, or an actor that is given twice
    void place_actors(const std::vector<ActorWish>& wishes, WantedScan& wanted) const;

private:
    const std::vector<Run>& outlines_;
    const std::vector<SceneSource>& sources_;
    const AssetShelf& assets_;
    const SpawnedActors& spawned_;
    SensorShelf uploaded_, named_;

    struct SensorWish {
        const v1::Sensor& sensor;
        std::string field;
        std::uint32_t returns;
    };
    std::shared_ptr<const SensorChoice> find_sensor(const SensorWish& wish, std::size_t scene, int lidar);
    std::shared_ptr<const SensorChoice> known_sensor(const std::string& name, std::size_t scene, int lidar);
    std::vector<PlacedActor> known_actors(std::size_t scene) const;
    /// Reads a request for one sensor.
    /// @param path_from_sensor mounting of the sensor in a rig. No value: the path
    /// belongs to the sensor itself and is used without rounding.
    WantedScan read_scan(const v1::RenderLidarRequest& message, const SensorWish& wish,
                         const std::optional<Pose>& path_from_sensor);
};

}  // namespace relidar::serve
