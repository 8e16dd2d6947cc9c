// SPDX-License-Identifier: Apache-2.0
// Reads requests and writes answers of sensorsim.proto. Its world frame is relidar's
// world near the log, because its numbers have single precision. The origin of the
// dataset's world may be thousands of kilometres away.
#pragma once

#include <memory>
#include <string>

#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "request_messages.hpp"
#include "sensor_shelf.hpp"
#include "sensorsim/sensorsim.pb.h"
#include "server.hpp"

namespace relidar::serve {

namespace sensorsim = nre::grpc::protos::sensorsim;

/// Reader for requests of sensorsim.proto. May be used from any thread.
class SensorsimReader {
public:
    /// Creates a reader for the messages of sensorsim.proto.
    /// @param outlines outlines of the scenes of `reader`; both must outlive this object
    /// @param order order of rotation and translation in every pose
    SensorsimReader(const std::vector<Run>& outlines, const RequestReader& reader, PoseOrder order)
        : outlines_(outlines), reader_(reader), order_(order) {}

    /// Returns the index of a scene.
    /// @throws Refusal for an unknown scene
    std::size_t find_scene(const std::string& scene_id) const {
        return reader_.find_scene(scene_id, "scene_id");
    }
    /// Reads a request. The sweep of the sensor fills the frame: its first ray is fired
    /// at the start of the frame, its last ray at the end.
    /// @throws Refusal that names an invalid field
    WantedScan read(const sensorsim::LidarRenderRequest& message);

private:
    const std::vector<Run>& outlines_;
    const RequestReader& reader_;
    const PoseOrder order_;
    SensorShelf sensors_;

    struct Frame {
        double start_s = 0.0, end_s = 0.0;
        glm::dvec3 world_offset_m{0.0};
    };
    std::shared_ptr<const SensorChoice> sensor(const sensorsim::LidarRenderRequest& message);
    Pose read_pose(const sensorsim::Pose& message, const std::string& field) const;
    PoseTrack read_track(const sensorsim::PosePair& message, const Frame& frame,
                         const std::string& field) const;
};

/// Writes the points of a scan that was rendered for a request of read().
void write_points(const Points& points, sensorsim::LidarRenderReturn& message);

/// Writes the trajectories of the log's vehicle and of its LiDARs.
/// @throws Refusal for a log that starts before time 0, which the messages cannot
/// represent
void write_trajectories(const Run& run, PoseOrder order, sensorsim::AvailableTrajectories& message);

}  // namespace relidar::serve
