// SPDX-License-Identifier: Apache-2.0
// Renders the scans that the web page shows. The page shows a simulated scan, a measured
// scan, or both, and the boxes of actors.
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

/// State that the server keeps for a browser tab between two scans.
struct TabCache {
    /// Sensor in the file that the browser tab has uploaded.
    std::optional<SensorChoice> file_sensor = {};
    std::optional<Traffic> traffic = {};
    /// Sensor of the previous scan, and its key "lidar/name".
    std::optional<std::pair<std::string, SensorChoice>> sensor = {};
};

/// Renders scans of a run for the web page. Only one thread may use this object.
class Scanner {
public:
    /// Creates the scanner of a run.
    /// @param others other runs, whose actors the user can insert into this run
    Scanner(Run run, OtherRuns others, Device& device);

    const Run& run() const { return run_; }
    const OtherRuns& others() const { return others_; }
    const RealScans& real() const { return real_; }
    /// Returns the data that the web page needs only once: the run, its frames and path,
    /// built-in sensors, actors of other runs, and the device.
    nlohmann::json describe() const;
    /// Renders a scan and encodes it in the binary format of frame.hpp.
    /// @throws UsageError or DataError if the scan cannot be rendered
    std::string scan(TabCache& tab, const LiveScanRequest& request);
    /// Reads a sensor file that a browser tab has uploaded.
    /// @return a description of the sensor
    /// @throws UsageError or DataError if the file is invalid
    nlohmann::json read_sensor(TabCache& tab, const SensorFile& file) const;

private:
    SensorChoice make_sensor_for_tab(TabCache& tab, const LiveScanRequest& request) const;
    RenderedScan render(const Traffic& traffic, const LiveScanRequest& request, const SensorChoice& sensor);
    ScanRenderer& find_renderer(const Traffic& traffic);
    const Frame* find_nearest_real_frame(const LiveScanRequest& request) const;
    nlohmann::json kernel_times();

    const Run run_;
    const OtherRuns others_;
    Device& device_;
    RealScans real_;
    std::optional<ScanRenderer> renderer_;
    /// Copied and moved actors in the scene of the current renderer, as listed by
    /// list_models().
    std::vector<std::pair<std::string, std::string>> rendered_;
    /// Number of recorded times of each kernel at the previous call of kernel_times().
    std::map<std::string, std::size_t> launches_;
};

}  // namespace relidar::view
