// SPDX-License-Identifier: Apache-2.0
// Compares points with the points that TIER IV's driver nebula decodes from the same real
// packets (nebula/*.txt). nebula ignores the rotation of the head while the lasers of a
// block fire. The rotation is compared with the manuals.
#include <cmath>
#include <fstream>

#include <relidar/base/error.hpp>

#include "base/files.hpp"
#include "read/packets/decoder.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using packets::AngleCorrection;
using packets::DecoderCalibration;

// rotation rate at which the head does not turn noticeably during a firing
constexpr double kStill_hz = 1e-9;
constexpr double kDegree = kPi / 180.0;

struct Recorded {
    std::vector<std::string> packets;
    std::vector<glm::dvec3> points_m;  ///< points that nebula decodes
};

Recorded read_recorded(const std::string& name) {
    Recorded recorded;
    for (const std::string& line : split_lines(read_text_file(
             std::string(RELIDAR_SOURCE_DIR) + "/tests/read/packets/nebula/" + name + ".txt"))) {
        std::istringstream words(line);
        std::string kind, hex;
        glm::dvec3 point_m;
        words >> kind;
        if (kind == "packet" && words >> hex) {
            std::string& bytes = recorded.packets.emplace_back();
            for (std::size_t k = 0; k + 1 < hex.size(); k += 2)
                bytes += char(std::stoi(hex.substr(k, 2), nullptr, 16));
        }
        if (kind == "point" && words >> point_m.x >> point_m.y >> point_m.z)
            recorded.points_m.push_back(point_m);
    }
    return recorded;
}

std::unique_ptr<packets::PacketDecoder> make_decoder(const std::string& packet, const std::string& product,
                                                     const DecoderCalibration& calibration = {}) {
    const packets::LidarProduct* match = packets::find_product(packet, calibration);
    EXPECT_TRUE(match && match->make && match->name == product) << (match ? match->name : "");
    return match && match->make ? match->make(match->name, calibration) : nullptr;
}

std::vector<glm::dvec3> decode_points(const packets::PacketDecoder& decoder,
                                      const std::vector<std::string>& all_packets) {
    const std::vector<Beam> beams = decoder.make_sensor(1800, kStill_hz).beams;
    std::vector<glm::dvec3> points_m;
    for (const std::string& bytes : all_packets) {
        const packets::DecodedPacket packet = decoder.decode_packet(bytes);
        for (std::size_t f = 0; f < packet.firings.size(); ++f)
            for (std::size_t ring = 0; ring < beams.size(); ++ring)
                for (const packets::DecodedReturn& echo : packet.echoes[f * beams.size() + ring])
                    if (echo.range_m > 0.0f)
                        points_m.push_back(
                            double(echo.range_m) *
                            aim_beam(beams[ring], -packet.firings[f].azimuth_deg * kDegree).direction);
    }
    return points_m;
}

/// @param ahead_deg largest rotation that nebula adds to a point
void expect_all(const std::vector<glm::dvec3>& theirs_m, const std::vector<glm::dvec3>& ours_m,
                double ahead_deg = 0.0) {
    std::size_t n_missing = 0;
    for (const glm::dvec3& point_m : theirs_m) {
        bool is_there = false;
        for (const glm::dvec3& our_m : ours_m) {
            const double range_m = glm::length(point_m);
            if (std::abs(glm::length(our_m) - range_m) > 1e-3) continue;
            const double up_deg =
                (std::asin(our_m.z / glm::length(our_m)) - std::asin(point_m.z / range_m)) / kDegree;
            const double left_deg =
                std::remainder(std::atan2(our_m.y, our_m.x) - std::atan2(point_m.y, point_m.x), 2.0 * kPi) /
                kDegree;
            is_there = is_there ||
                       (std::abs(up_deg) < 0.005 && left_deg > -0.00501 && left_deg < 0.00501 + ahead_deg);
        }
        n_missing += !is_there;
    }
    EXPECT_EQ(n_missing, 0u) << "of " << theirs_m.size() << " points";
}

struct Case {
    const char *file, *product;
    std::size_t n_points;
    int n_slots, n_rings;
};
constexpr Case kCases[] = {
    {"xt16", "XT16", 128, 4, 16},    {"xt32m", "XT32M", 97, 3, 32},      {"qt64", "QT64", 228, 2, 64},
    {"qt128", "QT128", 183, 1, 192}, {"vls128", "VLS-128", 373, 3, 128},
};

