// SPDX-License-Identifier: Apache-2.0
// Encodes scans as binary messages for the web page. This file defines the format, and
// page/frame.js decodes it.
//   bytes 0..3   "RLV1"
//   bytes 4..7   length h of the header, little-endian, a multiple of 4
//   h bytes      JSON, padded with spaces: text of the scan, and
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
struct Log;
struct Frame;
}  // namespace relidar

namespace relidar::view {

/// Element i of each array belongs to ray i. Probabilities and intensities are 0 to 255.
struct ScanColumns {
    /// Size of the range image. `rows` is 1 if the rays do not form an image.
    int rows = 0, columns = 0;
    /// [n] end points of the rays in relidar's world frame, metres.
    std::vector<glm::vec3> position_m = {};
    /// [n] ranges in metres. The range is 0 if the ray has no return.
    std::vector<float> range_m = {};
    std::vector<std::uint8_t> intensity = {};  ///< [n] intensities.
    /// [n] probability of no return, 0 to 255. 0 or 255 in a measured scan.
    std::vector<std::uint8_t> drop = {};
    /// [n] index in the object list of the header, or 65535 for no object. May be empty.
    std::vector<std::uint16_t> instance = {};
    std::vector<std::uint16_t> ring = {};  ///< [n] beam numbers.
    /// [n] values each, in arrays named "channel_NAME".
    std::vector<ScanChannel> channels = {};
};

/// Converts a simulated scan to the arrays of a message, with all rays.
/// @param world_offset_m from relidar's world frame to the dataset's
ScanColumns simulated_columns(const RenderedScan& scan, const Config& config,
                              const glm::dvec3& world_offset_m);
/// Converts a measured scan to the arrays of a message. With rolling shutter, each ray
/// starts at the pose of its own firing time.
ScanColumns measured_columns(const Log& log, const Frame& frame);

/// 4x4 matrix in column-major order, as WebGL expects.
nlohmann::json pose_json(const Pose& pose);

/// Encodes a simulated scan, a measured scan, or both (the other is null) as a message.
/// @param header without the key "arrays"
/// @param simulated, measured names of measured arrays begin with "real_"
std::string encode_scans(nlohmann::json header, const ScanColumns* simulated, const ScanColumns* measured);

}  // namespace relidar::view
