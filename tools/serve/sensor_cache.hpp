// SPDX-License-Identifier: Apache-2.0
// Caches sensors together with their rays. The key is the handle of an uploaded sensor,
// or the name of a built-in sensor. If the cache is full, the least recently used sensor
// is removed.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>

namespace relidar {
struct SimulatedSensor;
}

namespace relidar::serve {

using SensorPtr = std::shared_ptr<const SimulatedSensor>;

class SensorCache {
public:
    static constexpr std::size_t kMostSensors = 64;
    static constexpr std::size_t kMostRays = std::size_t(1) << 22;

    std::string add_upload(SimulatedSensor sensor);
    SensorPtr add_sensor(const std::string& key, SimulatedSensor sensor);
    SensorPtr find_cached(const std::string& key);

private:
    struct CachedSensor {
        SensorPtr sensor;
        std::uint64_t used;
    };
    std::mutex mutex_;
    std::map<std::string, CachedSensor> entries_;
    std::uint64_t clock_ = 0;
    std::uint64_t added_ = 0;

    void remove_oldest();
    std::size_t cached_rays() const;
};

}  // namespace relidar::serve