TEST(BlockPackets, GiveThePointsOfNebula) {
    for (const Case& test : kCases) {
        SCOPED_TRACE(test.product);
        const Recorded recorded = read_recorded(test.file);
        ASSERT_FALSE(recorded.packets.empty());
        const auto decoder = make_decoder(recorded.packets[0], test.product);
        ASSERT_TRUE(decoder);
        EXPECT_EQ(decoder->decode_packet(recorded.packets[0]).n_slots, test.n_slots);
        EXPECT_EQ(decoder->timing().offset_us.size(), std::size_t(test.n_rings));
        EXPECT_EQ(recorded.points_m.size(), test.n_points);
        // nebula rotates the head for the last 32 lasers of a VLS-128, by up to 17/20 of
        // an azimuth step of 0.2 degrees
        expect_all(recorded.points_m, decode_points(*decoder, recorded.packets),
                   std::string(test.file) == "vls128" ? 0.2 : 0.0);
    }
}

/// Firing time of a laser, from the manual of the sensor.
struct FiringTime {
    const char *file, *product;
    double elevation_deg;  ///< elevation of the laser
    double offset_us;      ///< time since the first laser of the firing
};

TEST(BlockPackets, TurnUntilTheLaserFires) {
    constexpr FiringTime kTimes[] = {
        {"xt16", "XT16", 15.0, 0.0},
        {"xt16", "XT16", -15.0, 15 * 3.024},
        {"xt32m", "XT32M", 19.407, 0.0},
        {"xt32m", "XT32M", -20.72, 15 * 2.888},
        {"qt64", "QT64", -52.121, 0.0},
        {"qt64", "QT64", 36.064, 129.6 - 12.31},
        {"qt128", "QT128", -52.6268, 2.312 - 0.6 + 1000.0 / 9.0},
        {"qt128", "QT128", 52.6268, 48.12 - 0.6},
        {"vls128", "VLS-128", -25.0, 4 * 2.665},
    };
    for (const FiringTime& time : kTimes) {
        SCOPED_TRACE(std::string(time.product) + " " + std::to_string(time.elevation_deg));
        const auto decoder = make_decoder(read_recorded(time.file).packets.at(0), time.product);
        ASSERT_TRUE(decoder);
        const auto still = decoder->make_sensor(1800, kStill_hz), turning = decoder->make_sensor(1800, 10.0);
        std::optional<double> error_us;
        for (std::size_t ring = 0; ring < still.beams.size(); ++ring) {
            if (std::abs(still.beams[ring].elevation_rad / kDegree - time.elevation_deg) > 6e-4) continue;
            const double turned_deg =
                (still.beams[ring].azimuth_offset_rad - turning.beams[ring].azimuth_offset_rad) / kDegree;
            EXPECT_NEAR(turned_deg, 3600e-6 * decoder->timing().offset_us[ring], 1e-9);
            const double error = std::abs(decoder->timing().offset_us[ring] - time.offset_us);
            error_us = std::min(error_us.value_or(error), error);
        }
        EXPECT_TRUE(error_us && *error_us < 1e-6);
    }
}

TEST(BlockPackets, UseTheAnglesOfTheirFile) {
    const Recorded recorded = read_recorded("xt16");
    AngleCorrection angles{"unit.csv", false, {}}, others{"other.csv", false, {}};
    for (int laser = 0; laser < 16; ++laser) angles.lasers.push_back({10.0 - laser, 0.25 * laser});
    others.lasers.resize(32);
    const auto decoder = make_decoder(recorded.packets[0], "XT16", {{others, angles}});
    ASSERT_TRUE(decoder);
    EXPECT_NE(decoder->describe_product().find("unit.csv"), std::string::npos) << decoder->describe_product();
    const std::vector<Beam> beams = decoder->make_sensor(2000, kStill_hz).beams;
    for (int laser = 0; laser < 16; ++laser) {
        EXPECT_NEAR(beams[std::size_t(laser)].elevation_rad / kDegree, 10.0 - laser, 1e-9);
        EXPECT_NEAR(beams[std::size_t(laser)].azimuth_offset_rad / kDegree, -0.25 * laser, 1e-9);
    }
    // Two of the files fit the packets. A further file has the name of the recording but
    // does not fit.
    const auto unsure = make_decoder(recorded.packets[0], "XT16", {{angles, angles}});
    EXPECT_THAT(unsure->describe_product(), test::Names("sheet"));
    others.is_named = true;
    const DecoderCalibration named{{others}};
    EXPECT_THROW(make_decoder(recorded.packets[0], "XT16", named), DataError);
}

