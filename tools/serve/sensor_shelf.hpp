// SPDX-License-Identifier: Apache-2.0
// Cache of sensors with their rays: uploaded sensors by handle, known sensors by name.
// Its size is limited; the least recently used sensor is removed.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <string>

namespace relidar {
struct SensorChoice;
}

namespace relidar::serve {

/// Cache of sensors. May be used from any thread.
class SensorShelf {
public:
    static constexpr std::size_t kMostSensors = 64;
    /// Maximum number of rays of all sensors, about 120 MB.
    static constexpr std::size_t kMostRays = std::size_t(1) << 22;

    /// Adds an uploaded sensor.
    /// @return a new handle
    std::string add(SensorChoice sensor);
    std::shared_ptr<const SensorChoice> put(const std::string& key, SensorChoice sensor);
    /// Returns a sensor, or null if it is unknown or was removed.
    std::shared_ptr<const SensorChoice> find(const std::string& key);

private:
    struct Entry {
        std::shared_ptr<const SensorChoice> sensor;
        std::uint64_t used;
    };
    std::mutex mutex_;
    std::map<std::string, Entry> entries_;
    std::uint64_t clock_ = 0;
    std::uint64_t added_ = 0;

    void forget_oldest();
    std::size_t count_rays() const;
};

}  // namespace relidar::serve
