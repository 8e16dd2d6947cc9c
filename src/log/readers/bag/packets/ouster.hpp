// SPDX-License-Identifier: Apache-2.0
// Metadata of Ouster sensors. Ouster packets neither identify the product nor describe
// their layout, which is configurable. The metadata contains both.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar::packets {

/// Layout of the pixels in a packet for one value of the setting `udp_profile_lidar`.
struct OusterProfile {
    const char* name;
    /// True: packets have no header and no footer. Each column has a header of 16 bytes,
    /// and a status of 4 bytes after its pixels.
    bool is_legacy;
    std::size_t pixel_bytes;
    /// Bit mask of the range in the first 4 bytes of a pixel.
    std::uint32_t range_bits;
    double range_unit_m;
    /// byte offset of the reflectivity, from the start of the pixel's range word
    std::size_t reflectivity_at;
    bool is_wide;  ///< true: reflectivity has 2 bytes instead of 1
    int returns;   ///< number of returns; the bytes of the second return follow those of the first
};

/// Content of the metadata of one sensor.
struct OusterFormat {
    std::string text;     ///< text of the metadata
    std::string where;    ///< file or topic of the metadata
    std::string product;  ///< name of the product, such as "OS-1-128"
    const OusterProfile* profile = nullptr;
    int columns_per_packet = 0;
    std::size_t packet_bytes = 0;
    int port = 0;              ///< port to which packets are sent; 0: unknown
    std::uint64_t serial = 0;  ///< serial number of the sensor; 0: unknown
    /// [columns per revolution] false: the column is outside the configured azimuth
    /// window
    std::vector<bool> fires;
    SpinningSensor sensor;             ///< highest ring first
    std::vector<std::size_t> ring_of;  ///< [pixels of a column] ring of each pixel

    /// returns a description such as "packets of 12544 bytes (profile, beams, columns a
    /// packet, port)"
    std::string about() const;
};
using OusterFormats = std::vector<std::shared_ptr<const OusterFormat>>;

/// Returns true if a text looks like the metadata of an Ouster. The metadata may still be
/// invalid.
bool is_ouster_metadata(std::string_view text);
/// Parses the metadata of an Ouster.
/// @param where  file or topic for error messages
/// @throws DataError if the metadata is invalid
std::shared_ptr<const OusterFormat> read_ouster_metadata(const std::string& text, const std::string& where);
/// Reads the metadata files in the folder of a recording. If the recording is X.pcap and
/// X.json exists, these are X.json and X*.json. Otherwise they are all files that do not
/// belong to another recording.
/// @param broken  output: error messages of files that cannot be read
OusterFormats find_ouster_metadata(const std::filesystem::path& recording, std::vector<std::string>& broken);

/// Returns the metadata of the sensor that sent a packet. The packet size must match. The
/// port must also match, unless the packet's header has the serial number of the
/// metadata. Metadata of the same topic is preferred (port of a capture, namespace of a
/// bag), then metadata with the same serial number.
/// @return null if no metadata remains, or more than one
std::shared_ptr<const OusterFormat> format_of(const OusterFormats& formats, std::string_view topic,
                                              std::string_view packet);
/// Returns true if an Ouster with a supported profile can send packets of this size.
bool is_ouster_size(std::size_t bytes);
/// Returns an error text for packets that are probably from an Ouster but cannot be
/// decoded. The text tells the user what to do.
/// @param formats  metadata that was read
/// @param recording  recording in whose folder the user can put more metadata
std::string ouster_text(const OusterFormats& formats, const std::filesystem::path& recording,
                        std::string_view topic, std::size_t bytes);

}  // namespace relidar::packets
