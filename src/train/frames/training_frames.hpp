// SPDX-License-Identifier: Apache-2.0
// All training frames. Frames within a memory budget are resident on the device. The
// others are uploaded to shared arrays when they are needed, so that device memory does
// not grow with the log.
#pragma once

#include <cstdint>
#include <future>
#include <memory>
#include <optional>
#include <vector>

#include <relidar/gpu/stream.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// What the device needs of the frames.
struct FrameUse {
    Unknown unknown;
    bool moves_rays = false;  ///< true: vehicle poses are corrected, so FrameArrays::places is needed
    std::uint64_t stay_bytes = ~0ull;  ///< maximum device memory of resident frames
    /// if set, the rays are those of the grid's cells, see on_grid()
    std::optional<RangeGrid> grid = {};
};

class TrainingFrames {
public:
    /// Creates the frames and uploads the resident ones.
    /// @param sequence  must outlive this object, because its scans are read for each
    /// upload
    /// @param positions  indices into Sequence::frames of the frames
    /// @throws DataError if a frame has no ray
    TrainingFrames(Device& device, const Sequence& sequence, const std::vector<int>& positions, FrameUse use);
    ~TrainingFrames();

    const std::vector<FrameData>& all() const { return frames_; }
    FrameData& operator[](std::size_t i) { return frames_[i]; }
    /// Returns the measurements that the targets exclude.
    const Unknown& unknown() const { return use_.unknown; }
    /// Returns the number of resident frames.
    std::size_t n_staying() const { return n_staying_; }

    /// Records the upload of frame i if it is not on the device. Its arrays are valid
    /// until another frame is uploaded.
    FrameData& bring(Stream& stream, std::size_t i);
    /// Announces that frame i is next. If it needs an upload, a thread starts to prepare
    /// it.
    void expect(std::size_t i);

private:
    /// Arrays of a frame in host memory, before the upload.
    struct HostFrame {
        std::vector<DeviceRay> rays;
        std::vector<DeviceTarget> targets;
        std::vector<shared::RayPlace> places;
    };

    const Sequence& sequence_;
    const FrameUse use_;
    std::vector<FrameData> frames_;
    std::size_t n_staying_ = 0;                  ///< number of resident frames, which are the first ones
    std::shared_ptr<const FrameArrays> shared_;  ///< arrays that all other frames share
    std::future<HostFrame> coming_;
    std::size_t coming_frame_ = 0;

    HostFrame prepare(std::size_t i) const;
    HostFrame take(std::size_t i);
    void keep_on_device(Device& device);
    std::size_t bytes_per_ray() const;
};

}  // namespace relidar
