// SPDX-License-Identifier: Apache-2.0
#include "render/render_notes.hpp"

#include <map>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include "console.hpp"

namespace relidar::cli {

void note_compensated_rays(const Run& run, const SensorChoice& sensor) {
    if (run.config.sensor.rolling_shutter != RollingShutter::automatic ||
        has_rolling_shutter(sensor, run.config))
        return;
    note(
        fmt::format("scans of {} are motion-compensated like the log, which means that all rays are fired at "
                    "the scan's time; use --set sensor.rolling_shutter=true to fire each ray at its own time",
                    sensor.name));
}

void note_unrefined_drops(const Run& run, const ScanRenderer& renderer, const SensorChoice& sensor) {
    if (!run.config.refine.enabled || run.drop_network.empty() || renderer.refines(sensor)) return;
    note(
        fmt::format("the ray-drop network of {} needs {} images of at least {} x {} pixels; scans of {} "
                    "therefore use the ray-drop of the surfels",
                    run.folder.string(), run.drop_network.image, run.drop_network.smallest_side(),
                    run.drop_network.smallest_side(), sensor.name));
}

void note_unscattered_intensities(const Run& run, int lidar) {
    const auto at = std::size_t(lidar);
    if (at < run.intensity_scatter.size() && !run.intensity_scatter[at].empty()) return;
    note(fmt::format("{} has no intensity noise: sampled intensities are the most likely values",
                     run.folder.string()));
}

void note_weather(const Weather& weather) {
    if (weather.clear()) return;
    note(
        fmt::format("weather {}: the sensors' wavelength is unknown and assumed to be 905 nm; an unknown "
                    "beam divergence is assumed to be 3 mrad",
                    to_text(weather)));
}

namespace {

/// Prints which sides of actors appear in the scans although the log has never observed
/// them. Also prints for each side how many scans and rays are affected.
/// @param key list of sides in an entry of scans.json
/// @param effect text that says what such rays do
void note_sides(const std::vector<nlohmann::json>& scans, const std::string& folder, const char* key,
                const char* effect) {
    struct Sum {
        std::size_t scans = 0, rays = 0;
    };
    std::map<std::string, Sum> sums;
    for (const nlohmann::json& scan : scans)
        for (const nlohmann::json& side : scan[key]) {
            Sum& sum = sums[fmt::format("the {} of {}", side["side"].get<std::string>(),
                                        side["track"].get<std::string>())];
            ++sum.scans, sum.rays += side["rays"].get<std::size_t>();
        }
    std::vector<std::string> texts;
    for (const auto& [name, sum] : sums)
        texts.push_back(fmt::format("{} in {} scans ({} rays)", name, sum.scans, sum.rays));
    if (texts.empty()) return;
    note(fmt::format("{}: rays meet sides of actors that the log has not seen, and {}: {} (scans.json: {})",
                     folder, effect, fmt::join(texts, ", "), key));
}

}  // namespace

void note_unseen_regions(const std::vector<std::string>& entries, const std::string& folder) {
    std::vector<nlohmann::json> scans;
    for (const std::string& entry : entries) scans.push_back(nlohmann::json::parse(entry));
    note_sides(scans, folder, "unseen_sides", "pass through them");
    note_sides(scans, folder, "completed_sides", "return from mirrored surfaces");
    std::size_t n_unseen = 0, n_known = 0;
    double worst = 0.0;
    int worst_number = 0;
    for (const nlohmann::json& scan : scans) {
        if (!scan["unseen"].is_number()) continue;
        ++n_known;
        const double unseen = scan["unseen"];
        n_unseen += unseen > kMuchUnseen;
        if (unseen > worst) worst = unseen, worst_number = scan["frame_number"];
    }
    if (n_unseen == 0) return;
    note(
        fmt::format("{}: in {} of {} scans, more than {:.0f} % of the rays cross space that the log has not "
                    "observed (scan {} has the most, {:.1f} %); surfaces there are extrapolated; see "
                    "\"unseen\" in scans.json, or use --channels seen for a value per ray",
                    folder, n_unseen, n_known, 100.0 * kMuchUnseen, worst_number, 100.0 * worst));
}

}  // namespace relidar::cli
