// SPDX-License-Identifier: Apache-2.0
// All training frames. As many as fit into a budget stay on the device; of the others
// each comes when its turn is there, to a place that they share. So the memory of the
// device does not grow with the log.
#pragma once

#include <cstdint>
#include <future>
#include <memory>
#include <optional>
#include <vector>

#include <relidar/gpu/stream.hpp>

#include "train/frames/frame_data.hpp"

namespace relidar {

/// What of the frames is wanted on the device.
struct FrameUse {
    Unknown unknown;
    bool moves_rays = false;           ///< poses of the vehicle are corrected: FrameArrays::places are there
    std::uint64_t stay_bytes = ~0ull;  ///< of frames that stay on the device, at most
    std::optional<RangeGrid> grid = {};  ///< rays are those of its cells: on_grid()
};

class TrainingFrames {
public:
    /// @param sequence  must outlive this: its scans are read whenever a frame comes
    /// @param positions  of the frames in Sequence::frames @throws DataError where one
    /// has no ray
    TrainingFrames(Device& device, const Sequence& sequence, const std::vector<int>& positions, FrameUse use);
    ~TrainingFrames();

    const std::vector<FrameData>& all() const { return frames_; }
    FrameData& operator[](std::size_t i) { return frames_[i]; }
    /// What the frames' targets leave out.
    const Unknown& unknown() const { return use_.unknown; }
    /// How many stay on the device.
    std::size_t n_staying() const { return n_staying_; }

    /// Records what brings frame i to the device, where it is not: its arrays are there
    /// until another one comes.
    FrameData& bring(Stream& stream, std::size_t i);
    /// Frame i comes next: where it has to be brought, a thread begins to prepare it.
    void expect(std::size_t i);

private:
    /// A frame as it goes to the device.
    struct HostFrame {
        std::vector<DeviceRay> rays;
        std::vector<DeviceTarget> targets;
        std::vector<shared::RayPlace> places;
    };

    const Sequence& sequence_;
    const FrameUse use_;
    std::vector<FrameData> frames_;
    std::size_t n_staying_ = 0;                  ///< the first ones
    std::shared_ptr<const FrameArrays> shared_;  ///< of all others
    std::future<HostFrame> coming_;
    std::size_t coming_frame_ = 0;

    HostFrame prepare(std::size_t i) const;
    HostFrame take(std::size_t i);
    void keep_on_device(Device& device);
    std::size_t bytes_per_ray() const;
};

}  // namespace relidar
