// SPDX-License-Identifier: Apache-2.0
// Requests for scans, looked at and turned into what a renderer takes. For any thread.
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

/// An actor that a request places.
struct PlacedActor {
    std::string name;   ///< as the request calls it
    std::string track;  ///< as the scene that is rendered does
    glm::dvec3 size_m{0.0};
    std::size_t surfels = 0;
};

/// An actor as a request names it, and where it wants it.
struct ActorWish {
    std::string field;  ///< of its name, for messages
    std::string name;
    PoseTrack dataset_from_actor;
};

/// A scan that is wanted and can be rendered.
struct WantedScan {
    std::size_t scene = 0;  ///< index into the outlines
    std::shared_ptr<const SensorChoice> sensor;
    ScanRequest request;
    std::vector<PlacedActor> placed;  ///< those of request.dataset_from_actor
    std::optional<std::uint64_t> sample;
    std::optional<Weather> weather;  ///< none: as the scene is served
    double points_at_s = 0.0;
    bool points = true, range_image = false, drop_probability = false;
};

/// Tracks of the actors of a run, as clients name them.
std::vector<std::string> actor_names(const Run& run);

/// Holds no state of a request; what it looks things up in outlives it.
class RequestReader {
public:
    /// @param scenes  of which what is for all threads is looked at
    explicit RequestReader(SceneSet& scenes);
    /// The same without a device behind it.
    RequestReader(const std::vector<Run>& outlines, const std::vector<SceneSource>& sources,
                  const AssetShelf& assets, const SpawnedActors& spawned);

    /// Index of a scene. @param field  its name in the request, for messages @throws
    /// Refusal
    std::size_t find_scene(const std::string& name, const std::string& field = "scene") const;
    int find_lidar(std::size_t scene, const std::string& name) const;
    /// Keeps a sensor that a client describes. @return its handle, and what it is @throws
    /// Refusal
    std::pair<std::string, std::shared_ptr<const SensorChoice>> upload(const v1::SensorSpec& spec);
    /// The actors to be spawned in a scene. @throws Refusal for names that make no sense,
    /// and for an actor or asset that is not there
    std::vector<SpawnWish> read_spawns(const v1::SpawnActorsRequest& message, std::size_t scene) const;
    /// @throws Refusal naming the field that makes no sense
    WantedScan read(const v1::RenderLidarRequest& message);
    /// One for each sensor.
    std::vector<WantedScan> read(const v1::RenderRigRequest& message);
    /// Has these actors in a scan, and no others. @throws Refusal for one that is not
    /// there, or that is there twice
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
    /// @param path_from_sensor  of a sensor of a rig; none: the path is the sensor's own,
    /// and keeps every bit
    WantedScan read_scan(const v1::RenderLidarRequest& message, const SensorWish& wish,
                         const std::optional<Pose>& path_from_sensor);
};

}  // namespace relidar::serve
