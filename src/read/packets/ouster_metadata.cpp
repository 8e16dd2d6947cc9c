// SPDX-License-Identifier: Apache-2.0
// Parses the metadata of Ouster sensors and decodes their packets (firmware user manual,
// "Lidar Data" and "Lidar Data Legacy"). Old metadata is one flat JSON object. New
// metadata consists of nested objects with the same keys.
#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <numeric>
#include <set>

#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <relidar/log/sensor_files.hpp>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "read/files/recording.hpp"
#include "read/packets/decoder.hpp"
#include "read/packets/ouster.hpp"

namespace relidar::packets {
namespace {

namespace fs = std::filesystem;

// name, is legacy, bytes of a pixel, mask and unit (m) of the range, byte offset of the
// reflectivity and whether it has 2 bytes, number of returns
constexpr OusterProfile kOusterProfiles[] = {
    {"LEGACY", true, 12, 0xFFFFF, 1e-3, 4, true, 1},
    {"RNG19_RFL8_SIG16_NIR16", false, 12, 0x7FFFF, 1e-3, 4, false, 1},
    {"RNG19_RFL8_SIG16_NIR16_DUAL", false, 16, 0x7FFFF, 1e-3, 3, false, 2},
    {"RNG15_RFL8_NIR8", false, 4, 0x7FFF, 8e-3, 2, false, 1},
    {"RNG15_RFL8_NIR8_DUAL", false, 8, 0x7FFF, 8e-3, 2, false, 2},
    // Same layout as RNG15_RFL8_NIR8_DUAL, under its name in older firmware.
    {"FUSA_RNG15_RFL8_NIR8_DUAL", false, 8, 0x7FFF, 8e-3, 2, false, 2},
};
constexpr int kUsualColumns = 16;  // columns per packet
constexpr std::size_t kMostMetadata = std::size_t(1) << 20, kMostFiles = 256, kMostDatagram = 65507,
                      kMaxListedFormats = 3;
constexpr double kMostSerial = 1099511627776.0;  // serial numbers have 40 bits
// Byte offsets of the serial number in the packet header, for old and new firmware.
constexpr std::size_t kSerialBytes = 5, kSerialAt[] = {7, 11};

/// Returns the size of a packet in bytes. Legacy columns have 16 bytes before and 4 bytes
/// after the pixels. Other packets have a header and a footer of 32 bytes, and 12 bytes
/// before the pixels of each column.
std::size_t count_bytes(const OusterProfile& profile, int pixels_per_column, int columns_per_packet) {
    const std::size_t pixels = std::size_t(pixels_per_column) * profile.pixel_bytes;
    const auto n_columns = std::size_t(columns_per_packet);
    return profile.is_legacy ? n_columns * (16 + pixels + 4) : 32 + n_columns * (12 + pixels) + 32;
}

/// Returns the value of a key in the root object or in one of its direct members.
std::optional<JsonField> find_value(const JsonField& root, const std::string& key) {
    return root.find(key,
                     {"data_format", "lidar_data_format", "config_params", "sensor_info", "beam_intrinsics"});
}
int read_integer(const JsonField& root, const std::string& key, int fallback, int max) {
    const auto value = find_value(root, key);
    return value ? int(value->integer_in(0, max)) : fallback;
}
std::string read_text(const JsonField& root, const std::string& key, const std::string& default_value) {
    const auto value = find_value(root, key);
    return value && value->is_string() ? value->short_text(80) : default_value;
}

/// Returns the packet profile in the metadata, or LEGACY if old metadata name none.
const OusterProfile& find_profile(const JsonField& root) {
    const std::string name = read_text(root, "udp_profile_lidar", "LEGACY");
    const auto* matching_profile = std::ranges::find(kOusterProfiles, name, &OusterProfile::name);
    if (matching_profile != std::end(kOusterProfiles)) return *matching_profile;
    std::vector<std::string> names;
    for (const OusterProfile& row : kOusterProfiles) names.emplace_back(row.name);
    fail("{}: the packet profile is {}, expected one of {}", root.location(), quote(name),
         fmt::join(names, ", "));
}

/// Returns the ring of each pixel in a column: the rank of its beam, highest first.
std::vector<std::size_t> rank_pixels(const JsonField& root) {
    const std::vector<double> altitude_deg =
        find_value(root, "beam_altitude_angles").value_or(root).numbers();
    std::vector<std::size_t> order(altitude_deg.size()), ring_of(altitude_deg.size());
    std::iota(order.begin(), order.end(), std::size_t(0));
    std::ranges::stable_sort(order, std::greater(), [&](std::size_t row) { return altitude_deg[row]; });
    for (std::size_t ring = 0; ring < order.size(); ++ring) ring_of[order[ring]] = ring;
    return ring_of;
}

/// Returns whether the sensor fires at each column. The window can pass column 0.
std::vector<bool> mark_columns(const JsonField& root, int n_columns) {
    const auto window = find_value(root, "column_window");
    std::vector<bool> fires(std::size_t(n_columns), !window);
    if (!window) return fires;
    if (window->size() != 2)
        window->reject(fmt::format("found {} values", window->size()),
                       "expected two values, the first and the last column of the window");
    const auto first = window->at(std::size_t(0)).integer_in(0, n_columns - 1),
               last = window->at(std::size_t(1)).integer_in(0, n_columns - 1);
    for (std::int64_t c = first;; c = (c + 1) % n_columns) {
        fires[std::size_t(c)] = true;
        if (c == last) return fires;
    }
}

/// Checks that values which the metadata contain twice are equal. Checks packet sizes.
void check_sizes(const OusterMetadata& metadata, const JsonField& root) {
    const int columns = metadata.sensor.columns;
    const auto check_equal = [&](const char* key, int expected) {
        const int n = read_integer(root, key, expected, 65536);
        if (n != expected)
            fail("{}: {} is {}, expected {} like in lidar_mode and beam_altitude_angles", metadata.where, key,
                 n, expected);
    };
    check_equal("columns_per_frame", columns);
    check_equal("pixels_per_column", int(metadata.sensor.beams.size()));
    if (metadata.columns_per_packet < 1 || columns % metadata.columns_per_packet != 0)
        fail("{}: columns_per_packet is {}, expected a divisor of the {} columns of a revolution",
             metadata.where, metadata.columns_per_packet, columns);
    if (metadata.packet_bytes > kMostDatagram)
        fail("{}: found {}, expected packets of at most {} bytes, the maximum size of a UDP packet",
             metadata.where, metadata.describe(), kMostDatagram);
}

/// Returns 7502 for the topic "192.168.1.201:7502" of a capture, 0 for one of a bag.
int parse_port(std::string_view topic) {
    const std::size_t colon = topic.rfind(':');
    if (colon == std::string_view::npos || topic.starts_with('/')) return 0;
    const std::optional<double> port = parse_number(topic.substr(colon + 1));
    return port && *port >= 0.0 && *port <= 65535.0 ? int(*port) : 0;
}
/// Returns "/os1" for the topic "/os1/lidar_packets" of a bag.
std::string_view find_namespace(std::string_view topic) {
    return topic.starts_with('/') ? topic.substr(0, topic.rfind('/')) : std::string_view();
}

/// Returns true if a packet has the serial number of the sensor. Legacy ones have none.
bool has_serial(std::string_view packet, const OusterMetadata& metadata) {
    if (metadata.serial == 0 || metadata.profile->is_legacy) return false;
    return std::ranges::any_of(kSerialAt, [&](std::size_t at) {
        std::uint64_t serial = 0;  // stored with the lowest byte first
        for (std::size_t k = kSerialBytes; k-- > 0;)
            serial = serial << 8 | static_cast<unsigned char>(packet[at + k]);
        return serial == metadata.serial;
    });
}

bool is_metadata_file(const fs::path& file) {
    std::error_code failed;
    const auto size = fs::file_size(file, failed);
    return !failed && size <= kMostMetadata && file.extension() == ".json" &&
           is_metadata(read_text_file(file));
}

// A packet has columns. All beams of a column fire simultaneously, at fixed azimuths:
//   LEGACY: a column is [timestamp u64 ns, number u16, frame u16, encoder u32],
//     12 bytes per pixel, status u32 (all bits set: it was measured).
//   Others: a header and a footer of 32 bytes. A column is [timestamp u64 ns, number u16,
//     status u8 (bit 0: it was measured), 1 byte], then its pixels.
// Ranges start at the spin axis. The decoder subtracts lidar_origin_to_beam_origin_mm, so
// that ranges start at the beam's origin.
constexpr std::size_t kHeadBytes = 32;
constexpr std::uint8_t kLidarData = 1;
constexpr std::uint64_t kLatestClock_ns = std::uint64_t(1) << 62;

struct ColumnHeader {
    std::int64_t time_ns = 0;
    int number = 0;
    bool was_measured = false;
};

/// Decodes the packets of the sensor that sent the metadata.
class OusterDecoder : public PacketDecoder {
public:
    explicit OusterDecoder(std::shared_ptr<const OusterMetadata> format) : format_(std::move(format)) {
        const SpinningSensor& sensor = format_->sensor;
        timing_.cycle_us = 1e6 * sensor.period_s / sensor.columns;
        timing_.offset_us.assign(sensor.beams.size(), 0.0);
        timing_.fires = format_->fires;
        timing_.is_wide = format_->profile->is_wide;
    }

