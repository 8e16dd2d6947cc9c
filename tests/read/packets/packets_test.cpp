// SPDX-License-Identifier: Apache-2.0
// Compares bytes with the manuals, and reads the packets of all products again.
#include <cmath>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_pattern.hpp>
#include <relidar/read/dataset.hpp>
#include <relidar/read/packets.hpp>

#include "base/codecs/byte_reader.hpp"
#include "read/packets/decoder.hpp"

namespace relidar {
namespace {

using codecs::number_at;

constexpr double kStart_s = 1'700'000'000.0;  // 2023-11-14 22:13:20 UTC
constexpr std::int64_t kStart_ns = 1'700'000'000'000'000'000;

SpinningSensor make_sensor_named(const std::string& name, int columns = 0) {
    // A VLS-128 fires every 55.3 us, not every 53.3 us as its manual states.
    if (name == "VLS-128") columns = 1808;
    return std::get<SpinningSensor>(find_built_in(name, columns)->pattern);
}

/// Returns the time from the start of a firing to each laser, highest laser first.
std::vector<double> find_laser_times_us(const std::string& product) {
    if (product.starts_with("OS")) return std::vector<double>(128, 0.0);
    return packets::make_block_decoder(product.c_str(), {})->timing().offset_us;
}

/// Returns a multiple of 8 mm. Every fifth ray has no return.
float range_of(std::size_t index) { return index % 5 == 0 ? 0.0f : 0.008f * float(500 + index * 7 % 4000); }
float to_intensity(std::size_t index) { return float(1 + index % 250) / 255.0f; }

Scan make_known_scan(const SpinningSensor& sensor, bool has_second_returns = false) {
    Scan scan;
    scan.rays = make_rays(sensor);
    const std::size_t n = scan.rays.size();
    if (has_second_returns) scan.second_returns.resize(1);
    for (std::size_t i = 0; i < n; ++i) {
        scan.range_m.push_back(range_of(i));
        scan.intensity.push_back(range_of(i) > 0.0f ? to_intensity(i) : 0.0f);
        if (!has_second_returns) continue;
        const bool is_split = i % 3 == 1 && range_of(i) > 0.0f;
        const float offset_m = i % 2 ? 0.8f : -0.8f;
        scan.second_returns[0].range_m.push_back(is_split ? range_of(i) + offset_m : 0.0f);
        scan.second_returns[0].intensity.push_back(0.0f);
    }
    return scan;
}

std::vector<SensorPacket> make_packets_of(const SpinningSensor& sensor, const PacketOptions& options,
                                          int n_scans, bool has_second_returns = false) {
    PacketEncoder encoder(sensor, options);
    std::vector<SensorPacket> packets;
    const Scan scan = make_known_scan(sensor, has_second_returns);
    for (int k = 0; k < n_scans; ++k)
        std::ranges::copy(encoder.add_scan(scan, 1.0 + sensor.period_s * k), std::back_inserter(packets));
    std::ranges::copy(encoder.flush(), std::back_inserter(packets));
    return packets;
}

/// Compares with manual 63-9243. Laser k of a VLP-16 has an elevation of -15 + k degrees
/// for even k, and of k degrees for odd k. Laser k fires k * 2.304 us after laser 0. A
/// block has two firings.
TEST(Packets, OfAVlp16AreThoseOfItsManual) {
    const SpinningSensor sensor = make_sensor_named("VLP-16");
    const std::vector<SensorPacket> packets = make_packets_of(sensor, {.start_ns = kStart_ns}, 2);
    const Scan scan = make_known_scan(sensor);
    // Expects an additional firing without returns before the scan and an additional
    // packet after the scan.
    ASSERT_EQ(packets.size(), std::size_t((1 + 2 * sensor.columns + 23) / 24 + 1));
    const double step_deg = 360.0 / sensor.columns;
    for (std::size_t p = 0; p + 2 < packets.size(); ++p) {
        const std::string& bytes = packets[p].bytes;
        ASSERT_EQ(bytes.size(), 1206u);
        EXPECT_EQ(number_at<std::uint8_t>(bytes, 1204), 0x37) << "the strongest return";
        EXPECT_EQ(number_at<std::uint8_t>(bytes, 1205), 0x22) << "VLP-16";
        const double first = 24.0 * double(p) - 1.0;  // firing of the scans
        const double time_s = kStart_s + 0.95 + (first + 0.5) * sensor.period_s / sensor.columns;
        EXPECT_NEAR(1e-6 * number_at<std::uint32_t>(bytes, 1200), std::fmod(time_s, 3600.0), 1.1e-6) << p;
        EXPECT_NEAR(1e-9 * double(packets[p].time_ns - kStart_ns), time_s - kStart_s, 1e-6);
        for (std::size_t b = 0; b < 12; ++b) {
            EXPECT_EQ(number_at<std::uint16_t>(bytes, 100 * b), 0xEEFF);
            const double azimuth_deg = 180.0 + (first + 2.0 * double(b) + 0.5) * step_deg;
            EXPECT_NEAR(
                std::remainder(0.01 * number_at<std::uint16_t>(bytes, 100 * b + 2) - azimuth_deg, 360.0), 0.0,
                0.00501);
        }
        for (std::size_t unit = 0; unit < 24 * 16; ++unit) {
            const std::ptrdiff_t firing = std::ptrdiff_t(first) + std::ptrdiff_t(unit / 16);
            if (firing < 0) continue;
            const std::size_t laser = unit % 16;
            const int elevation_deg = laser % 2 == 0 ? -15 + int(laser) : int(laser);
            const auto ring = std::size_t((15 - elevation_deg) / 2);
            const double turned_deg = 2.304 * double(laser) * 1e-6 / sensor.period_s * 360.0;
            const int shift = -int(std::lround(turned_deg / step_deg));
            const auto n = std::ptrdiff_t(sensor.columns);
            const std::size_t ray = ring * std::size_t(n) + std::size_t(((firing % n) - shift + n) % n);
            const std::size_t at = 100 * (unit / 32) + 4 + 3 * (unit % 32);
            ASSERT_EQ(number_at<std::uint16_t>(bytes, at), std::lround(scan.range_m[ray] / 0.002f))
                << p << unit;
            ASSERT_EQ(number_at<std::uint8_t>(bytes, at + 2), std::lround(255.0f * scan.intensity[ray]));
        }
    }
}

struct HesaiFields {
    std::size_t n_bytes;
    std::string_view head;
    std::size_t mode_at, mode, rpm_at, date_at, us_at, number_at;
};
constexpr HesaiFields kXt32{
    1080, {"\xEE\xFF\x06\x01\0\0\x20\x08\x01\x04\x02\x01", 12}, 1062, 0x39, 1063, 1065, 1071, 1076};
constexpr HesaiFields kQt64{
    1072, {"\xEE\xFF\x03\x01\0\0\x40\x04\0\x04\x01\x01", 12}, 1060, 0x37, 1054, 1062, 1056, 1068};
constexpr HesaiFields kQt128{
    1095, {"\xEE\xFF\x03\x02\0\0\x80\x02\x01\x04\x02\x05", 12}, 1073, 0x39, 1074, 1076, 1082, 1087};
constexpr HesaiFields kOt128{
    861, {"\xEE\xFF\x01\x04\0\0\x80\x02\0\x04\x01\x07", 12}, 817, 0x37, 818, 820, 826, 831};

/// Returns the time of packet `number` within the minute in seconds.
double expect_fields(const std::string& bytes, const HesaiFields& fields, std::size_t number) {
    EXPECT_EQ(bytes.size(), fields.n_bytes);
    EXPECT_EQ(bytes.substr(0, 12), fields.head);
    EXPECT_EQ(number_at<std::uint8_t>(bytes, fields.mode_at), fields.mode);
    EXPECT_EQ(number_at<std::uint16_t>(bytes, fields.rpm_at), 600);
    EXPECT_EQ(bytes.substr(fields.date_at, 5), std::string({123, 11, 14, 22, 13}));
    EXPECT_EQ(number_at<std::uint32_t>(bytes, fields.number_at), number);
    return number_at<std::uint8_t>(bytes, fields.date_at + 5) +
           1e-6 * number_at<std::uint32_t>(bytes, fields.us_at);
}

/// Compares with the user manual of the PandarXT. The tail of a packet contains the
/// return mode and the motor speed. The date, counted from 1900, the time within the
/// second, a constant and the packet number follow.
TEST(Packets, OfAnXt32HaveModeDateAndNumber) {
    const std::vector<SensorPacket> packets =
        make_packets_of(make_sensor_named("XT32"), {.start_ns = kStart_ns, .returns = 2}, 1, true);
    for (std::size_t p = 0; p < packets.size(); ++p) {
        const std::string& bytes = packets[p].bytes;
        const double time_s = expect_fields(bytes, kXt32, p);
        EXPECT_EQ(std::llround(1e6 * time_s), 20'000'000 + (packets[p].time_ns - kStart_ns + 500) / 1000);
        for (std::size_t unit = 0; unit < 4 * 32; ++unit) {  // the last return precedes the strongest return
            const std::size_t at = 12 + 260 * (unit / 32) + 2 + 4 * (unit % 32);
            EXPECT_GE(number_at<std::uint16_t>(bytes, at), number_at<std::uint16_t>(bytes, at + 130));
        }
    }
}

/// Compares with the user manual of the PandarQT. The tail of a packet contains the motor
/// speed, the time within the second, the return mode and a constant. The date, counted
/// from 1900, and the packet number follow. The time is the start of the first block
/// minus 25.71 us.
TEST(Packets, OfAQt64HaveTheFieldsOfItsManual) {
    const SpinningSensor sensor = make_sensor_named("QT64");
    const std::vector<SensorPacket> packets = make_packets_of(sensor, {.start_ns = kStart_ns}, 1);
    const Scan scan = make_known_scan(sensor);
    for (std::size_t p = 0; p < packets.size(); ++p) {
        const std::string& bytes = packets[p].bytes;
        const double sent_s = expect_fields(bytes, kQt64, p);
        const double first = 4.0 * double(p) - 1.0;  // firing of the scans
        const double time_s =
            0.95 + (first + 0.5) * sensor.period_s / sensor.columns - (25.71 + 12.31) * 1e-6;
        EXPECT_NEAR(sent_s - 20.0, time_s, 1.1e-6) << p;
        for (std::size_t block = 0; block < 4 && p + 1 < packets.size(); ++block) {
            const double azimuth_deg = 90.0 + 180.0 + (first + double(block) + 0.5) * 0.6;
            EXPECT_NEAR(
                std::remainder(0.01 * number_at<std::uint16_t>(bytes, 12 + 258 * block) - azimuth_deg, 360.0),
                0.0, 0.00501);
        }
    }
}

/// Returns CRC-32/MPEG-2.
std::uint32_t crc_of(const std::string& bytes) {
    std::uint32_t sum = ~0u;
    for (const char byte : bytes) {
        sum ^= std::uint32_t(static_cast<unsigned char>(byte)) << 24;
        for (int bit = 0; bit < 8; ++bit) sum = sum << 1 ^ (sum >> 31 ? 0x04C11DB7u : 0u);
    }
    return sum;
}

/// Compares with the user manual of the QT128C2X. With two returns, a packet has one
/// firing of 96 lasers: all but lasers 1 to 32 in sequence 1, and all but lasers 33 to 64
/// in sequence 2. The mode flag is 1 for sequence 1.
TEST(Packets, OfAQt128AlternateBetweenItsLasers) {
    const SpinningSensor sensor = make_sensor_named("QT128");
    const std::vector<SensorPacket> packets =
        make_packets_of(sensor, {.start_ns = kStart_ns, .returns = 2}, 1, true);
    // Expects both sequences of an additional firing before and after the scan.
    ASSERT_EQ(packets.size(), std::size_t(sensor.columns + 4));
    std::size_t n_lit = 0;
    for (std::size_t p = 0; p < packets.size(); ++p) {
        const std::string& bytes = packets[p].bytes;
        const double sent_s = expect_fields(bytes, kQt128, p);
        EXPECT_EQ(number_at<std::uint8_t>(bytes, 1066), p % 2 == 0);
        // A checksum follows the blocks, the safety field and the tail.
        for (const auto& [begin, end] : {std::pair{12u, 1040u}, {1045u, 1057u}, {1061u, 1091u}})
            EXPECT_EQ(number_at<std::uint32_t>(bytes, end), crc_of(bytes.substr(begin, end - begin)));
        // The last block starts 9 us after the packet's time.
        const double time_s =
            0.95 + (double(p) - 1.5) * sensor.period_s / sensor.columns - (9.0 + 0.6) * 1e-6;
        EXPECT_NEAR(sent_s - 20.0, time_s, 1.1e-6) << p;
        EXPECT_EQ(number_at<std::uint16_t>(bytes, 12), number_at<std::uint16_t>(bytes, 12 + 514));
        for (std::size_t laser = 1; laser <= 128; ++laser) {
            const bool is_silent = p % 2 == 0 ? laser <= 32 : laser > 32 && laser <= 64;
            const auto range = number_at<std::uint16_t>(bytes, 14 + 4 * (laser - 1));
            EXPECT_TRUE(!is_silent || range == 0) << "packet " << p << ", laser " << laser;
            n_lit += range > 0;
        }
    }
    EXPECT_NEAR(double(n_lit) / sensor.columns, 0.8 * 96.0, 0.5);
}

/// Compares with the user manual of the OT128. The sensor has two modes. In the first
/// mode, all lasers fire 1800 times per turn. In the second mode, 3600 firings alternate
/// between two sequences, in which 29 and 31 lasers are silent.
TEST(Packets, OfAnOt128HaveTheModeOfTheirColumns) {
    for (const int columns : {1800, 3600}) {
        const SpinningSensor sensor = make_sensor_named("OT128", columns);
        const std::vector<SensorPacket> packets = make_packets_of(sensor, {.start_ns = kStart_ns}, 1);
        ASSERT_GE(packets.size(), std::size_t(columns / 2));
        std::size_t n_lit[2] = {};
        for (std::size_t p = 1; p < std::size_t(columns / 2); ++p) {
            const std::string& bytes = packets[p].bytes;
            expect_fields(bytes, kOt128, p);
            EXPECT_EQ(number_at<std::uint16_t>(bytes, 814), columns == 3600 ? 1 << 12 : 0);
            EXPECT_EQ(number_at<std::uint8_t>(bytes, 816), columns == 3600 ? 0 : 1) << "operation mode";
            const double turned_deg =
                0.01 * (number_at<std::uint16_t>(bytes, 12 + 386) - number_at<std::uint16_t>(bytes, 12));
            EXPECT_NEAR(std::remainder(turned_deg, 360.0), 360.0 / columns, 0.0101);
            for (std::size_t k = 0; k < 256; ++k)
                n_lit[k / 128] += number_at<std::uint16_t>(bytes, 14 + 386 * (k / 128) + 3 * (k % 128)) > 0;
        }
        const bool is_fine = columns == 3600;
        EXPECT_NEAR(2.0 * double(n_lit[0]) / columns, 0.8 * (is_fine ? 128 - 29 : 128), 0.5);
        EXPECT_NEAR(2.0 * double(n_lit[1]) / columns, 0.8 * (is_fine ? 128 - 31 : 128), 0.5);
    }
}

struct WrittenProduct {
    const char *sensor, *profile;
    int returns;
    double quantum_m;
};

/// Writes two turns of a scan as a capture, and reads the capture as a log.
Log write_and_load_log(const SpinningSensor& sensor, const PacketOptions& options, const Scan& scan) {
    const std::filesystem::path folder =
        std::filesystem::path(::testing::TempDir()) / "relidar_sensor_packets";
    std::filesystem::create_directories(folder);
    const std::filesystem::path file = folder / "packets.pcap";
    for (const char* ending : {".csv", ".json"})
        std::filesystem::remove(std::filesystem::path(file).replace_extension(ending));
    PacketEncoder encoder(sensor, options);
    PcapWriter capture(file, encoder.udp_port());
    for (int k = 0; k < 2; ++k) capture.write_packets(encoder.add_scan(scan, 1.0 + sensor.period_s * k));
    capture.write_packets(encoder.flush());
    capture.close_file();
    const PacketCalibrationFile calibration = encoder.calibration_file();
    if (!calibration.ending.empty())
        std::ofstream(std::filesystem::path(file).replace_extension(calibration.ending)) << calibration.text;
    return load_log(file.string(), {.poses_file = kNoPoses, .max_range_m = sensor.max_range_m});
}

/// Compares ray `i` of a decoded scan with a ray of the written scan.
void expect_same_return(const Scan& decoded, std::size_t i, const Scan& scan, std::size_t ray,
                        double tolerance_m, double most_apart_deg) {
    ASSERT_NEAR(decoded.range_m[i], scan.range_m[ray], tolerance_m) << "ray " << i;
    ASSERT_NEAR(decoded.intensity[i], scan.intensity[ray], 1e-6) << "ray " << i;
    const double apart_deg =
        double(glm::length(decoded.rays.direction[i] - scan.rays.direction[ray])) * 180.0 / kPi;
    ASSERT_LT(apart_deg, most_apart_deg) << "ray " << i;
    for (std::size_t k = 0; k < scan.second_returns.size(); ++k)
        ASSERT_NEAR(decoded.second_returns[k].range_m[i], scan.second_returns[k].range_m[ray], tolerance_m)
            << "ray " << i;
}

void expect_same_returns(const WrittenProduct& product) {
    const auto& [name, profile, returns, quantum_m] = product;
    SCOPED_TRACE(std::string(name) + " " + profile + ", returns " + std::to_string(returns));
    const SpinningSensor sensor = make_sensor_named(name);
    const PacketOptions options{.start_ns = kStart_ns, .returns = returns, .ouster_profile = profile};
    const Scan scan = make_known_scan(sensor, returns == 2);
    const Log log = write_and_load_log(sensor, options, scan);
    ASSERT_EQ(log.frames.size(), 2u);
    const double start_s = 1e-9 * double(log.start_unix_ns - kStart_ns);
    const std::vector<double> laser_times_us = find_laser_times_us(name);
    // [ring, nearest firing] of each written return
    const double step_s = sensor.period_s / sensor.columns;
    const double phase = sensor.first_azimuth_rad == kPi ? 0.0 : 0.5;
    const auto key = [&](std::size_t ring, double time_s) {
        return std::pair(ring, std::lround((time_s - 0.95) / step_s - phase));
    };
    std::map<std::pair<std::size_t, long>, std::size_t> written;
    for (int k = 0; k < 2; ++k)
        for (std::size_t i = 0; i < scan.range_m.size(); ++i)
            if (scan.range_m[i] > 0.0f)
                written[key(scan.rays.channel[i],
                            1.0 + sensor.period_s * k + double(scan.rays.time_offset_s[i]))] = i;
    std::set<std::pair<std::size_t, long>> matched_keys;
    for (const Frame& frame : log.frames) {
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            if (!(frame.scan.range_m[i] > 0.0f)) continue;
            const std::size_t ring = frame.scan.rays.channel[i];
            const double time_s = start_s + frame.time_s + double(frame.scan.rays.time_offset_s[i]) -
                                  1e-6 * laser_times_us[ring];
            const auto at = written.find(key(ring, time_s));
            ASSERT_NE(at, written.end()) << "ring " << ring << " at " << time_s << " s";
            const std::size_t ray = at->second;
            const double fired_s = double(scan.rays.time_offset_s[ray]);
            ASSERT_NEAR(std::remainder(time_s - 1.0 - fired_s, sensor.period_s), 0.0, 1e-6);
            ASSERT_NO_FATAL_FAILURE(expect_same_return(frame.scan, i, scan, ray, 0.5001 * quantum_m, 0.012));
            matched_keys.insert(at->first);
        }
    }
    EXPECT_GE(matched_keys.size() + 2 * sensor.beams.size(), written.size())
        << "only firings at the ends of the log may be lost";
}

TEST(Packets, GiveTheSameReturnsAgain) {
    constexpr WrittenProduct kProducts[] = {{"VLP-16", "", 1, 0.002},
                                            {"VLP-16", "", 2, 0.002},
                                            {"VLP-32C", "", 1, 0.004},
                                            {"HDL-32E", "", 2, 0.002},
                                            {"Pandar40P", "", 1, 0.004},
                                            {"Pandar64", "", 2, 0.004},
                                            {"XT32", "", 2, 0.004},
                                            {"XT16", "", 1, 0.004},
                                            {"XT32M", "", 2, 0.004},
                                            {"VLS-128", "", 1, 0.004},
                                            {"QT64", "", 1, 0.004},
                                            {"QT64", "", 2, 0.004},
                                            {"OT128", "", 1, 0.004},
                                            {"OT128", "", 2, 0.004},
                                            {"OS1-64", "RNG19_RFL8_SIG16_NIR16", 1, 0.001},
                                            {"OS0-32", "RNG15_RFL8_NIR8", 1, 0.008},
                                            {"OS0-32", "RNG19_RFL8_SIG16_NIR16_DUAL", 2, 0.001}};
    for (const WrittenProduct& product : kProducts) expect_same_returns(product);
}

struct AlternatingProduct {
    const char *sensor, *layout;
    int columns, returns;
    std::size_t n_common;   ///< lasers that fire in both sequences
    double most_apart_deg;  ///< of these lasers, because their file has a single azimuth
};

/// The log has a row for each laser and firing sequence. Each of its rays must be a ray
/// of the scan. If it is written again, the packets must be the same.
void expect_rays_of_lasers(const AlternatingProduct& product) {
    SCOPED_TRACE(std::string(product.layout) + ", returns " + std::to_string(product.returns));
    const SpinningSensor sensor = make_sensor_named(product.sensor, product.columns);
    const PacketOptions options{.start_ns = kStart_ns, .returns = product.returns};
    const Scan scan = make_known_scan(sensor, product.returns == 2);
    const Log log = write_and_load_log(sensor, options, scan);
    ASSERT_EQ(log.frames.size(), 2u);
    const SpinningSensor& decoded = log.lidars.front().sensor;
    const double step_s = sensor.period_s / sensor.columns;
    EXPECT_NEAR(decoded.columns * 2, sensor.columns, 4);
    const auto find_firing = [&](double time_s) { return std::lround((time_s - 0.95) / step_s - 0.5); };
    std::map<std::pair<std::size_t, long>, std::size_t> written;
    for (std::size_t i = 0; i < scan.range_m.size(); ++i)
        written[{scan.rays.channel[i], find_firing(1.0 + double(scan.rays.time_offset_s[i]))}] = i;
    std::map<std::size_t, std::set<long>> parities;  // [laser] firings, modulo 2
    const double start_s = 1e-9 * double(log.start_unix_ns - kStart_ns);
    std::size_t n_matched_returns = 0;
    for (const Frame& frame : log.frames) {
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) {
            if (!(frame.scan.range_m[i] > 0.0f)) continue;
            const double elevation_rad = decoded.beams[frame.scan.rays.channel[i]].elevation_rad;
            const auto laser =
                std::size_t(std::ranges::min_element(sensor.beams, {},
                                                     [&](const Beam& beam) {
                                                         return std::abs(beam.elevation_rad - elevation_rad);
                                                     }) -
                            sensor.beams.begin());
            // A laser fires less than a step after its firing has started.
            const double time_s = start_s + frame.time_s + double(frame.scan.rays.time_offset_s[i]);
            const long firing = std::lround(std::floor((time_s - 0.95) / step_s - 0.5 + 0.04));
            const auto at = written.find({laser, firing % sensor.columns});
            ASSERT_NE(at, written.end()) << "laser " << laser << " at " << time_s << " s";
            const std::size_t ray = at->second;
            ASSERT_NO_FATAL_FAILURE(
                expect_same_return(frame.scan, i, scan, ray, 0.002001, product.most_apart_deg));
            parities[laser].insert(firing % 2);
            ++n_matched_returns;
        }
    }
    EXPECT_EQ(std::ranges::count_if(parities, [](const auto& entry) { return entry.second.size() == 2; }),
              std::ptrdiff_t(product.n_common));
    const double n_rays = double(128 + product.n_common) * decoded.columns * 2;
    EXPECT_NEAR(double(n_matched_returns) / n_rays, 0.8, 0.005);
}

