// SPDX-License-Identifier: Apache-2.0
// Reads requests and writes responses of sensorsim.proto. All poses are in relidar's
// world frame, whose origin is near the log. The origin of the dataset's world frame may
// be thousands of kilometres away. The float values of the messages would be too inexact
// there.
#pragma once

#include "request_messages.hpp"
#include "sensor_messages.hpp"
#include "sensorsim/sensorsim.pb.h"
#include "server.hpp"

namespace relidar::serve {

namespace sensorsim = nre::grpc::protos::sensorsim;

class SensorsimReader {
public:
    /// @param outlines [scenes] runs without surfels; `outlines` and `reader` must
    /// outlive this object
    SensorsimReader(const std::vector<Run>& outlines, const RequestReader& reader, PoseTransformOrder order)
        : outlines_(outlines), reader_(reader), order_(order) {}

    std::size_t find_scene(const std::string& scene_id) const {
        return reader_.find_scene(scene_id, "scene_id");
    }
    /// The first ray is fired at the start of the requested interval, the last ray at its
    /// end.
    /// @throws RejectedRequest that names the first invalid field
    RenderRequest read_request(const sensorsim::LidarRenderRequest& message);

private:
    const std::vector<Run>& outlines_;
    const RequestReader& reader_;
    const PoseTransformOrder order_;
    SensorCache sensors_;

    struct SensorsimTimeFrame {
        double start_s = 0.0, end_s = 0.0;
        glm::dvec3 world_offset_m{0.0};
    };
    SensorPtr find_or_make_sensor(const sensorsim::LidarRenderRequest& message, std::size_t scene);
    Pose read_pose(const sensorsim::Pose& message, const std::string& name) const;
    PoseTrack read_track(const sensorsim::PosePair& message, const SensorsimTimeFrame& frame,
                         const std::string& name) const;
};

void write_points(const LidarPoints& points, sensorsim::LidarRenderReturn& message);

void write_actors(const Run& run, PoseTransformOrder order, sensorsim::DynamicObjectTracks& message);

void write_paths(const Run& run, PoseTransformOrder order, sensorsim::AvailableTrajectories& message);

}  // namespace relidar::serve
