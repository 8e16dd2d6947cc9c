// SPDX-License-Identifier: Apache-2.0
// Computes the points of scans on the device and reads them back while the next scan is
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

/// Number of rays from which the share of unobserved rays (RenderedScan::unseen_share) is
/// estimated, with an error of one or two percent.
inline constexpr std::size_t kAskedRays = 1024;

/// Parameters of the computation of points.
struct PointMaking {
    /// poses of the sensor in the frame of the points; a single pose if it does not move
    const PoseTrack& points_from_sensor;
    double time_s;  ///< time of the sweep
    bool of_image;  ///< true: points use the range of the image; false: the range of the dominant surface
    bool refined;   ///< true: uses the drop probabilities of the network
};

class PointsOnDevice {
public:
    /// Memory through which the host reads the points of one scan.
    struct Slot {
        std::optional<Readback> points = {};
        Readback count, asked, capped;
        std::size_t room = 0;    ///< capacity, in points
        std::size_t n_rays = 0;  ///< number of rays of the scan

        explicit Slot(Device& device);
    };

    explicit PointsOnDevice(Device& device);
    /// Records the computation of the points of a measured scan.
    /// @param n_capped see ForwardPass::pass_cap_count()
    /// @return slot that receives the points; it is reused when no other owner holds it
    std::shared_ptr<Slot> record(Stream& stream, const SensorRays& rays, const PointMaking& how,
                                 const Array<std::uint32_t>& n_capped);

    struct Gathered {
        std::span<const shared::ReturnedPoint> points;
        std::span<const float> asked_m;  ///< ranges of the dominant surfaces of the rays asked_ray()
        std::uint32_t n_capped;
    };
    /// Waits for the points of a slot.
    /// @return valid until the slot is reused
    static Gathered wait(Stream& stream, Slot& slot);
    /// Returns the index of a sampled ray, whose surface range is read back even if the
    /// ray does not return.
    /// @param k index below n_asked()
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
