// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <future>
#include <memory>
#include <optional>
#include <vector>

#include <relidar/gpu/stream.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// Replaces the fired rays by one ray from the sensor origin through the centre of each
/// cell of the grid (train.grid). A cell gets the range, intensity, time and beam of its
/// nearest return (Eq. 6-7). A cell without a return becomes a dropped ray at the time at
/// which the LiDAR's head faces it. Second returns are removed.
Frame frame_to_grid(const Log& log, const Frame& frame, const RangeImageGrid& grid);

struct FrameUploadOptions {
    IgnoredMeasurements unknown;
    bool moves_rays =
        false;  ///< true if vehicle poses are corrected; FrameArrays::track_positions is then needed
    std::uint64_t resident_bytes = ~0ull;  ///< maximum device memory for frames that stay on the device
    /// if set, training uses a ray for each cell of this grid, not the rays of the sensor
    std::optional<RangeImageGrid> grid = {};
};

class TrainingFrames {
public:
    /// Uploads as many frames as fit into the memory budget.
    /// @param log  must outlive this object, because its scans are read for each
    /// upload
    /// @throws DataError if a frame has no ray
    TrainingFrames(Device& device, const Log& log, const std::vector<int>& frames, FrameUploadOptions use);

    const std::vector<TrainingFrameData>& all() const { return frames_; }
    TrainingFrameData& operator[](std::size_t index) { return frames_[index]; }
    const IgnoredMeasurements& mask_rules() const { return use_.unknown; }
    std::size_t count_resident() const { return n_staying_; }

    /// Uploads a frame unless it is on the device. Its arrays are valid until the next.
    TrainingFrameData& ensure_resident(Stream& stream, std::size_t frame);
    /// Announces the next frame. A thread starts to compute its rays.
    void prefetch_frame(std::size_t frame);

private:
    struct HostFrameArrays {
        std::vector<DeviceRay> rays;
        std::vector<DeviceTarget> targets;
        std::vector<shared::PoseInterpolation> track_positions;
    };

    const Log& log_;
    const FrameUploadOptions use_;
    std::vector<TrainingFrameData> frames_;
    std::size_t n_staying_ = 0;  ///< number of frames that stay on the device; they are the first frames
    std::shared_ptr<const FrameArrays> shared_;  ///< arrays that all other frames share
    std::future<HostFrameArrays> prefetched_frame_;
    std::size_t prefetched_index_ = 0;

    HostFrameArrays compute_arrays(std::size_t frame) const;
    HostFrameArrays take_prefetched(std::size_t frame);
    void upload_frames(Device& device);
    std::size_t bytes_per_ray() const;
};

/// Returns the learning rate of the hit and drop logits of each model, relative to the
/// rate of the background. Adam moves a logit by about its rate in a step, and only rays
/// that hit an actor move the logits of the actor. Without a higher rate, a dark actor
/// that few rays hit would still return everywhere at the end of training.
/// @param frames  training frames with the poses of their instances
/// @return [models] factors of at least 1; empty if all are 1
std::vector<float> logit_factors(const Scene& scene, std::span<const TrainingFrameData> frames,
                                 const TrainConfig& config);

}  // namespace relidar