TEST(BlockPackets, AngleFilesHaveEachLaser) {
    const AngleCorrection angles =
        packets::parse_angles("eeff,1,1\nLaser id,Elevation,Azimuth\n1,2,0.5\n2,-1.5,-3\n", "a.csv");
    ASSERT_EQ(angles.lasers.size(), 2u);
    EXPECT_EQ(angles.lasers[1].elevation_deg, -1.5);
    EXPECT_EQ(angles.lasers[1].azimuth_deg, -3.0);
    for (const char* lines : {"1,2,0\n3,1,0\n", "1,95,0\n", "1,2,north\n"})
        EXPECT_THROW(packets::parse_angles("Channel,Elevation,Azimuth\n" + std::string(lines), "a.csv"),
                     DataError);
}

TEST(BlockPackets, AngleFilesNextToABag) {
    namespace fs = std::filesystem;
    const fs::path folder = fs::path(testing::TempDir()) / "angle_files";
    fs::remove_all(folder);
    fs::create_directories(folder / "drive");
    const auto write = [&](const char* name, const char* text) { std::ofstream(folder / name) << text; };
    const fs::path recording = folder / "drive" / "drive_0.db3";
    write("drive/metadata.yaml", "");
    write("poses.csv", "time,x,y\n1,2,3\n");
    write("damaged.csv", "Laser id,Elevation,Azimuth\n1,2,north\n");
    const auto damaged = packets::find_angle_files({recording});
    ASSERT_EQ(damaged.size(), 1u) << "poses.csv has no angles";
    EXPECT_TRUE(damaged[0].lasers.empty());
    EXPECT_NE(damaged[0].problem.find("'1,2,north'"), std::string::npos);
    write("PandarXT.csv", "Channel,Elevation,Azimuth\n1,2,0\n2,1,0\n");
    const auto any = packets::find_angle_files({recording});
    ASSERT_EQ(any.size(), 2u);
    EXPECT_EQ(any[0].where, "PandarXT.csv");
    EXPECT_EQ(any[0].problem, "");
    EXPECT_FALSE(any[0].is_named);
    write("drive.csv", "Laser id,Elevation,Azimuth\n1,3,0\n");
    const auto named = packets::find_angle_files({recording});
    ASSERT_EQ(named.size(), 1u);
    EXPECT_TRUE(named[0].is_named);
    EXPECT_EQ(named[0].lasers.size(), 1u);
    write("drive.csv", "Laser id,Elevation,Azimuth\n2,3,0\n");
    EXPECT_THROW(packets::find_angle_files({recording}), DataError);
}

/// Written byte by byte from the manual. The range value of a laser is its index.
std::string make_ot128_packet(int mode, int azimuth_state) {
    std::string bytes("\xee\xff\x01\x04\0\0\x80\x02\0\x04\x01\x07", 12);
    for (int block = 0; block < 2; ++block) {
        bytes += char(0x28);
        bytes += char(0x23 + block);  // 90.00 degrees, then 92.56 degrees
        for (int laser = 0; laser < 128; ++laser) {
            bytes += char(laser);
            bytes += '\0';
            bytes += char(200);
        }
    }
    bytes.append(4 + 17 + 9, '\0');
    bytes += '\0';
    bytes += char(azimuth_state);
    bytes += char(mode);
    bytes += char(0x37);
    bytes.append(2 + 6, '\0');
    bytes.append("\x40\x42\x0f\0", 4);  // 1 000 000 us
    bytes.resize(861);
    return bytes;
}

