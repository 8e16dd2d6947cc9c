// SPDX-License-Identifier: Apache-2.0
// Renders the scans that the web page shows.
#pragma once

#include <relidar/gpu/device.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/render.hpp>

#include "real_scans.hpp"
#include "request.hpp"
#include "traffic.hpp"

namespace relidar::view {

/// What the renderer keeps of the previous scan of a browser tab.
struct TabCache {
    std::optional<SimulatedSensor> file_sensor = {};
    std::optional<EditedTraffic> traffic = {};
    /// Sensor of the previous scan, and its key "lidar/name".
    std::optional<std::pair<std::string, SimulatedSensor>> sensor = {};
};

class BrowserScanRenderer {
public:
    BrowserScanRenderer(Run run, OtherRunsByName others, Device& device);

    const Run& trained_run() const { return run_; }
    const OtherRunsByName& other_runs() const { return others_; }
    const RecordedScans& measured_scans() const { return recorded_; }
    nlohmann::json page_data() const;
    /// In the binary format of frame.hpp.
    /// @throws UsageError or DataError
    std::string render_message(TabCache& tab_cache, const LiveScanRequest& request);
    nlohmann::json store_sensor(TabCache& tab_cache, const SensorFile& file) const;

private:
    SimulatedSensor tab_sensor(TabCache& tab_cache, const LiveScanRequest& request) const;
    RenderedScan render_scan(const EditedTraffic& edited_traffic, const LiveScanRequest& request,
                             const SimulatedSensor& sensor);
    Run make_edited_run(const ActorEdits& edits);
    ScanRenderer& edited_renderer(const EditedTraffic& traffic);
    nlohmann::json scan_header(const EditedTraffic& traffic, const LiveScanRequest& request,
                               const SimulatedSensor& sensor) const;
    const Frame* measured_frame(const LiveScanRequest& request) const;
    nlohmann::json kernel_times();

    const Run run_;
    const OtherRunsByName others_;
    Device& device_;
    RecordedScans recorded_;
    std::optional<ScanRenderer> renderer_;
    /// Copied actors as (name of the run, name of the track), moved actors as (name of
    /// the track, ""), standing objects that are edited as (name, "released").
    std::vector<std::pair<std::string, std::string>> rendered_;
    std::vector<std::string> actor_notes_;
    std::map<std::string, std::size_t> launches_;
};

}  // namespace relidar::view
