// SPDX-License-Identifier: Apache-2.0
// Reads the metadata of Ouster sensors. The user can configure the layout of Ouster
// packets. Only the metadata contain the product and the layout.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <relidar/log/sensor.hpp>

namespace relidar::packets {

/// Layout of the pixels in an Ouster packet, as set by `udp_profile_lidar`.
struct OusterProfile {
    const char* name;
    /// True for legacy packets, which have no header and no footer. Their columns have a
    /// header of 16 bytes and a status of 4 bytes at the end.
    bool is_legacy;
    std::size_t pixel_bytes;
    std::uint32_t range_bits;  ///< bit mask of the range in the first 4 bytes of a pixel
    double range_unit_m;
    std::size_t reflectivity_at;  ///< byte offset from the range of a return
    bool is_wide;                 ///< true if the reflectivity has 2 bytes, false if it has 1 byte
    int returns;                  ///< number of returns; the second return is stored directly after the first
};

struct OusterMetadata {
    std::string text;
    std::string where;    ///< file or topic
    std::string product;  ///< name of the product, for example "OS-1-128"
    const OusterProfile* profile = nullptr;
    int columns_per_packet = 0;
    std::size_t packet_bytes = 0;
    int port = 0;              ///< UDP port; 0 if unknown
    std::uint64_t serial = 0;  ///< 0 if unknown
    /// [columns per revolution] true if the sensor fires at this column (azimuth window)
    std::vector<bool> fires;
    SpinningSensor sensor;             ///< highest ring first
    std::vector<std::size_t> ring_of;  ///< [pixels of a column] ring to which each pixel belongs

    std::string describe() const;
};
using MetadataList = std::vector<std::shared_ptr<const OusterMetadata>>;

/// Returns true if a text looks like metadata of an Ouster sensor, valid or not.
bool is_metadata(std::string_view json_text);
/// Parses the metadata of an Ouster sensor.
/// @param place  name of the file or topic, for error messages
/// @throws DataError if the metadata is invalid
std::shared_ptr<const OusterMetadata> parse_metadata(const std::string& json_text, const std::string& place);
/// Reads the Ouster metadata (JSON files) in the folder of a recording, for example
/// "a.pcap". If "a.json" contains metadata, reads only JSON files whose names begin with
/// "a". Never reads "b.json" if the folder contains another recording, "b.pcap".
/// @param errors  output: error messages about files that cannot be read
MetadataList read_metadata_files(const std::filesystem::path& recording, std::vector<std::string>& errors);

/// Returns the metadata of the sensor that sent a packet, or null if it is ambiguous. The
/// packet size and the port must match. The port may differ if the serial number matches,
/// or if a LEGACY layout is the only metadata. Prefers metadata of the same topic (port
/// of a capture, namespace of a bag), then with the same serial number.
std::shared_ptr<const OusterMetadata> find_metadata(const MetadataList& metadata_list, std::string_view topic,
                                                    std::string_view packet);
/// Returns true if a supported layout of an Ouster can have packets of this size.
bool is_ouster_size(std::size_t n_bytes);
/// Returns the error message for packets that look like Ouster packets, but cannot be
/// decoded.
std::string ouster_error(const MetadataList& metadata_list, const std::filesystem::path& recording_path,
                         std::string_view topic, std::size_t packet_size);

}  // namespace relidar::packets
