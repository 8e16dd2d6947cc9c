// SPDX-License-Identifier: Apache-2.0
// Metadata of an Ouster. Its packets do not identify the sensor, and their layout is
// configurable. The metadata contains both.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar::packets {

/// Layout of the pixels of a column, by `udp_profile_lidar`.
struct OusterProfile {
    const char* name;
    /// True: packets have no header and footer; a column has a header of 16 bytes, and 4
    /// bytes of status after its pixels.
    bool is_legacy;
    std::size_t pixel_bytes;
    /// Number of range bits in the 4 bytes that begin with the range.
    std::uint32_t range_bits;
    double range_unit_m;
    std::size_t reflectivity_at;  ///< offset of the reflectivity from the first of these bytes
    bool is_wide;                 ///< true: reflectivity has 2 bytes instead of 1
    int returns;                  ///< the bytes of the second return follow those of the first
};

/// Content of the metadata of one sensor.
struct OusterFormat {
    std::string text;     ///< text of the metadata
    std::string where;    ///< file or topic of the metadata
    std::string product;  ///< name of the product, such as "OS-1-128"
    const OusterProfile* profile = nullptr;
    int columns_per_packet = 0;
    std::size_t packet_bytes = 0;
    int port = 0;                      ///< port to which packets are sent; 0: unknown
    std::uint64_t serial = 0;          ///< serial number; 0: unknown
    std::vector<bool> fires;           ///< [columns per revolution] false: outside of column_window
    SpinningSensor sensor;             ///< highest ring first
    std::vector<std::size_t> ring_of;  ///< [pixels of a column] ring of each pixel

    std::string about() const;  ///< "packets of 12544 bytes (profile, beams, columns a packet, port)"
};
using OusterFormats = std::vector<std::shared_ptr<const OusterFormat>>;

/// Returns true if a text looks like the metadata of an Ouster, even if it is invalid.
bool is_ouster_metadata(std::string_view text);
/// Parses the metadata of an Ouster.
/// @param where  file or topic for error messages
/// @throws DataError if the metadata is invalid
std::shared_ptr<const OusterFormat> read_ouster_metadata(const std::string& text, const std::string& where);
/// Reads the metadata files next to a recording: X.json and X*.json for X.pcap, otherwise
/// all files in the folder that do not belong to another recording.
/// @param broken  output: problems of files that cannot be read
OusterFormats ouster_metadata_beside(const std::filesystem::path& recording,
                                     std::vector<std::string>& broken);

/// Returns the metadata of the sensor that sent a packet. Considers only metadata with
/// the packet's size, and with its port unless the serial number in the packet's header
/// matches. Prefers the metadata of the topic (the port of a capture, the namespace of a
/// bag), then the metadata with the serial number.
/// @return null if none or several remain
std::shared_ptr<const OusterFormat> format_of(const OusterFormats& formats, std::string_view topic,
                                              std::string_view packet);
/// Returns true if packets of this size may come from an Ouster with any supported
/// profile.
bool is_ouster_size(std::size_t bytes);
/// Explains why packets that look like Ouster packets are not decoded, and what to do.
/// @param formats  known metadata
/// @param recording  recording next to which more metadata can be placed
std::string ouster_text(const OusterFormats& formats, const std::filesystem::path& recording,
                        std::string_view topic, std::size_t bytes);

}  // namespace relidar::packets
