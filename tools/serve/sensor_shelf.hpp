// SPDX-License-Identifier: Apache-2.0
// Sensors whose rays are made already: uploaded ones by handle, and known ones by name. A
// shelf is bounded: what was used longest ago makes room.
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

/// For any thread.
class SensorShelf {
public:
    static constexpr std::size_t kMostSensors = 64;
    static constexpr std::size_t kMostRays = std::size_t(1) << 22;  ///< of all together: 120 MB

    /// @return a new key
    std::string add(SensorChoice sensor);
    std::shared_ptr<const SensorChoice> put(const std::string& key, SensorChoice sensor);
    /// Null where it is not there, or no longer.
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
