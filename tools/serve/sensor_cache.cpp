// SPDX-License-Identifier: Apache-2.0
#include "sensor_cache.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/simulate/render.hpp>

namespace relidar::serve {

std::string SensorCache::add(SensorChoice sensor) {
    std::string key;
    {
        const std::lock_guard lock(mutex_);
        key = fmt::format("sensor-{}", ++added_);
    }
    put(key, std::move(sensor));
    return key;
}

std::shared_ptr<const SensorChoice> SensorCache::put(const std::string& key, SensorChoice sensor) {
    const auto kept = std::make_shared<const SensorChoice>(std::move(sensor));
    const std::lock_guard lock(mutex_);
    while (!entries_.empty() &&
           (entries_.size() >= kMostSensors || count_rays() + kept->rays.size() > kMostRays))
        remove_oldest();
    entries_[key] = {kept, ++clock_};
    return kept;
}

std::shared_ptr<const SensorChoice> SensorCache::find(const std::string& key) {
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

std::size_t SensorCache::count_rays() const {
    std::size_t rays = 0;
    for (const auto& [handle, entry] : entries_) rays += entry.sensor->rays.size();
    return rays;
}

}  // namespace relidar::serve