    const FiringTiming& timing() const override { return timing_; }

    std::string describe_product() const override {
        return fmt::format("{}-beam Ouster, {}, profile {}, beam angles from {}",
                           format_->sensor.beams.size(), format_->product, format_->profile->name,
                           format_->where);
    }

    SpinningSensor make_sensor(int, double rotation_rate_hz) const override {
        SpinningSensor sensor = format_->sensor;
        sensor.period_s = 1.0 / rotation_rate_hz;
        return sensor;
    }

    DecodedPacket decode_packet(std::string_view packet_bytes) const override {
        const OusterProfile& profile = *format_->profile;
        const std::size_t rings = format_->ring_of.size();
        codecs::ByteReader reader(packet_bytes);
        if (!profile.is_legacy) {
            const auto type = codecs::ByteReader(reader.read_bytes(kHeadBytes)).read_number<std::uint8_t>();
            if (type != kLidarData)
                fail("found a packet of type {}, expected {} (LiDAR data of an Ouster)", type, kLidarData);
        }
        DecodedPacket packet;
        packet.n_slots = format_->columns_per_packet;
        std::vector<std::int64_t> times_ns;
        for (int slot = 0; slot < packet.n_slots; ++slot) {
            const ColumnHeader column = read_header(reader);
            codecs::ByteReader pixels(reader.read_bytes(rings * profile.pixel_bytes));
            const bool was_measured =
                profile.is_legacy ? reader.read_number<std::uint32_t>() == 0xFFFFFFFF : column.was_measured;
            if (!was_measured) continue;
            packet.firings.push_back({slot, 0.0, column_azimuth_deg(column, packet.firings, slot)});
            times_ns.push_back(column.time_ns);
            // Appends one entry per ring for this column.
            packet.echoes.resize(packet.echoes.size() + rings);
            read_pixels(pixels, &packet.echoes[packet.echoes.size() - rings]);
        }
        // The packet is sent after its last column.
        if (!times_ns.empty()) packet.clock_ns = times_ns.back();
        // The times of firings are stored relative to the clock of the packet.
        for (std::size_t f = 0; f < times_ns.size(); ++f)
            packet.firings[f].after_us = 1e-3 * double(times_ns[f] - packet.clock_ns);
        return packet;
    }

private:
    const std::shared_ptr<const OusterMetadata> format_;
    FiringTiming timing_;

