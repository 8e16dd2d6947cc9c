// SPDX-License-Identifier: Apache-2.0
// Decodes packets of an Ouster sensor that the test writes byte by byte from the firmware
// user manual.
#include <array>
#include <string>
#include <string_view>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "log/readers/bag/packets/decoder.hpp"
#include "log/readers/bag/packets/ouster.hpp"
#include "log/readers/bag/packets/ouster_packets.hpp"

namespace relidar {
namespace {

std::string parse_hex(std::string_view text) {
    std::string bytes;
    for (std::size_t k = 0; k < text.size(); ++k)
        if (text[k] != ' ') bytes += char(std::stoi(std::string(text.substr(k++, 2)), nullptr, 16));
    return bytes;
}

/// Packet of a sensor with two beams. The lower beam is the first beam, and the beam
/// origins are 10 mm from the axis. A packet has two columns and a turn has four columns.
/// This packet contains the last two columns.
struct Written {
    const char *profile, *head, *first, *second, *foot;  ///< columns without their time stamps
    std::array<packets::DecodedReturn, 2> lower, upper;  ///< echoes of the first column
};
// 28 bytes
constexpr std::string_view kZeros = "00000000 00000000 00000000 00000000 00000000 00000000 00000000";
const Written kAllWritten[] = {
    {test::kLegacy,
     "",
     "0200 0700 00B00000 88131000 6400 F401 1000 0000 00000000 0700 0000 0000 0000 FFFFFFFF",
     "0300 0700 00080100 88130000 6400 F401 1000 0000 D0070000 0100 0000 0000 0000 FFFFFFFF",
     "",
     {{{4.99f, 100 / 255.0f}, {}}},
     {}},
    {test::kSingle,
     "01000700",
     "0200 0100 88130000 64 00 F401 1000 0000 00000000 07 00 0000 0000 0000",
     "0300 0100 E0930400 FF 00 F401 1000 0000 D0070000 01 00 0000 0000 0000",
     "00000000",
     {{{4.99f, 100 / 255.0f}, {}}},
     {}},
    {test::kDual,
     "0100FFFF",
     "0200 0100 881300 64 701700 C8 0000 0000 1000 0000 D00700 05 000000 00 0000 0000 0000 0000",
     "0300 0100 881300 64 701700 C8 0000 0000 1000 0000 D00700 05 000000 00 0000 0000 0000 0000",
     "00000000",
     {{{4.99f, 100 / 255.0f}, {5.99f, 200 / 255.0f}}},
     {{{1.99f, 5 / 255.0f}, {}}}},
    {test::kLowRate,
     "01FFFFFF",
     "0200 0100 7102 64 09 0000 FF 09",
     "0300 0100 7102 64 09 FA00 64 09",
     "00000000",
     {{{4.99f, 100 / 255.0f}, {}}},
     {}},
};

std::string bytes_of(const Written& written) {
    const bool has_head = *written.head != '\0';
    return parse_hex(written.head) + (has_head ? parse_hex(kZeros) : "") + parse_hex("40420F0000000000") +
           parse_hex(written.first) + parse_hex("80BA8C0100000000") + parse_hex(written.second) +
           parse_hex(written.foot) + (has_head ? parse_hex(kZeros) : "");
}

TEST(OusterBytes, ByHandAreWhatTheManualSays) {
    for (const Written& written : kAllWritten) {
        SCOPED_TRACE(written.profile);
        const auto format = packets::parse_ouster_metadata(
            fmt::format(
                R"({{"beam_altitude_angles": [-1, 1], "beam_azimuth_angles": [0, 0], "lidar_origin_to_beam_origin_mm": 10,
                "lidar_mode": "4x10", "data_format": {{"columns_per_packet": 2, "udp_profile_lidar": "{}"}}}})",
                written.profile),
            "metadata");
        const std::string bytes = bytes_of(written);
        const packets::DecoderCalibration calibration{{}, format};
        const packets::LidarProduct* product = packets::find_product_of_packet(bytes, calibration);
        ASSERT_TRUE(product) << bytes.size() << " bytes, expected " << format->packet_bytes;
        const packets::DecodedPacket packet = product->make(product->name, calibration)->decode_packet(bytes);
        ASSERT_EQ(packet.firings.size(), 2u);
        EXPECT_EQ(packet.clock_ns, 26000000);
        EXPECT_EQ(packet.firings[0].azimuth_deg, 0.0);  // forward
        EXPECT_EQ(packet.firings[1].azimuth_deg, 90.0);
        EXPECT_EQ(packet.firings[0].after_us, -25000.0);
        EXPECT_EQ(packet.firings[1].after_us, 0.0);
        ASSERT_EQ(packet.echoes.size(), 4u);
        for (std::size_t k = 0; k < 2; ++k) {
            EXPECT_NEAR(packet.echoes[1][k].range_m, written.lower[k].range_m, 1e-6);
            EXPECT_NEAR(packet.echoes[1][k].intensity, written.lower[k].intensity, 1e-6);
            EXPECT_NEAR(packet.echoes[0][k].range_m, written.upper[k].range_m, 1e-6);
            EXPECT_NEAR(packet.echoes[0][k].intensity, written.upper[k].intensity, 1e-6);
        }
        EXPECT_NEAR(packet.echoes[2][0].range_m, 1.99, 1e-6);  // second column, upper beam
    }
}

}  // namespace
}  // namespace relidar
