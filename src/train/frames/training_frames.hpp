// SPDX-License-Identifier: Apache-2.0
// Manages all training frames. Keeps frames in device memory up to a memory budget.
// Uploads every other frame to shared arrays when training uses the frame. Therefore
// device memory does not grow with the log.
#pragma once

#include <cstdint>
#include <future>
#include <memory>
#include <optional>
#include <vector>

#include <relidar/gpu/stream.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// Options for uploading training frames.
struct FrameUse {
    Unknown unknown;
    bool moves_rays = false;  ///< true if vehicle poses are corrected; FrameArrays::places is then needed
    std::uint64_t resident_bytes = ~0ull;  ///< maximum device memory for frames that stay on the device
    /// If set, training uses one ray for each cell of this grid instead of the rays of
    /// the sensor.
    std::optional<RangeGrid> grid = {};
};

class TrainingFrames {
public:
    /// Creates all frames, and uploads as many as fit into the memory budget.
    /// @param sequence  must outlive this object, because its scans are read for each
    /// upload
    /// @param positions  indices of the frames in Sequence::frames
    /// @throws DataError if a frame has no ray
    TrainingFrames(Device& device, const Sequence& sequence, const std::vector<int>& positions, FrameUse use);
    ~TrainingFrames();

    const std::vector<FrameData>& all() const { return frames_; }
    FrameData& operator[](std::size_t index) { return frames_[index]; }
    /// Returns the rule that selects the measurements that training ignores.
    const Unknown& unknown() const { return use_.unknown; }
    /// Returns the number of frames that stay in device memory.
    std::size_t n_resident() const { return n_staying_; }

    /// Uploads frame `index` if it is not in device memory. The arrays of an uploaded
    /// frame are valid until the next upload.
    FrameData& make_resident(Stream& stream, std::size_t index);
    /// Announces that frame `index` is used next. If the frame must be uploaded, a
    /// background thread starts to compute its rays.
    void expect(std::size_t index);

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
    std::size_t n_staying_ = 0;  ///< number of frames that stay on the device; they are the first frames
    /// arrays that are shared by all frames that do not stay in device memory
    std::shared_ptr<const FrameArrays> shared_;
    std::future<HostFrame> coming_;
    std::size_t coming_frame_ = 0;

    HostFrame prepare(std::size_t index) const;
    HostFrame take(std::size_t index);
    void keep_on_device(Device& device);
    std::size_t count_bytes_per_ray() const;
};

}  // namespace relidar
