// SPDX-License-Identifier: Apache-2.0
// Encodes scans as binary messages. Only this file defines the format; page/frame.js
// reads it.
//   bytes 0..3   "RLV1"
//   bytes 4..7   length h of the header, little-endian, a multiple of 4
//   h bytes      JSON, padded with spaces: description of the scan, and
//                "arrays": [{name, type, components, count, offset}]
//   the rest     the arrays, each at `offset` from the end of the header, a multiple of 4;
//                type f32, i32, u8 or u16, little-endian
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include <glm/glm.hpp>
#include <nlohmann/json_fwd.hpp>

#include <relidar/base/math.hpp>
#include <relidar/log/channels.hpp>

namespace relidar {
struct RayTable;
struct RenderedScan;
struct Config;
struct Sequence;
struct Frame;
}  // namespace relidar

namespace relidar::view {

/// Columns of one scan. Entry i of each array belongs to ray i. Probabilities and
/// intensities are in steps of 1/255.
struct ScanColumns {
    int rows = 0, columns = 0;                 ///< Image size; rows = 1 if the rays do not form an image.
    std::vector<glm::vec3> position_m = {};    ///< [n] end points of the rays, in relidar's world frame.
    std::vector<float> range_m = {};           ///< [n] ranges; 0 if the ray has no return and hit nothing.
    std::vector<std::uint8_t> intensity = {};  ///< [n] intensities.
    /// [n] drop probabilities. A measured scan has only the values 0 and 255.
    std::vector<std::uint8_t> drop = {};
    /// [n] index into the instances that the header lists, 65535 for no instance. May be
    /// empty.
    std::vector<std::uint16_t> instance = {};
    std::vector<std::uint16_t> ring = {};  ///< [n] beam numbers.
    /// Additional channels, [n] values each, sent as arrays "channel_NAME".
    std::vector<ScanChannel> channels = {};
};

/// Returns the columns of a simulated scan.
/// @param world_offset_m offset of the dataset's world, see Sequence
ScanColumns simulated_columns(const RenderedScan& scan, const Config& config,
                              const glm::dvec3& world_offset_m);
/// Returns the columns of a measured scan.
/// @param frame frame with its scan
ScanColumns measured_columns(const Sequence& sequence, const Frame& frame);

/// Returns the 16 numbers of a matrix in column-major order, as WebGL expects them.
nlohmann::json matrix_json(const Pose& pose);

/// Encodes a message.
/// @param header JSON header of the scan, without "arrays"
/// @param simulated, measured columns or null; names of the measured arrays begin with
/// "real_"
std::string encode_frame(nlohmann::json header, const ScanColumns* simulated, const ScanColumns* measured);

}  // namespace relidar::view
