// SPDX-License-Identifier: Apache-2.0
// Follows the firmware user manual of the sensor ("Lidar Data", "Lidar Data Legacy").
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/math.hpp>

namespace relidar::test {

inline constexpr const char *kLegacy = "LEGACY", *kSingle = "RNG19_RFL8_SIG16_NIR16",
                            *kDual = "RNG19_RFL8_SIG16_NIR16_DUAL", *kLowRate = "RNG15_RFL8_NIR8",
                            *kLowRateDual = "RNG15_RFL8_NIR8_DUAL", *kFusa = "FUSA_RNG15_RFL8_NIR8_DUAL";

/// A column contains the simultaneous measurements of all beams.
struct OusterImages {
    std::string product = "OS-1-16", profile = kSingle;
    std::size_t frames = 0, rows = 0, columns = 0, per_packet = 16;
    std::vector<double> altitude_deg, azimuth_deg;  ///< [rows]
    double n_mm = 0.0;
    /// [frames, rows, columns]; the second returns may be empty
    std::vector<std::uint32_t> range_mm, reflectivity, range_2_mm, reflectivity_2;
    std::vector<std::uint64_t> time_ns;  ///< [frames, columns]
    /// [frames, columns] true for valid columns. If empty, all columns are valid.
    std::vector<bool> is_valid;
    /// Column window. If both are 0, the window contains all columns.
    std::size_t first = 0, last = 0;

    std::size_t at(std::size_t frame, std::size_t row, std::size_t column) const {
        return (frame * rows + row) * columns + column;
    }
    bool is_in_window(std::size_t column) const { return last == 0 || (column >= first && column <= last); }
    bool is_dual() const { return profile == kDual || profile == kLowRateDual || profile == kFusa; }
    bool is_low_rate() const { return profile == kLowRate || profile == kLowRateDual || profile == kFusa; }
    /// Returns the range as packets store it. Low data rate profiles use steps of 8 mm.
    std::uint32_t round_mm(std::uint32_t mm) const { return is_low_rate() ? mm / 8 * 8 : mm; }
    /// Ouster's equation. Column m of W columns has the encoder angle 2 pi (1 - m / W).
    glm::dvec3 compute_point(std::size_t row, std::size_t column, double mm) const;
};

/// Returns nothing if RELIDAR_SHARED (../shared) does not contain the file.
std::optional<OusterImages> load_real_images(const std::string& name, const std::string& product,
                                             const std::string& profile);

/// Second returns are 1.5 m behind every fifth first return, and may be brighter.
void add_second_returns(OusterImages& images);
/// Makes range images of a few beams in a room. Some pixels have no return.
OusterImages make_small_images(const std::string& profile);

/// A packet and the measurement time of its last column.
struct OusterPacket {
    std::uint64_t time_ns;
    std::string bytes;
};
/// Returns the packets that contain a column of the azimuth window, in order.
std::vector<OusterPacket> make_packets(const OusterImages& images);

/// @param is_nested if true, the JSON is nested (newer tools), otherwise flat
std::string make_metadata(const OusterImages& images, int port, bool is_nested = false);

/// A UDP datagram of a capture.
struct Datagram {
    std::int64_t stamp_ns;
    std::string bytes;
    int port = 7502;
};
/// Packets arrive 0.2 ms after their last column, every third up to 0.4 ms later.
/// @param ahead_ns clock of the recorder minus clock of the sensor
std::vector<Datagram> receive(const std::vector<OusterPacket>& packets, int port = 7502,
                              std::int64_t ahead_ns = 1700000000000000000);
void write_pcap(const std::filesystem::path& file, const std::vector<Datagram>& datagrams);

}  // namespace relidar::test