TEST(BlockPackets, Ot128) {
    const std::string standard = make_ot128_packet(1, 0), fine = make_ot128_packet(0, 0x10);
    const auto all = make_decoder(standard, "OT128"), states = make_decoder(fine, "OT128 in high resolution");
    ASSERT_TRUE(all && states);
    const packets::DecodedPacket packet = all->decode_packet(standard);
    ASSERT_EQ(packet.firings.size(), 2u);
    EXPECT_EQ(packet.clock_ns, 1000000000);
    EXPECT_NEAR(packet.firings[0].azimuth_deg, 0.0, 1e-9);
    EXPECT_NEAR(packet.firings[1].azimuth_deg, 2.56, 1e-9);
    EXPECT_NEAR(packet.firings[1].after_us, 43.346 + 2.378, 1e-9);
    EXPECT_NEAR(packet.firings[0].after_us, 43.346 + 2.378 - 2 * 27.778, 1e-3);
    // Laser 1 is the highest laser. The sensor uses range values up to 3 as special
    // marks.
    EXPECT_EQ(packet.echoes[0][0].range_m, 0.0f);
    std::size_t n_returns = 0;
    for (std::size_t ring = 0; ring < 128; ++ring) n_returns += packet.echoes[ring][0].range_m > 0.0f;
    EXPECT_EQ(n_returns, 124u);
    EXPECT_NEAR(all->timing().offset_us[0], 49.758 - 2.378, 1e-9);
    // 29 lasers do not fire in state 0, and 31 different lasers do not fire in state 1
    EXPECT_EQ(states->timing().offset_us.size(), 256u - 29u - 31u);
    const packets::DecodedPacket half = states->decode_packet(fine);
    EXPECT_EQ(half.firings[0].sequence, 0);
    EXPECT_EQ(half.firings[1].sequence, 1);
}

TEST(BlockPackets, TheTwoBrightestOfThreeReturns) {
    std::string bytes = read_recorded("xt32m").packets.at(0);
    bytes[802] = '\x3d';  // three returns
    constexpr std::size_t kBlock = 2 + 32 * 4;
    const auto set = [&](int block, int laser, int range, int reflectivity) {
        char* unit = &bytes[12 + std::size_t(block) * kBlock + 2 + std::size_t(laser) * 4];
        unit[0] = char(range & 255);
        unit[1] = char(range >> 8);
        unit[2] = char(reflectivity);
    };
    const int returns[3][3][2] = {{{1000, 10}, {1200, 30}, {1400, 20}},  // the first is the darkest
                                  {{1000, 30}, {1200, 20}, {1200, 25}},  // two are the same
                                  {{0, 0}, {0, 0}, {1400, 20}}};         // only the third return
    for (int laser = 0; laser < 3; ++laser)
        for (int block = 0; block < 3; ++block)
            set(block, laser, returns[laser][block][0], returns[laser][block][1]);
    const auto decoder = make_decoder(bytes, "XT32M");
    ASSERT_TRUE(decoder);
    const packets::DecodedPacket packet = decoder->decode_packet(bytes);
    ASSERT_EQ(packet.firings.size(), 2u);
    const double unit_m = 0.005;
    const int expected[3][2] = {{1400, 1200}, {1000, 1200}, {1400, 0}};
    for (std::size_t ring = 0; ring < 3; ++ring)
        for (std::size_t k = 0; k < 2; ++k)
            EXPECT_NEAR(packet.echoes[ring][k].range_m, unit_m * expected[ring][k], 1e-6) << ring << k;
}

/// Written byte by byte from the manual. The first azimuth is 90 degrees, in steps of
/// 0.4.
std::string make_rs16_packet() {
    std::string bytes("\x55\xaa\x05\x0a\x5a\xa5\x50\xa0", 8);
    bytes.resize(26);
    bytes.append("\x01\x02\x00\x07\x01", 5);  // 258 ms and 7 us; model 1
    bytes.resize(42);
    for (int block = 0; block < 12; ++block) {
        const int azimuth = 9000 + 40 * block;
        bytes += "\xff\xee";
        bytes += char(azimuth >> 8);
        bytes += char(azimuth & 255);
        for (int laser = 0; laser < 32; ++laser) {
            bytes += '\x03';
            bytes += char(laser);
            bytes += char(51);
        }
    }
    bytes.resize(1248);
    return bytes;
}

TEST(BlockPackets, RsLidar16) {
    const std::string bytes = make_rs16_packet();
    const auto decoder = make_decoder(bytes, "RS-LiDAR-16");
    ASSERT_TRUE(decoder);
    const packets::DecodedPacket packet = decoder->decode_packet(bytes);
    ASSERT_EQ(packet.firings.size(), 24u);
    EXPECT_EQ(packet.clock_ns, 258007000);
    EXPECT_NEAR(packet.firings[0].azimuth_deg, 90.0, 1e-9);
    EXPECT_NEAR(packet.firings[1].azimuth_deg, 90.2, 1e-9);
    EXPECT_NEAR(packet.firings[23].azimuth_deg, 94.6, 1e-9);
    EXPECT_NEAR(packet.firings[23].after_us, 23 * 55.5, 1e-9);
    // ring 0 is laser 9 at +15 degrees, ring 15 is laser 1 at -15 degrees
    const std::vector<Beam> beams = decoder->make_sensor(1800, kStill_hz).beams;
    EXPECT_NEAR(beams[0].elevation_rad / kDegree, 15.0, 1e-9);
    EXPECT_NEAR(decoder->timing().offset_us[0], 8 * 2.8, 1e-9);
    EXPECT_NEAR(packet.echoes[0][0].range_m, 0.005 * (0x300 + 8), 1e-6);
    EXPECT_NEAR(packet.echoes[16 + 15][0].range_m, 0.005 * (0x300 + 16), 1e-6);
    EXPECT_NEAR(packet.echoes[15][0].intensity, 0.2, 1e-6);
}