TEST(Packets, GiveTheRaysOfTheirLasers) {
    for (const int returns : {1, 2}) {
        expect_rays_of_lasers({"QT128", "QT128", 900, returns, 64, 0.055});
        expect_rays_of_lasers({"OT128", "OT128 in high resolution", 3600, returns, 68, 0.0075});
    }
}

TEST(Packets, OfOtherSensorsAreRefused) {
    SpinningSensor sensor = make_sensor_named("HDL-64E");
    for (const char* name : {"HDL-64E", "VLP-16", "XT32", "Ouster"})
        EXPECT_THAT([&] { PacketEncoder(sensor, {}); },
                    testing::ThrowsMessage<UsageError>(testing::HasSubstr(name)));
    sensor.name = "VLP-16";
    EXPECT_THROW(PacketEncoder(sensor, {}), UsageError) << "64 beams";
    sensor = make_sensor_named("VLP-16");
    sensor.columns = 900;
    EXPECT_THROW(PacketEncoder(sensor, {}), UsageError) << "it fires 1808 times in a turn";
    EXPECT_THROW(PacketEncoder(make_sensor_named("OS1-64"), {.ouster_profile = "RNG99"}), DataError);
    sensor = make_sensor_named("VLP-16");
    PacketEncoder encoder(sensor, {});
    Scan scan = make_known_scan(sensor);
    encoder.add_scan(scan, 0.0);
    EXPECT_THROW(encoder.add_scan(scan, 0.05), UsageError) << "scans that overlap";
    std::ranges::fill(scan.rays.time_offset_s, 0.0f);
    EXPECT_THROW(encoder.add_scan(scan, 1.0), UsageError) << "no firing times";
}

/// The time between frames is longer than a turn.
TEST(Packets, FollowEachOtherEvenlyThroughAGap) {
    const SpinningSensor sensor = make_sensor_named("HDL-32E");
    PacketEncoder encoder(sensor, {.start_ns = kStart_ns});
    const Scan scan = make_known_scan(sensor);
    std::vector<SensorPacket> packets = encoder.add_scan(scan, 1.0);
    std::ranges::copy(encoder.add_scan(scan, 1.1035), std::back_inserter(packets));
    for (std::size_t p = 1; p < packets.size(); ++p) {
        EXPECT_NEAR(1e-3 * double(packets[p].time_ns - packets[p - 1].time_ns), 12 * 46.08, 24.0) << p;
        const double before = 0.01 * number_at<std::uint16_t>(packets[p - 1].bytes, 2),
                     after = 0.01 * number_at<std::uint16_t>(packets[p].bytes, 2);
        EXPECT_GE(std::remainder(after - before, 360.0), 0.0) << p;
    }
}

}  // namespace
}  // namespace relidar
