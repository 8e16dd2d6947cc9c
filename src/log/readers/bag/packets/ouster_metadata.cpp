// SPDX-License-Identifier: Apache-2.0
// Parses the metadata of Ouster sensors. The packet layouts are documented in Ouster's
// firmware user manual, "Lidar Data" and "Lidar Data Legacy". Old metadata is one flat
// JSON object. New metadata consists of nested objects. The keys are the same in both.
#include <algorithm>
#include <cmath>
#include <iterator>
#include <numeric>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>

#include "base/files.hpp"
#include "base/json_field.hpp"
#include "log/readers/bag/packets/ouster.hpp"
#include "log/readers/bag/unpacked_file.hpp"

namespace relidar::packets {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr OusterProfile kProfiles[] = {
    {"LEGACY", true, 12, 0xFFFFF, 1e-3, 4, true, 1},
    {"RNG19_RFL8_SIG16_NIR16", false, 12, 0x7FFFF, 1e-3, 4, false, 1},
    {"RNG19_RFL8_SIG16_NIR16_DUAL", false, 16, 0x7FFFF, 1e-3, 3, false, 2},
    {"RNG15_RFL8_NIR8", false, 4, 0x7FFF, 8e-3, 2, false, 1},
    {"RNG15_RFL8_NIR8_DUAL", false, 8, 0x7FFF, 8e-3, 2, false, 2},
    // Older name of the profile RNG15_RFL8_NIR8_DUAL. Newer firmware sets header_type to
    // FUSA instead. The header has the same size.
    {"FUSA_RNG15_RFL8_NIR8_DUAL", false, 8, 0x7FFF, 8e-3, 2, false, 2},
};
constexpr int kUsualColumns = 16;  // columns per packet
constexpr std::size_t kMostMetadata = std::size_t(1) << 20, kMostFiles = 256, kMostDatagram = 65507,
                      kMostTold = 3;
constexpr double kMostSerial = 1099511627776.0;  // serial numbers have 40 bits
// Byte offsets of the serial number in the packet header, for old and new firmware.
constexpr std::size_t kSerialBytes = 5, kSerialAt[] = {7, 11};

std::size_t compute_packet_bytes(const OusterProfile& profile, int pixels, int columns) {
    const std::size_t column = std::size_t(pixels) * profile.pixel_bytes;
    return profile.is_legacy ? std::size_t(columns) * (16 + column + 4)
                             : 32 + std::size_t(columns) * (12 + column) + 32;
}

/// Returns the JSON object that contains a key: the root or one of its direct members.
JsonField find_part_with_key(const Json& json, const std::string& location, const std::string& key) {
    const JsonField root(json, location, "");
    for (const char* part : {"data_format", "lidar_data_format", "config_params", "sensor_info"})
        if (!root.has(key) && root.has(part) && root.at(part).has(key)) return root.at(part);
    return root;
}
int parse_integer(const Json& json, const std::string& location, const std::string& key, int default_value,
                  int max_value) {
    const JsonField part = find_part_with_key(json, location, key);
    return part.has(key) ? int(part.at(key).integer(0, max_value)) : default_value;
}
std::string read_short_text(const Json& json, const std::string& location, const std::string& key,
                            const std::string& default_value) {
    const JsonField part = find_part_with_key(json, location, key);
    return part.has(key) && part.at(key).is_text() ? part.at(key).text(80) : default_value;
}

const OusterProfile& find_profile(const Json& json, const std::string& location) {
    const std::string name = read_short_text(json, location, "udp_profile_lidar", "LEGACY");
    const auto* known =
        std::ranges::find_if(kProfiles, [&](const OusterProfile& row) { return name == row.name; });
    if (known != std::end(kProfiles)) return *known;
    std::string names;
    for (const OusterProfile& row : kProfiles) names += (names.empty() ? "" : ", ") + std::string(row.name);
    throw DataError(
        fmt::format("{}: the packet profile is {}, expected one of {}", location, make_excerpt(name), names));
}

/// Returns the ring of each pixel in a column of a packet. Pixels are in the order of the
/// beams in the metadata; rings are sorted by elevation.
std::vector<std::size_t> read_rings(const Json& json, const std::string& location) {
    const JsonField root(json, location, "");
    const std::vector<double> altitude_deg =
        (root.has("beam_altitude_angles") ? root : root.at("beam_intrinsics"))
            .at("beam_altitude_angles")
            .numbers();
    std::vector<std::size_t> order(altitude_deg.size()), ring_of(altitude_deg.size());
    std::iota(order.begin(), order.end(), std::size_t(0));
    std::ranges::stable_sort(order, std::greater(), [&](std::size_t row) { return altitude_deg[row]; });
    for (std::size_t ring = 0; ring < order.size(); ++ring) ring_of[order[ring]] = ring;
    return ring_of;
}

/// Returns for each column whether it is in the azimuth window in which the sensor fires.
/// The window can cross the end of the image and continue at column 0.
std::vector<bool> list_columns_in_window(const Json& json, const std::string& location, int columns) {
    const JsonField part = find_part_with_key(json, location, "column_window");
    if (!part.has("column_window")) return std::vector<bool>(std::size_t(columns), true);
    const JsonField window = part.at("column_window");
    if (window.size() != 2)
        window.fail(fmt::format("found {} numbers", window.size()), "expected the first and the last column");
    const auto first = window.at(std::size_t(0)).integer(0, columns - 1),
               last = window.at(std::size_t(1)).integer(0, columns - 1);
    std::vector<bool> fires(std::size_t(columns), false);
    for (std::int64_t c = first;; c = (c + 1) % columns) {
        fires[std::size_t(c)] = true;
        if (c == last) return fires;
    }
}

/// Checks that values which the metadata contains twice are equal. Also computes the
/// packet size and checks it.
void check_sizes(OusterFormat& format, const Json& json) {
    const int columns = format.sensor.columns, beams = int(format.sensor.beams.size());
    if (const int n = parse_integer(json, format.where, "columns_per_frame", columns, 65536); n != columns)
        throw DataError(fmt::format("{}: columns_per_frame is {}, expected {} like in lidar_mode",
                                    format.where, n, columns));
    if (const int n = parse_integer(json, format.where, "pixels_per_column", beams, 65536); n != beams)
        throw DataError(
            fmt::format("{}: pixels_per_column is {}, expected {}, the number of beam_altitude_angles",
                        format.where, n, beams));
    if (format.columns_per_packet < 1 || columns % format.columns_per_packet != 0)
        throw DataError(
            fmt::format("{}: columns_per_packet is {}, expected a divisor of the {} columns of a turn",
                        format.where, format.columns_per_packet, columns));
    format.packet_bytes = compute_packet_bytes(*format.profile, beams, format.columns_per_packet);
    if (format.packet_bytes > kMostDatagram)
        throw DataError(fmt::format("{}: found {}, expected at most {} bytes, the largest UDP packet",
                                    format.where, format.about(), kMostDatagram));
}

/// Returns the UDP port in the topic name of a network capture, for example 7502 in
/// "192.168.1.201:7502". Returns 0 for a topic of a bag.
int parse_port(std::string_view topic) {
    const std::size_t colon = topic.rfind(':');
    const auto port = colon == std::string_view::npos || topic.starts_with('/')
                          ? std::nullopt
                          : parse_number(topic.substr(colon + 1));
    return port && *port >= 0.0 && *port <= 65535.0 ? int(*port) : 0;
}
std::string_view get_topic_namespace(std::string_view topic) {
    return topic.starts_with('/') ? topic.substr(0, topic.rfind('/')) : std::string_view();
}

bool has_serial_number(std::string_view packet, const OusterFormat& format) {
    if (format.serial == 0 || format.profile->is_legacy) return false;
    return std::ranges::any_of(kSerialAt, [&](std::size_t at) {
        std::uint64_t serial = 0;
        for (std::size_t k = kSerialBytes; k-- > 0;)
            serial = serial << 8 | static_cast<unsigned char>(packet[at + k]);
        return serial == format.serial;
    });
}

bool is_recording(const fs::path& file) {
    const std::string ending = bag::get_unpacked_name(file).extension().string();
    return ending == ".pcap" || ending == ".pcapng" || ending == ".bag" || ending == ".mcap" ||
           ending == ".db3";
}

bool is_metadata_file(const fs::path& file) {
    std::error_code failed;
    const auto size = fs::file_size(file, failed);
    return !failed && size <= kMostMetadata && file.extension() == ".json" &&
           is_ouster_metadata(read_text(file));
}

/// Returns the files in a folder, sorted by name, or an empty list if the folder cannot
/// be read.
std::vector<fs::path> list_files_of_folder(const fs::path& folder) {
    std::vector<fs::path> files;
    std::error_code failed;
    for (fs::directory_iterator at(folder, failed), end; !failed && at != end; at.increment(failed))
        files.push_back(at->path());
    std::ranges::sort(files);
    return files;
}

}  // namespace