    /// Reads the bytes that precede the pixels of a column.
    ColumnHeader read_header(codecs::ByteReader& reader) const {
        ColumnHeader column;
        const auto time_ns = reader.read_number<std::uint64_t>();
        column.number = reader.read_number<std::uint16_t>();
        if (format_->profile->is_legacy)
            reader.read_bytes(6);  // skips the frame number and the encoder angle
        else column.was_measured = (reader.read_number<std::uint16_t>() & 1) != 0;
        // A limit below the largest integer prevents overflows with damaged times.
        column.time_ns = std::int64_t(std::min(time_ns, kLatestClock_ns));
        return column;
    }

    /// Returns the azimuth of a column in degrees. Throws if it does not follow the
    /// previous column of the packet.
    double column_azimuth_deg(const ColumnHeader& column, const std::vector<LaserFiring>& previous_firings,
                              int slot_in_packet) const {
        const int columns = format_->sensor.columns;
        if (column.number >= columns)
            fail("a packet has column {}, expected a number below {} (lidar_mode in {})", column.number,
                 columns, format_->where);
        const double azimuth_deg = std::fmod(180.0 + 360.0 * column.number / columns, 360.0);
        if (previous_firings.empty()) return azimuth_deg;
        const LaserFiring& previous = previous_firings.back();
        const double step_deg = 360.0 / columns;
        const double error_deg = std::remainder(
            azimuth_deg - previous.azimuth_deg - step_deg * (slot_in_packet - previous.slot), 360.0);
        if (std::abs(error_deg) > 0.1 * step_deg)
            fail("column {} at position {} of a packet does not follow the previous column", column.number,
                 slot_in_packet);
        return azimuth_deg;
    }

