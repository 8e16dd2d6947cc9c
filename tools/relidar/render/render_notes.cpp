// SPDX-License-Identifier: Apache-2.0
#include "render/render_notes.hpp"

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/log/log_time.hpp>
#include "base/fail.hpp"
#include "console.hpp"

namespace relidar::cli {

void note_sensor(const Run& run, const ScanRenderer& renderer, const SimulatedSensor& sensor) {
    if (sensor.camera) return;
    if (run.config.sensor.rolling_shutter == RollingShutter::automatic && !is_rolling(sensor, run.config))
        print_note(fmt::format(
            "scans of {} are motion-compensated like the log, without --set sensor.rolling_shutter=true",
            sensor.name));
    const bool wants_network = run.config.refine.enabled && !run.drop_network.empty();
    if (wants_network && !renderer.has_network_for(sensor))
        print_note(fmt::format(
            "the ray-drop network of {} needs {} images of at least {} x {} pixels; scans of {} do without",
            run.folder.string(), run.drop_network.image, run.drop_network.min_image_size(),
            run.drop_network.min_image_size(), sensor.name));
}

void note_missing_noise(const Run& run, int lidar) {
    const auto index = std::size_t(lidar);
    if (run.log.lidars[index].range_noise.sigma_m.empty())
        print_warning(
            fmt::format("run {} has no model of the range noise, so --sample adds no noise to ranges",
                        run.folder.string()));
    // A run without learned noise has an empty list.
    const bool has_intensity_noise =
        index < run.intensity_scatter.size() && !run.intensity_scatter[index].empty();
    if (!has_intensity_noise)
        print_warning(fmt::format(
            "run {} has no model of the intensity noise, so --sample adds no noise to intensities",
            run.folder.string()));
}

void note_time_shift(const Log& log, std::int64_t time_shift_ns) {
    if (const std::string note = time_shift_note(log, time_shift_ns); !note.empty()) print_note(note);
}

std::optional<MapProjector> open_map(const Log& log, const std::string& crs) {
    if (crs.empty()) return {};
    if (!log.georeference)
        fail<UsageError>(
            "--crs {}: the run has no georeference; set it with `relidar edit RUN --georeference FILE --out "
            "RUN2`",
            crs);
    MapProjector map(*log.georeference, crs);
    if (const std::string note = map.map().scale_note(); !note.empty()) print_note(note);
    return map;
}

void note_local_las(const Log& log, const std::vector<std::string>& formats) {
    if (std::ranges::count(formats, "las") == 0) return;
    if (!log.georeference || !has_proj() || !GeoConverter(*log.georeference).wkt().empty()) return;
    const GeodeticPosition& position = log.georeference->position;
    const int zone = 1 + int(std::floor((position.longitude_deg + 540.0) / 6.0)) % 60;
    print_note(fmt::format(
        "las: the points are in the dataset's world, whose axes are not those of a map, so the file "
        "names no coordinate system; use --crs EPSG:{} for UTM",
        (position.latitude_deg < 0.0 ? 32700 : 32600) + zone));
}

void note_weather(const Weather& weather) {
    if (weather.is_clear()) return;
    print_note(fmt::format("weather {}: assumes a wavelength of 905 nm, and 3 mrad for unknown divergences",
                           format_weather(weather)));
}

namespace {

/// Prints one note that lists sides of actors which the log did not observe, with the
/// number of scans and rays that meet each side.
/// @param sides_json_key list of sides in scans.json
/// @param effect_text what the rays to such a side do
void note_unseen_sides(const std::vector<nlohmann::json>& scans, const std::string& folder,
                       const char* sides_json_key, const char* effect_text) {
    struct ScanRayCounts {
        std::size_t scans = 0, rays = 0;
    };
    std::map<std::string, ScanRayCounts> sums;
    for (const nlohmann::json& scan : scans)
        for (const nlohmann::json& side : scan[sides_json_key]) {
            ScanRayCounts& sum = sums[fmt::format("the {} of {}", side["side"].get<std::string>(),
                                                  side["track"].get<std::string>())];
            ++sum.scans;
            sum.rays += side["rays"].get<std::size_t>();
        }
    std::vector<std::string> texts;
    for (const auto& [name, sum] : sums)
        texts.push_back(fmt::format("{} in {} scans ({} rays)", name, sum.scans, sum.rays));
    if (texts.empty()) return;
    print_note(
        fmt::format("{}: rays to sides of actors that the log did not observe {}: {} (\"{}\" in scans.json)",
                    folder, effect_text, fmt::join(texts, ", "), sides_json_key));
}

/// Prints in how many scans many rays cross space that the log has not observed, and the
/// worst of these scans.
void note_unseen_space(const std::vector<nlohmann::json>& scans, const std::string& scan_folder) {
    std::size_t n_much_unseen = 0, n_scans_with_value = 0;
    double worst_share = 0.0;
    int worst_number = 0;
    for (const nlohmann::json& scan : scans) {
        // Null if the run does not store the observed space.
        if (!scan["unseen"].is_number()) continue;
        ++n_scans_with_value;
        const double unseen_share = scan["unseen"];
        if (unseen_share > kMuchUnseen) ++n_much_unseen;
        if (unseen_share > worst_share) {
            worst_share = unseen_share;
            worst_number = scan["frame_number"];
        }
    }
    if (n_much_unseen == 0) return;
    print_note(fmt::format(
        "{}: in {} of {} scans, more than {:.0f} % of the rays cross space that the log has not observed, "
        "most in scan {} with {:.1f} % (\"unseen\" in scans.json, --channels seen)",
        scan_folder, n_much_unseen, n_scans_with_value, 100.0 * kMuchUnseen, worst_number,
        100.0 * worst_share));
}

}  // namespace

void note_unobserved(const std::vector<std::string>& scan_json_entries, const std::string& scan_folder) {
    std::vector<nlohmann::json> scans;
    for (const std::string& entry : scan_json_entries) scans.push_back(nlohmann::json::parse(entry));
    note_unseen_sides(scans, scan_folder, "unseen_sides",
                      "pass through such a side, because it has no surfels");
    note_unseen_sides(scans, scan_folder, "completed_sides",
                      "hit surfels that were mirrored from the other side of the actor");
    note_unseen_space(scans, scan_folder);
}

std::string render_output_help() {
    return std::string(
               R"(Files are named DIR/frame_000123.npz and so on, by the dataset's frame number; with --trajectory
they are counted from 0. DIR/scans.json holds run, sensor, offset, poses, times and settings, and
`unseen`: the share of rays that mainly cross space that the log did not observe.
`unseen_sides`: sides of actors that the log did not observe, so that rays pass through them.
`completed_sides`: sides of actors that are mirror images of the other side.
`boxes` (with --boxes): the box of each actor and of each labelled object in the background
(is_static), at the time at which the sensor faces it, in the dataset's world; the number of first
returns from it; and its visible share, which is the share of its rays that no other object blocks.
`note` is "covered" if an actor overlaps a standing object, and "not_observed" if rays pass through.
)") + make_scan_format_help() +
           R"(ring: beam, 0 is the highest. time: firing time of the ray, seconds from time_s.
instance (npz, exr, ply, pcd): surface at the median range, the number in `relidar info RUN`;
0 background, -1 nothing, -2 the own vehicle.
)";
}

std::string render_channels_help() {
    std::string text =
        "Channels of --channels, one value per ray in npz and exr, one per point in ply, pcd, mcap and "
        "rosbag:\n";
    for (const ChannelInfo& channel : optional_channels())
        text += fmt::format("  {:<17} {}{}\n", channel.name, channel.meaning,
                            channel.unit.empty() ? "" : " [" + channel.unit + "]");
    return text;
}

}  // namespace relidar::cli
