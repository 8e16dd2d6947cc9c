// SPDX-License-Identifier: Apache-2.0
// The points of scans, gathered on the device and read back one scan while another is
// rendered. Private to render.
#pragma once

#include <algorithm>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include <relidar/log/sequence.hpp>

#include "gpu/prefix_sum.hpp"
#include "simulate/shared/render.h"

namespace relidar {

class SensorRays;

/// Of how many rays the share that looks where the log did not is known by: to a percent
/// or two, in half a millisecond.
inline constexpr std::size_t kAskedRays = 1024;

/// Where points are made, and of what.
struct PointMaking {
    const PoseTrack& points_from_sensor;  ///< one pose: the sensor stands
    double time_s;                        ///< of the sweep
    bool of_image;  ///< points lie where the image's range says, else on the dominant surface
    bool refined;   ///< drop probabilities are those of the network
};

class PointsOnDevice {
public:
    /// What the host reads of a scan.
    struct Slot {
        std::optional<Readback> points = {};
        Readback count, asked, capped;
        std::size_t room = 0;    ///< points
        std::size_t n_rays = 0;  ///< of its scan

        explicit Slot(Device& device);
    };

    explicit PointsOnDevice(Device& device);
    /// Records the points of a scan that has been measured. @param n_capped  see
    /// ForwardPass::pass_cap_count()
    /// @return where they go; used again when nobody else holds it
    std::shared_ptr<Slot> record(Stream& stream, const SensorRays& rays, const PointMaking& how,
                                 const Array<std::uint32_t>& n_capped);

    struct Gathered {
        std::span<const shared::ReturnedPoint> points;
        std::span<const float> asked_m;  ///< ranges of dominant surfaces of the rays asked_ray()
        std::uint32_t n_capped;
    };
    /// Waits for the points of a slot. @return valid until it is used again
    static Gathered wait(Stream& stream, Slot& slot);
    /// Rays of which a scan says what they meet, whether they return or not. @param k
    /// below n_asked()
    static std::size_t asked_ray(std::size_t k, std::size_t n_rays) { return k * n_rays / n_asked(n_rays); }
    static std::size_t n_asked(std::size_t n_rays) { return std::min(n_rays, kAskedRays); }

private:
    Device& device_;
    Kernel<shared::MarkReturnsParams> mark_;
    Kernel<shared::GatherPointsParams> gather_;
    PrefixSum sum_;
    Array<std::uint32_t, shared::ReturnMarks> marks_;
    Array<std::uint32_t, shared::ReturnPlaces> places_;
    Array<std::uint32_t, shared::ScanTotal> count_;
    Array<shared::ReturnedPoint> points_;
    Array<float, shared::AskedRanges> asked_;
    std::vector<std::shared_ptr<Slot>> slots_;

    void make_room(Stream& stream, std::size_t n_rays);
    std::shared_ptr<Slot> read_back(Stream& stream, std::size_t n_rays, const Array<std::uint32_t>& n_capped);
};

}  // namespace relidar
