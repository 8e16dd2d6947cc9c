// SPDX-License-Identifier: Apache-2.0
// Computes the points of scans on the device. The points of a scan are copied to the host
// while the device renders the next scan. Private to render.
#pragma once

#include <algorithm>

#include <relidar/log/sequence.hpp>

#include "gpu/prefix_sum.hpp"
#include "simulate/shared/render.h"

namespace relidar {

class DeviceSensorRays;

/// Sample for the share of unobserved rays, with an error of one or two percent.
inline constexpr std::size_t kSampledRays = 1024;

struct PointComputeOptions {
    const PoseTrack& points_from_sensor;
    double time_s;  ///< time of the sweep
    bool of_image;  ///< true: points use the range of the image; false: the median range
    bool refined;   ///< true if the drop probabilities of the ray-drop network are used
    /// If not null, the points are written to this array, [n_rays], instead of host
    /// buffers.
    const Array<shared::ReturnedPoint>* target = nullptr;
};

class DevicePointComputer {
public:
    /// Host buffers that receive the points of one scan.
    struct PointReadbackSlot {
        std::optional<ReadbackBuffer> points = {};
        ReadbackBuffer count, sampled_ranges, capped;
        std::size_t point_capacity = 0;  ///< capacity, in points
        std::size_t n_rays = 0;          ///< number of rays of the scan
        bool on_device = false;          ///< true if the points are not copied to the host

        explicit PointReadbackSlot(Device& device);
    };

    explicit DevicePointComputer(Device& device);
    /// @param truncated device counter of rays whose search for hits was
    /// stopped by its limit
    /// @return host buffers; reused after the caller has released the pointer
    std::shared_ptr<PointReadbackSlot> record(Stream& stream, const DeviceSensorRays& rays,
                                              const PointComputeOptions& options,
                                              const Array<std::uint32_t>& truncated);

    struct GatheredPoints {
        std::size_t n_points;
        std::span<const shared::ReturnedPoint> points;  ///< empty if the points stay on the device
        /// [sample_count()] distance to the surface in metres
        std::span<const float> sampled_m;
        std::uint32_t n_capped;  ///< number of rays whose search for hits was stopped by its limit
    };
    /// Waits until the device has written the buffers of a scan.
    /// @return valid until the buffers are reused
    static GatheredPoints wait(Stream& stream, PointReadbackSlot& buffers);
    /// The host receives the distances of these rays even if they have no return.
    static std::size_t sample_ray(std::size_t sample, std::size_t n_rays) {
        return sample * n_rays / sample_count(n_rays);
    }
    static std::size_t sample_count(std::size_t n_rays) { return std::min(n_rays, kSampledRays); }

private:
    Device& device_;
    Kernel<shared::MarkReturnsParams> mark_;
    Kernel<shared::GatherPointsParams> gather_;
    PrefixSum sum_;
    Array<std::uint32_t, shared::ReturnMarks> marks_;
    Array<std::uint32_t, shared::ReturnPlaces> point_indices_;
    Array<std::uint32_t, shared::ScanTotal> count_;
    Array<shared::ReturnedPoint> points_;
    Array<float, shared::RequestedRanges> sampled_ranges_;
    std::vector<std::shared_ptr<PointReadbackSlot>> slots_;

    void reserve(Stream& stream, std::size_t n_rays);
    std::shared_ptr<PointReadbackSlot> record_readback(Stream& stream, std::size_t n_rays,
                                                       const Array<std::uint32_t>& truncated, bool on_device);
};

}  // namespace relidar
