// SPDX-License-Identifier: Apache-2.0
#include "sensor_cache.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/simulate/render.hpp>

namespace relidar::serve {

std::string SensorCache::add_upload(SimulatedSensor sensor) {
    std::string key;
    {
        const std::lock_guard lock(mutex_);
        key = fmt::format("sensor-{}", ++added_);
    }
    add_sensor(key, std::move(sensor));
    return key;
}

SensorPtr SensorCache::add_sensor(const std::string& key, SimulatedSensor sensor) {
    const auto shared_sensor = std::make_shared<const SimulatedSensor>(std::move(sensor));
    const std::lock_guard lock(mutex_);
    while (!entries_.empty() &&
           (entries_.size() >= kMostSensors || cached_rays() + shared_sensor->rays.size() > kMostRays))
        remove_oldest();
    entries_[key] = {shared_sensor, ++clock_};
    return shared_sensor;
}

SensorPtr SensorCache::find_cached(const std::string& key) {
    const std::lock_guard lock(mutex_);
    const auto entry = entries_.find(key);
    if (entry == entries_.end()) return nullptr;
    entry->second.used = ++clock_;
    return entry->second.sensor;
}

void SensorCache::remove_oldest() {
    entries_.erase(std::min_element(
        entries_.begin(), entries_.end(),
        [](const auto& first, const auto& second) { return first.second.used < second.second.used; }));
}

std::size_t SensorCache::cached_rays() const {
    std::size_t rays = 0;
    for (const auto& [handle, entry] : entries_) rays += entry.sensor->rays.size();
    return rays;
}

}  // namespace relidar::serve
