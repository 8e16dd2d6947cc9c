// SPDX-License-Identifier: Apache-2.0
// Packets of an Ouster have nothing that tells whose they are, and how they are laid out
// is configured: its metadata says both.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar::packets {

/// How the pixels of a column are laid out, by `udp_profile_lidar`.
struct OusterProfile {
    const char* name;
    /// no head and no foot of a packet; a column has a head of 16 bytes and 4 of status
    /// behind its pixels
    bool is_legacy;
    std::size_t pixel_bytes;
    /// of the 4 bytes of a return that begin with its range, those that are the range
    std::uint32_t range_bits;
    double range_unit_m;
    std::size_t reflectivity_at;  ///< from the first of these bytes
    bool is_wide;                 ///< 2 bytes of reflectivity, not 1
    int returns;                  ///< the second one's bytes are behind the first one's
};

/// What the metadata of one sensor tells.
struct OusterFormat {
    std::string text;     ///< the metadata
    std::string where;    ///< file or topic that it is from
    std::string product;  ///< "OS-1-128"
    const OusterProfile* profile = nullptr;
    int columns_per_packet = 0;
    std::size_t packet_bytes = 0;
    int port = 0;                      ///< to which packets are sent; 0: not known
    std::uint64_t serial = 0;          ///< 0: not known
    std::vector<bool> fires;           ///< [columns of a turn] false: outside of column_window
    SpinningSensor sensor;             ///< rings the highest first
    std::vector<std::size_t> ring_of;  ///< [pixels of a column]

    std::string about() const;  ///< "packets of 12544 bytes (profile, beams, columns a packet, port)"
};
using OusterFormats = std::vector<std::shared_ptr<const OusterFormat>>;

/// Whether a text is meant as the metadata of an Ouster, whatever is wrong with it.
bool is_ouster_metadata(std::string_view text);
/// @param where  file or topic, for messages @throws DataError
std::shared_ptr<const OusterFormat> read_ouster_metadata(const std::string& text, const std::string& where);
/// Of files beside a recording: X.json and X*.json of X.pcap, else all in the folder that
/// are of no other recording.
/// @param broken  what is wrong with those that cannot be read
OusterFormats ouster_metadata_beside(const std::filesystem::path& recording,
                                     std::vector<std::string>& broken);

/// The metadata of the sensor that sent a packet: of those that say its size, and no
/// other port unless the serial number in the packet's head is theirs, the one for its
/// topic (the port of a capture's, the name space of a bag's), else for the serial
/// number.
/// @return null where there is none, or several remain
std::shared_ptr<const OusterFormat> format_of(const OusterFormats& formats, std::string_view topic,
                                              std::string_view packet);
/// Whether packets of so many bytes may be an Ouster's, of any profile that is decoded.
bool is_ouster_size(std::size_t bytes);
/// Why packets that look like an Ouster's are not decoded, and what to do about it.
/// @param formats  that are known
/// @param recording  beside which more of them would be looked for
std::string ouster_text(const OusterFormats& formats, const std::filesystem::path& recording,
                        std::string_view topic, std::size_t bytes);

}  // namespace relidar::packets