std::string OusterFormat::about() const {
    return fmt::format("packets of {} bytes ({}, {} beams, {} columns per packet{})", packet_bytes,
                       profile->name, sensor.beams.size(), columns_per_packet,
                       port > 0 ? fmt::format(", port {}", port) : "");
}

bool is_ouster_metadata(std::string_view text) {
    return std::ranges::any_of(
        std::initializer_list<const char*>{"\"beam_altitude_angles\"", "\"lidar_mode\"", "\"prod_line\""},
        [&](const char* key) { return text.find(key) != std::string_view::npos; });
}

std::shared_ptr<const OusterFormat> read_ouster_metadata(const std::string& text,
                                                         const std::string& location) {
    const Json json = parse_json(text, location);
    auto format = std::make_shared<OusterFormat>();
    format->text = text;
    format->where = location;
    format->product = read_short_text(json, location, "prod_line", "Ouster");
    const SensorModel model = parse_sensor_json_text(text, format->product, location);
    const auto* spinning = std::get_if<SpinningSensor>(&model.pattern);
    if (!spinning)
        throw DataError(
            fmt::format("{}: the sensor does not spin, expected the metadata of an Ouster", location));
    format->sensor = *spinning;
    format->profile = &find_profile(json, location);
    format->columns_per_packet = parse_integer(json, location, "columns_per_packet", kUsualColumns, 65536);
    check_sizes(*format, json);
    format->port = parse_integer(json, location, "udp_port_lidar", 0, 65535);
    const double serial = parse_number(read_short_text(json, location, "prod_sn", "")).value_or(0.0);
    format->serial = serial > 0.0 && serial < kMostSerial ? std::uint64_t(serial) : 0;
    format->fires = list_columns_in_window(json, location, spinning->columns);
    format->ring_of = read_rings(json, location);
    return format;
}

