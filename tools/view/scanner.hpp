// SPDX-License-Identifier: Apache-2.0
// Scans of a run as the page wants them: simulated, measured, or both, with what the page
// draws around them.
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include <relidar/gpu/device.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "real_scans.hpp"
#include "request.hpp"
#include "traffic.hpp"

namespace relidar::view {

/// What is kept for one tab from one scan to the next.
struct TabCache {
    std::optional<SensorChoice> file_sensor = {};  ///< of its sensor file
    std::optional<Traffic> traffic = {};
    std::optional<std::pair<std::string, SensorChoice>> sensor = {};  ///< the last one, by "lidar/name"
};

/// Serves one thread.
class Scanner {
public:
    /// @param others  runs whose actors can be inserted
    Scanner(Run run, OtherRuns others, Device& device);

    const Run& run() const { return run_; }
    const OtherRuns& others() const { return others_; }
    const RealScans& real() const { return real_; }
    /// What the page has to know once: run, frames, path, sensors, actors of other runs,
    /// device.
    nlohmann::json describe() const;
    /// A scan as frame.hpp has it. @throws UsageError, DataError for what cannot be
    /// rendered
    std::string scan(TabCache& tab, const ScanWish& wish);
    /// Reads a tab's sensor file. @return what it is @throws UsageError, DataError naming
    /// what is wrong with it
    nlohmann::json read_sensor(TabCache& tab, const SensorFile& file) const;

private:
    SensorChoice sensor_for(TabCache& tab, const ScanWish& wish) const;
    RenderedScan render(const Traffic& traffic, const ScanWish& wish, const SensorChoice& sensor);
    ScanRenderer& renderer_for(const Traffic& traffic);
    const Frame* nearest_real(const ScanWish& wish) const;
    nlohmann::json kernel_times();

    const Run run_;
    const OtherRuns others_;
    Device& device_;
    RealScans real_;
    std::optional<ScanRenderer> renderer_;
    /// run and track of the copies that the renderer has
    std::vector<std::pair<std::string, std::string>> rendered_;
    std::map<std::string, std::size_t> launches_;  ///< of kernels, as they were counted last
};

}  // namespace relidar::view
