// SPDX-License-Identifier: Apache-2.0
// Runs two kernels: simulate/render/mark_returns selects the returned rays, and
// simulate/render/gather_points computes their points.
#include "simulate/render/points_on_device.hpp"

#include <relidar/log/range_image.hpp>

#include "simulate/render/sensor_rays.hpp"

namespace relidar {

PointsOnDevice::PointsOnDevice(Device& device)
    : device_(device),
      mark_(device, "simulate/render/mark_returns"),
      gather_(device, "simulate/render/gather_points"),
      sum_(device),
      count_(device, 1, "number of returned points"),
      asked_(device, kAskedRays, "ranges of some rays") {}

void PointsOnDevice::reserve_rays(Stream& stream, std::size_t n_rays) {
    if (n_rays <= points_.size()) return;
    stream.finish();
    marks_ = {}, places_ = {}, points_ = {};  // frees the old arrays before allocating larger ones
    marks_ = Array<std::uint32_t, shared::ReturnMarks>(device_, n_rays, "rays that return");
    places_ = Array<std::uint32_t, shared::ReturnPlaces>(device_, n_rays, "places of points");
    sum_.reserve(device_, n_rays);
    points_ = Array<shared::ReturnedPoint>(device_, n_rays, "returned points");
}

std::shared_ptr<PointsOnDevice::Slot> PointsOnDevice::record(Stream& stream, const SensorRays& rays,
                                                             const PointMaking& options,
                                                             const Array<std::uint32_t>& n_capped) {
    const std::size_t n = rays.table().size();
    reserve_rays(stream, n);
    const std::vector<shared::SensorPose> poses = rays.poses(options.points_from_sensor, options.time_s);
    run(stream, mark_, n,
        {.measured = rays.measured().address(),
         .drop_prob = rays.drop_probabilities(),
         .marks = marks_.address(),
         .n_rays = std::uint32_t(n),
         .refined = options.refined ? 1u : 0u,
         .of_image = options.of_image ? 1u : 0u,
         .drop_threshold = kDropThreshold});
    sum_.run(stream, {marks_.address_as<std::uint32_t, shared::ScanCounts>()},
             places_.address_as<std::uint32_t, shared::ScanPrefix>(), std::uint32_t(n), count_.address());
    run(stream, gather_, n,
        {.rays = rays.rays().address(),
         .measured = rays.measured().address(),
         .poses = stream.impl().values(poses),
         .marks = marks_.address(),
         .places = places_.address(),
         .points = points_.address(),
         .asked = asked_.address(),
         .n_rays = std::uint32_t(n),
         .n_poses = std::uint32_t(poses.size()),
         .n_requested = std::uint32_t(n_requested(n)),
         .of_image = options.of_image ? 1u : 0u});
    return read_back(stream, n, n_capped);
}

PointsOnDevice::Slot::Slot(Device& device)
    : count(device, sizeof(std::uint32_t), "number of returned points"),
      asked(device, kAskedRays * sizeof(float), "ranges of some rays"),
      capped(device, sizeof(std::uint32_t), "pass cap count") {}

std::shared_ptr<PointsOnDevice::Slot> PointsOnDevice::read_back(Stream& stream, std::size_t n_rays,
                                                                const Array<std::uint32_t>& n_capped) {
    auto place =
        std::ranges::find_if(slots_, [](const std::shared_ptr<Slot>& slot) { return slot.use_count() == 1; });
    if (place == slots_.end()) place = slots_.insert(place, std::make_shared<Slot>(device_));
    Slot& slot = **place;
    if (n_rays > slot.room) {
        slot.points.emplace(device_, n_rays * sizeof(shared::ReturnedPoint), "returned points");
        slot.room = n_rays;
    }
    slot.n_rays = n_rays;
    slot.points->record(stream, points_.buffer(), n_rays * sizeof(shared::ReturnedPoint));
    slot.count.record(stream, count_.buffer(), sizeof(std::uint32_t));
    slot.asked.record(stream, asked_.buffer(), n_requested(n_rays) * sizeof(float));
    slot.capped.record(stream, n_capped.buffer(), sizeof(std::uint32_t));
    return *place;
}

PointsOnDevice::Gathered PointsOnDevice::wait(Stream& stream, Slot& slot) {
    const auto number = [&](Readback& readback) {
        return *static_cast<const std::uint32_t*>(readback.wait(stream));
    };
    return {{static_cast<const shared::ReturnedPoint*>(slot.points->wait(stream)), number(slot.count)},
            {static_cast<const float*>(slot.asked.wait(stream)), n_requested(slot.n_rays)},
            number(slot.capped)};
}

}  // namespace relidar