OusterFormats find_ouster_metadata(const fs::path& recording, std::vector<std::string>& broken) {
    const std::string own = recording.stem().string();
    const bool has_own = is_metadata_file(fs::path(recording).replace_extension(".json"));
    const std::vector<fs::path> files =
        list_files_of_folder(recording.has_parent_path() ? recording.parent_path() : ".");
    std::set<std::string> recorded;
    for (const fs::path& file : files)
        if (is_recording(file)) recorded.insert(bag::get_unpacked_name(file).stem().string());
    OusterFormats formats;
    for (const fs::path& file : files) {
        const std::string stem = file.stem().string();
        if (stem != own && (recorded.contains(stem) || (has_own && !stem.starts_with(own)))) continue;
        if (formats.size() >= kMostFiles || !is_metadata_file(file)) continue;
        try {
            const fs::path shown = recording.has_parent_path() ? file : file.filename();
            formats.push_back(read_ouster_metadata(read_text(file), shown.string()));
        } catch (const DataError& error) {
            broken.emplace_back(error.what());
        }
    }
    return formats;
}

std::shared_ptr<const OusterFormat> match_ouster_format(const OusterFormats& formats, std::string_view topic,
                                                        std::string_view packet) {
    OusterFormats left;
    const int port = parse_port(topic);
    // Packets in the LEGACY layout have no serial number. If there is only one sensor's
    // metadata, its port may differ, because users can change the port after saving the
    // metadata.
    const bool is_alone = std::ranges::all_of(
        formats, [&](const auto& format) { return format->text == formats.front()->text; });
    for (const auto& format : formats) {
        const bool is_told =
            std::ranges::any_of(left, [&](const auto& other) { return other->text == format->text; });
        const bool is_of_other_port = port > 0 && format->port > 0 && port != format->port;
        if (format->packet_bytes != packet.size() || is_told ||
            (is_of_other_port && !has_serial_number(packet, *format) &&
             !(is_alone && format->profile->is_legacy)))
            continue;
        left.push_back(format);
    }
    const auto narrow = [&](auto is_its) {
        if (left.size() > 1 && std::ranges::any_of(left, is_its))
            std::erase_if(left, [&](const auto& format) { return !is_its(format); });
    };
    narrow([&](const auto& format) {
        return !get_topic_namespace(topic).empty() &&
               get_topic_namespace(format->where) == get_topic_namespace(topic);
    });
    narrow([&](const auto& format) { return format->port > 0 && format->port == port; });
    narrow([&](const auto& format) { return has_serial_number(packet, *format); });
    return left.size() == 1 ? left.front() : nullptr;
}

bool is_ouster_packet_size(std::size_t bytes) {
    for (const OusterProfile& profile : kProfiles)
        for (const int pixels : {16, 32, 64, 128, 256})
            if (bytes == compute_packet_bytes(profile, pixels, kUsualColumns)) return true;
    return false;
}

std::string describe_ouster_packet(const OusterFormats& formats, const fs::path& recording,
                                   std::string_view topic, std::size_t bytes) {
    const int port = parse_port(topic);
    const std::string from =
        port > 0 ? fmt::format(" on port {}", port) : fmt::format(" of {}", make_excerpt(topic));
    if (formats.empty())
        return fmt::format(
            "found packets of {} bytes{}, probably from an Ouster; expected the metadata of the sensor "
            "{}{} (from `ouster-cli source SENSOR metadata`, or from http://SENSOR/api/v1/sensor/metadata)",
            bytes, from, port > 0 ? "in the file " : "on a topic .../metadata, or in the file ",
            fs::path(recording).replace_extension(".json").filename().string());
    std::string told;
    for (std::size_t k = 0; k < std::min(formats.size(), kMostTold); ++k)
        told += fmt::format("{}{} of {}", k == 0 ? "" : ", or ", formats[k]->about(), formats[k]->where);
    if (formats.size() > kMostTold) told += fmt::format(", or of {} other files", formats.size() - kMostTold);
    if (std::ranges::any_of(formats, [&](const auto& format) { return format->packet_bytes == bytes; }))
        return fmt::format(
            "found packets of {} bytes{}, expected exactly one metadata file that belongs to them ({}), "
            "but found {}",
            bytes, from, port > 0 ? "udp_port_lidar" : "a topic in the same name space", told);
    return fmt::format(
        "found packets of {} bytes{}, but the metadata describes {}; use the metadata of the same sensor "
        "and configuration",
        bytes, from, told);
}

}  // namespace relidar::packets
