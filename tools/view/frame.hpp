// SPDX-License-Identifier: Apache-2.0
// Scans as binary messages. This is the one place that says how they look; page/frame.js
// reads them.
//   bytes 0..3   "RLV1"
//   bytes 4..7   length h of the header, little-endian, a multiple of 4
//   h bytes      JSON, padded with blanks: what the scan is, and "arrays": [{name, type, components, count, offset}]
//   the rest     the arrays, each at `offset` from the end of the header, a multiple of 4; type f32, i32, u8 or u16, little-endian
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

/// Columns of one scan, entry i of each of ray i. Probabilities and intensities are in
/// steps of 1/255.
struct ScanColumns {
    int rows = 0, columns = 0;                 ///< rows = 1: no image
    std::vector<glm::vec3> position_m = {};    ///< [n] relidar's world
    std::vector<float> range_m = {};           ///< [n] 0 where nothing came back or was met
    std::vector<std::uint8_t> intensity = {};  ///< [n]
    std::vector<std::uint8_t> drop = {};       ///< [n] probability; a real scan has 0 and 255 alone
    /// [n] index into the instances that the scan names, 65535 where there is none; or
    /// empty
    std::vector<std::uint16_t> instance = {};
    std::vector<std::uint16_t> ring = {};    ///< [n]
    std::vector<ScanChannel> channels = {};  ///< [n] each; arrays "channel_NAME"
};

/// What was simulated. @param world_offset_m  of the dataset's world, see Sequence
ScanColumns simulated_columns(const RenderedScan& scan, const Config& config,
                              const glm::dvec3& world_offset_m);
/// What the log measured. @param frame with its scan
ScanColumns measured_columns(const Sequence& sequence, const Frame& frame);

/// 16 numbers of a matrix, a column after the other, as WebGL takes them.
nlohmann::json matrix_json(const Pose& pose);

/// @param header  of the scan, without "arrays" @param simulated,measured  or nothing;
/// arrays of the latter are called "real_..."
std::string encode_frame(nlohmann::json header, const ScanColumns* simulated, const ScanColumns* measured);

}  // namespace relidar::view
