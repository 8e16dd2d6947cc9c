// SPDX-License-Identifier: Apache-2.0
// Computes the points of scans on the device. The points of a scan are copied to the host
// while the device renders the next scan. Private to render.
#pragma once

#include <algorithm>

#include <relidar/log/log.hpp>

#include "gpu/prefix_sum.hpp"
#include "simulate/shared/render.h"

namespace relidar {

class DeviceSensorRays;

/// Sample for the share of unobserved rays, with an error of one or two percent.
inline constexpr std::size_t kSampledRays = 1024;

struct PointComputeOptions {
    const PoseTrack& points_from_sensor;
    double time_s;            ///< time of the sweep
    bool is_at_median_range;  ///< false: points are at the range of the range image
    /// [n_rays] array for the points; null: they are copied to the host
    const Array<shared::ReturnedPoint>* target = nullptr;
};

class DevicePointComputer {
public:
    /// Host buffers for the results of one scan.
    struct PointReadback {
        std::optional<ReadbackBuffer> points = {};
        ReadbackBuffer n_points, sampled_ranges, n_truncated;
        std::size_t point_capacity = 0;  ///< size of `points`, in points
        std::size_t n_rays = 0;          ///< number of rays of the scan
        bool has_points = false;         ///< false if the points stay on the device

        explicit PointReadback(Device& device);
    };

    explicit DevicePointComputer(Device& device);
    /// Records GPU commands that compute the points of measured rays.
    /// @param n_truncated device counter of rays whose search for hits was stopped by its
    /// limit
    /// @return host buffers; reused after the caller has released the pointer
    std::shared_ptr<PointReadback> record(Stream& stream, const DeviceSensorRays& rays,
                                          const PointComputeOptions& options,
                                          const Array<std::uint32_t>& n_truncated);

    struct GatheredPoints {
        std::size_t n_points;
        std::span<const shared::ReturnedPoint> points;  ///< empty if the points stay on the device
        /// [sample_count()] distance to the surface in metres
        std::span<const float> sampled_m;
        std::uint32_t n_truncated;  ///< number of rays whose search for hits was stopped by its limit
    };
    /// Waits until the device has written the buffers of a scan.
    /// @return valid until the buffers are reused
    static GatheredPoints wait(Stream& stream, PointReadback& buffers);
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
    std::vector<std::shared_ptr<PointReadback>> readbacks_;

    void reserve(Stream& stream, std::size_t n_rays);
    std::shared_ptr<PointReadback> copy_to_host(Stream& stream, std::size_t n_rays,
                                                const Array<std::uint32_t>& n_truncated, bool has_points);
};

}  // namespace relidar
