// SPDX-License-Identifier: Apache-2.0
// Reads scans from EXR range images that `relidar render --format exr` has written. The
// channels of an image have the same names as the arrays of an npz scan.
#include <relidar/base/arrays.hpp>
#include <relidar/base/images.hpp>
#include <relidar/log/sensor_files.hpp>

#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "read/files/scan_npz.hpp"

namespace relidar::read {
namespace {

constexpr const char* kAxisSuffixes[] = {".x", ".y", ".z"};
constexpr std::size_t kListedChannels = 8;  // in an error message

/// Combines the channels x, y and z of an image into one array of vectors. Does nothing
/// if all three are missing. Throws an error if only some are missing.
void append_vectors(const ExrImage& image, const std::string& channel_prefix, const std::string& array_name,
                    const std::string& where, std::vector<NamedArray>& arrays) {
    const std::vector<float>* axis[3] = {};
    std::size_t n_axes_found = 0;
    for (std::size_t k = 0; k < 3; ++k) {
        const auto axis_channel = image.channels.find(channel_prefix + kAxisSuffixes[k]);
        if (axis_channel == image.channels.end()) continue;
        axis[k] = &axis_channel->second;
        ++n_axes_found;
    }
    if (n_axes_found == 0) return;
    if (n_axes_found < 3)
        fail("{}: found only {} of the channels {}.x, .y and .z, expected all three or none", where,
             n_axes_found, channel_prefix);
    std::vector<float> values;
    values.reserve(axis[0]->size() * 3);
    for (std::size_t i = 0; i < axis[0]->size(); ++i)
        for (const std::vector<float>* channel : axis) values.push_back((*channel)[i]);
    arrays.push_back(make_array(array_name, {std::size_t(image.rows), std::size_t(image.columns), 3},
                                values.data(), values.size()));
}

/// Converts the channels of an image to the arrays of an npz scan.
/// @throws DataError if the image has no ranges
std::vector<NamedArray> convert_channels(const ExrImage& image, const std::string& where) {
    if (!image.channels.contains("range")) {
        std::vector<std::string> names;
        for (const auto& [name, values] : image.channels)
            if (names.size() < kListedChannels) names.push_back(quote(name));
        fail("{}: the channel 'range' is missing, expected it among the channels of the image: {}", where,
             fmt::join(names, ", "));
    }
    std::vector<NamedArray> arrays;
    for (const auto& [name, values] : image.channels)
        if (name.find('.') == std::string::npos)
            arrays.push_back(make_array(name, {std::size_t(image.rows), std::size_t(image.columns)},
                                        values.data(), values.size()));
    append_vectors(image, "direction", "directions", where, arrays);
    append_vectors(image, "origin", "origin", where, arrays);
    // name of the frame that the points are in; relidar writes it into the metadata of
    // rendered images
    const auto frame = image.notes.find("points_in");
    const bool is_moved = frame != image.notes.end() && (frame->second.starts_with("world") ||
                                                         frame->second.starts_with("sensor at time_s"));
    const std::int32_t deskewed = is_moved ? 1 : 0;
    arrays.push_back(make_array("deskewed", {}, &deskewed, 1));
    return arrays;
}

/// If the beams of a LiDAR are unknown, sets them from the sensor name in the image.
/// Accepts only built-in sensors. Otherwise an image could make relidar read any file.
Lidar fill_sensor(Lidar lidar, const ExrImage& image) {
    const auto note = image.notes.find("sensor");
    if (note == image.notes.end() || !lidar.sensor.beams.empty() || lidar.pattern) return lidar;
    if (!find_built_in(note->second.substr(0, note->second.rfind(':')))) return lidar;
    const SensorModel model = find_sensor(note->second);
    if (const auto* spinning = std::get_if<SpinningSensor>(&model.pattern)) lidar.sensor = *spinning;
    else lidar.pattern = other_pattern(model);
    return lidar;
}

}  // namespace

Scan read_scan_exr(const std::filesystem::path& file, const ImageContext& image_context) {
    const ExrImage image = read_exr(file);
    const std::string where = file.string();
    std::vector<NamedArray> arrays = convert_channels(image, where);
    // Without directions in the image, the sensor model defines the rays.
    if (find_array(arrays, "directions")) return scan_from_arrays(where, std::move(arrays), image_context);
    const Lidar lidar = fill_sensor(image_context.lidar, image);
    return scan_from_arrays(where, std::move(arrays),
                            {.units = image_context.units,
                             .motion_compensated = image_context.motion_compensated,
                             .lowest_first = image_context.lowest_first,
                             .lidar = lidar,
                             .time_s = image_context.time_s});
}

}  // namespace relidar::read