/// @param step_us time from packet to packet
std::vector<std::string> rs16_packets(int step_us) {
    std::vector<std::string> packets;
    for (int k = 0; k < 8; ++k) {
        std::string bytes = make_rs16_packet();
        const int us = 998'000 + k * step_us;  // passes the end of a second
        const int ms = us / 1000 % 1000, rest = us % 1000;
        bytes.replace(26, 4, {char(ms >> 8), char(ms & 255), char(rest >> 8), char(rest & 255)});
        packets.push_back(bytes);
    }
    return packets;
}

TEST(BlockPackets, RsLidar16WithTwoReturns) {
    const auto have_two = [](const std::vector<std::string>& all) {
        std::vector<packets::ReceivedPacket> views;
        for (const std::string& bytes : all) views.push_back({0, bytes});
        return packets::is_dual_rs16(views);
    };
    // A packet has 12 blocks. They contain 24 firings of 55.5 us each, or 12 firings with
    // two returns each.
    EXPECT_FALSE(have_two(rs16_packets(24 * 55 + 12)));
    EXPECT_TRUE(have_two(rs16_packets(12 * 55 + 6)));
    std::vector<std::string> twice;
    for (const std::string& bytes : rs16_packets(24 * 55 + 12)) twice.insert(twice.end(), 2, bytes);
    EXPECT_FALSE(have_two(twice)) << "packets that were received twice have one return";
    const std::string bytes = make_rs16_packet();
    const auto decoder = make_decoder(bytes, "RS-LiDAR-16", {.has_two_returns = true});
    ASSERT_TRUE(decoder);
    const packets::DecodedPacket packet = decoder->decode_packet(bytes);
    ASSERT_EQ(packet.firings.size(), 12u);
    EXPECT_NEAR(packet.firings[1].azimuth_deg, 90.4, 1e-9);
    EXPECT_NEAR(packet.firings[11].after_us, 11 * 55.5, 1e-9);
    EXPECT_NEAR(packet.echoes[0][0].range_m, 0.005 * (0x300 + 8), 1e-6);
    EXPECT_NEAR(packet.echoes[0][1].range_m, 0.005 * (0x300 + 24), 1e-6);
}

TEST(BlockPackets, OtherRoboSenseSensorsAreRefusedByName) {
    const auto with = [](std::string bytes, std::size_t at, const std::string& part) {
        return bytes.replace(at, part.size(), part);
    };
    const std::string old = make_rs16_packet(), later = with(std::string(1248, '\0'), 0, "\x55\xaa\x05\x5a");
    const std::string solid = with(std::string(1210, '\0'), 0, "\x55\xaa\x5a\xa5");
    const std::pair<std::string, std::string> cases[] = {
        {with(old, 30, "\x02"), "RS-LiDAR-32"},
        {with(old, 31, "\x03"), "RS-BPearl"},
        {with(old, 31, "\x09"), "RoboSense"},
        {with(with(later, 42, "\xff\xee"), 142, "\xff\xee"), "RS-Helios"},
        {with(with(later, 42, "\xff\xee"), 190, "\xff\xee"), "RS-Airy"},
        {with(with(later, 80, "\xfe"), 468, "\xfe"), "RS-Ruby-128"},
        {solid, "RS-LiDAR-M1"},
    };
    for (const auto& [bytes, name] : cases) {
        const packets::LidarProduct* product = packets::find_product(bytes, {});
        ASSERT_TRUE(product) << name;
        EXPECT_FALSE(product->make) << name;
        const std::string text = packets::unsupported_text(product, bytes);
        for (const std::string& part :
             {"packets of a " + name, std::string("55 AA"), std::string("RS-LiDAR-16")})
            EXPECT_THAT(text, testing::HasSubstr(part));
    }
}

}  // namespace
}  // namespace relidar