    /// Reads the returns of all beams of a column. Ouster measures ranges from the axis
    /// of rotation, so the distance of the beam origin from the axis is subtracted.
    void read_pixels(codecs::ByteReader& reader, std::array<DecodedReturn, 2>* returns_of_each_ring) const {
        const OusterProfile& profile = *format_->profile;
        for (const std::size_t ring : format_->ring_of) {
            const std::string_view pixel = reader.read_bytes(profile.pixel_bytes);
            const double start_m = format_->sensor.beams[ring].origin_offset_m;
            for (int k = 0; k < profile.returns; ++k) {
                const std::string_view bytes = pixel.substr(4 * std::size_t(k));
                const auto range =
                    codecs::ByteReader(bytes).read_number<std::uint32_t>() & profile.range_bits;
                codecs::ByteReader bright(bytes.substr(profile.reflectivity_at));
                const double reflectivity = profile.is_wide ? bright.read_number<std::uint16_t>()
                                                            : bright.read_number<std::uint8_t>();
                const double range_m = profile.range_unit_m * range - start_m;
                if (range > 0 && range_m > 0.0)
                    returns_of_each_ring[ring][std::size_t(k)] = {float(range_m),
                                                                  float(reflectivity / 255.0)};
            }
        }
    }
};

}  // namespace

std::string OusterMetadata::describe() const {
    return fmt::format("packets of {} bytes ({}, {} beams, {} columns per packet{})", packet_bytes,
                       profile->name, sensor.beams.size(), columns_per_packet,
                       port > 0 ? fmt::format(", port {}", port) : "");
}

bool is_metadata(std::string_view json_text) {
    return std::ranges::any_of(
        std::initializer_list<const char*>{"\"beam_altitude_angles\"", "\"lidar_mode\"", "\"prod_line\""},
        [&](const char* key) { return json_text.find(key) != std::string_view::npos; });
}

std::shared_ptr<const OusterMetadata> parse_metadata(const std::string& json_text, const std::string& place) {
    const nlohmann::json json = parse_json(json_text, place);
    const JsonField root(json, place, "");
    auto format = std::make_shared<OusterMetadata>();
    format->text = json_text;
    format->where = place;
    format->product = read_text(root, "prod_line", "Ouster");
    const SensorModel model = parse_sensor(json_text, format->product, place);
    const auto* spinning = std::get_if<SpinningSensor>(&model.pattern);
    if (!spinning) fail("{}: found a sensor that does not spin, expected the metadata of an Ouster", place);
    format->sensor = *spinning;
    format->profile = &find_profile(root);
    format->columns_per_packet = read_integer(root, "columns_per_packet", kUsualColumns, 65536);
    format->packet_bytes =
        count_bytes(*format->profile, int(spinning->beams.size()), format->columns_per_packet);
    check_sizes(*format, root);
    format->port = read_integer(root, "udp_port_lidar", 0, 65535);
    // The serial number is a text of digits. 0 means that it is unknown.
    const double serial = parse_number(read_text(root, "prod_sn", "")).value_or(0.0);
    format->serial = serial > 0.0 && serial < kMostSerial ? std::uint64_t(serial) : 0;
    format->fires = mark_columns(root, spinning->columns);
    format->ring_of = rank_pixels(root);
    return format;
}

MetadataList read_metadata_files(const fs::path& recording, std::vector<std::string>& errors) {
    const fs::path folder = recording.has_parent_path() ? recording.parent_path() : ".";
    std::vector<fs::path> files;  // empty if the folder cannot be read
    std::error_code failed;
    for (fs::directory_iterator at(folder, failed), end; !failed && at != end; at.increment(failed))
        files.push_back(at->path());
    std::ranges::sort(files);
    std::set<std::string> recording_stems;  // of all recordings in the folder
    for (const fs::path& file : files)
        if (is_recording_file(file)) recording_stems.insert(strip_packed(file).stem().string());

    const std::string own_stem = recording.stem().string();
    const bool has_metadata_of_same_name = is_metadata_file(fs::path(recording).replace_extension(".json"));
    MetadataList formats;
    for (const fs::path& file : files) {
        const std::string stem = file.stem().string();
        const bool is_of_other_recording = stem != own_stem && recording_stems.contains(stem);
        const bool has_other_name = has_metadata_of_same_name && !stem.starts_with(own_stem);
        if (is_of_other_recording || has_other_name) continue;
        if (formats.size() >= kMostFiles || !is_metadata_file(file)) continue;
        try {
            const fs::path shown = recording.has_parent_path() ? file : file.filename();
            formats.push_back(parse_metadata(read_text_file(file), shown.string()));
        } catch (const DataError& error) {
            errors.emplace_back(error.what());
        }
    }
    return formats;
}

std::shared_ptr<const OusterMetadata> find_metadata(const MetadataList& metadata_list, std::string_view topic,
                                                    std::string_view packet) {
    const int port = parse_port(topic);
    const bool is_of_one_sensor = std::ranges::all_of(
        metadata_list, [&](const auto& format) { return format->text == metadata_list.front()->text; });
    // Candidates have the size of the packet and, if it is known, the UDP port. Users may
    // change the port after the metadata was stored. A sensor is then known by its serial
    // number. LEGACY packets have none, so the sensor must be the only one.
    MetadataList candidates;
    for (const auto& format : metadata_list) {
        const bool is_duplicate =
            std::ranges::any_of(candidates, [&](const auto& other) { return other->text == format->text; });
        if (format->packet_bytes != packet.size() || is_duplicate) continue;
        const bool has_other_port = port > 0 && format->port > 0 && port != format->port;
        const bool may_change_port =
            has_serial(packet, *format) || (is_of_one_sensor && format->profile->is_legacy);
        if (!has_other_port || may_change_port) candidates.push_back(format);
    }
    // Of several candidates, keeps those that meet a condition, unless none meets it. So
    // an earlier condition counts more than a later one: namespace, port, serial number.
    const auto prefer = [&](auto meets_condition) {
        if (candidates.size() > 1 && std::ranges::any_of(candidates, meets_condition))
            std::erase_if(candidates, [&](const auto& format) { return !meets_condition(format); });
    };
    const std::string_view topic_namespace = find_namespace(topic);  // empty for a capture
    prefer([&](const auto& format) {
        return !topic_namespace.empty() && find_namespace(format->where) == topic_namespace;
    });
    prefer([&](const auto& format) { return format->port > 0 && format->port == port; });
    prefer([&](const auto& format) { return has_serial(packet, *format); });
    return candidates.size() == 1 ? candidates.front() : nullptr;
}

bool is_ouster_size(std::size_t n_bytes) {
    for (const OusterProfile& profile : kOusterProfiles)
        for (const int pixels : {16, 32, 64, 128, 256})
            if (n_bytes == count_bytes(profile, pixels, kUsualColumns)) return true;
    return false;
}

std::string ouster_error(const MetadataList& metadata_list, const fs::path& recording_path,
                         std::string_view topic, std::size_t packet_size) {
    const int port = parse_port(topic);  // 0 if the packets come from a bag
    const std::string source = port > 0 ? fmt::format("on port {}", port) : "of " + quote(topic);
    const std::string found = fmt::format("found packets of {} bytes {}", packet_size, source);
    if (metadata_list.empty())
        return fmt::format(
            "{}, probably from an Ouster; expected the metadata of the sensor "
            "(http://SENSOR/api/v1/sensor/metadata) {}in the file {}",
            found, port > 0 ? "" : "on a topic .../metadata, or ",
            fs::path(recording_path).replace_extension(".json").filename().string());
    std::string formats;
    for (std::size_t k = 0; k < std::min(metadata_list.size(), kMaxListedFormats); ++k)
        formats += fmt::format("{}{} of {}", k == 0 ? "" : ", or ", metadata_list[k]->describe(),
                               metadata_list[k]->where);
    if (metadata_list.size() > kMaxListedFormats)
        formats += fmt::format(", or of {} other files", metadata_list.size() - kMaxListedFormats);
    // Metadata of this packet size is not enough: several sensors have it.
    const bool has_size = std::ranges::any_of(
        metadata_list, [&](const auto& format) { return format->packet_bytes == packet_size; });
    std::string expected = "metadata of the same sensor and configuration";
    if (has_size && port > 0) expected = fmt::format("exactly one file with \"udp_port_lidar\": {}", port);
    else if (has_size) expected = "exactly one metadata topic in the namespace of the packet topic";
    return fmt::format("{}, but the metadata describes {}; expected {}", found, formats, expected);
}

std::unique_ptr<PacketDecoder> make_ouster_decoder(const char*, const DecoderCalibration& calibration) {
    return std::make_unique<OusterDecoder>(calibration.ouster);
}

}  // namespace relidar::packets
