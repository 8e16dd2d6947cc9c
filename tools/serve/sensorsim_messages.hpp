// SPDX-License-Identifier: Apache-2.0
// Requests and answers of sensorsim.proto. Its world is relidar's, near the log, because
// its numbers are single; the dataset's world may lie thousands of kilometres away.
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

/// For any thread.
class SensorsimReader {
public:
    /// @param outlines  of the scenes that `reader` knows; both outlive this @param order
    /// of the parts of every pose
    SensorsimReader(const std::vector<Run>& outlines, const RequestReader& reader, PoseOrder order)
        : outlines_(outlines), reader_(reader), order_(order) {}

    /// Index of a scene. @throws Refusal
    std::size_t find_scene(const std::string& scene_id) const {
        return reader_.find_scene(scene_id, "scene_id");
    }
    /// The sensor's sweep fills the frame: its first ray is fired when that begins, its
    /// last one when it ends.
    /// @throws Refusal naming the field that makes no sense
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

/// Points of a scan that has been rendered as read() says.
void write_points(const Points& points, sensorsim::LidarRenderReturn& message);

/// Of the log's vehicle, then of its LiDARs. @throws Refusal for a log that began before
/// time 0, which the wire cannot say
void write_trajectories(const Run& run, PoseOrder order, sensorsim::AvailableTrajectories& message);

}  // namespace relidar::serve
