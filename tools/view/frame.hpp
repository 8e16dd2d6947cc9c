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

/// Arrays of one scan. Element i of each array belongs to ray i. Probabilities and
/// intensities are stored as integers from 0 to 255.
struct ScanColumns {
    /// Size of the range image. `rows` is 1 if the rays do not form an image.
    int rows = 0, columns = 0;
    /// [n] end points of the rays in relidar's world frame, metres.
    std::vector<glm::vec3> position_m = {};
    /// [n] ranges in metres. The range is 0 if the ray has no return and hit nothing.
    std::vector<float> range_m = {};
    std::vector<std::uint8_t> intensity = {};  ///< [n] intensities.
    /// [n] probability that the ray is dropped. In a measured scan each value is either 0
    /// or 255.
    std::vector<std::uint8_t> drop = {};
    /// [n] index of the hit instance in the list of the header. 65535 means that no
    /// instance was hit. May be empty.
    std::vector<std::uint16_t> instance = {};
    std::vector<std::uint16_t> ring = {};  ///< [n] beam numbers.
    /// Additional channels with [n] values each. They are sent as arrays named
    /// "channel_NAME".
    std::vector<ScanChannel> channels = {};
};

/// Returns the arrays of a simulated scan.
/// @param world_offset_m offset between relidar's world frame and the dataset's world
/// frame, see Sequence
ScanColumns simulated_columns(const RenderedScan& scan, const Config& config,
                              const glm::dvec3& world_offset_m);
/// Returns the arrays of a measured scan.
/// @param frame frame of the sequence, with its scan
ScanColumns measured_columns(const Sequence& sequence, const Frame& frame);

/// Returns the 4x4 matrix of a pose as 16 numbers in column-major order, as WebGL
/// expects.
nlohmann::json matrix_json(const Pose& pose);

/// Encodes a message with a simulated scan, a measured scan, or both.
/// @param header JSON header of the message, without "arrays"
/// @param simulated, measured arrays of each scan, or null. The names of measured arrays
/// begin with "real_".
std::string encode_frame(nlohmann::json header, const ScanColumns* simulated, const ScanColumns* measured);

}  // namespace relidar::view
