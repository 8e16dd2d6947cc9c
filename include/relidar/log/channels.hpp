// SPDX-License-Identifier: Apache-2.0
// Channels: the values that a scan stores for each ray, such as range and intensity.
// Scans, files, the gRPC service, the viewer and the Python module all use the list of
// channels in this file. docs/architecture.md explains how to add a channel.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// Rule for combining the values of several rays into one value. Rays are combined in two
/// cases: sub-rays sample the same laser beam, or points fall into the same cell of a
/// range image.
enum class ChannelMergeRule {
    /// Beam: the sub-ray nearest to the beam axis, among those that hit the surface of
    /// the strongest return. Cell: the returned point nearest to the sensor.
    nearest,
    /// Beam: the mean of the sub-rays that hit the surface of the strongest return,
    /// weighted by their power. Cell: the distance of the nearest returned point from the
    /// image origin.
    range,
    /// Beam: the sum over the sub-rays that hit the surface of the strongest return,
    /// divided by the number of all sub-rays. Cell: the nearest returned point.
    intensity,
    drop,  ///< Beam: mean over all sub-rays. Cell: minimum over all rays in the cell.
};

/// Description of a channel.
struct ChannelInfo {
    std::string name;          ///< name in files: lower case letters, digits and _
    std::string unit = {};     ///< unit; empty for a plain number
    std::string meaning = {};  ///< text for users: a sentence without a full stop
    /// Rule for channels of floats. Channels of integers or vectors always use `nearest`.
    ChannelMergeRule join = ChannelMergeRule::nearest;
    /// True for direction vectors, which rotate with the frame of the points.
    bool turns = false;
    /// True if all returns of a ray have the same value.
    bool of_ray = false;
    /// Value where the true value is unknown, for example if the ray hits nothing.
    double none = 0.0;
    /// True if the channel needs normals, which 3D Gaussians do not have.
    bool needs_normals = false;
};

/// Values of a channel: a vector of n floats, integers or 3D vectors, with one entry for
/// each ray or point.
using ChannelValues = std::variant<std::vector<float>, std::vector<std::int32_t>, std::vector<glm::vec3>>;

/// A channel of a scan or a point cloud, with its values. The values are rendered by
/// relidar or provided by the caller.
struct ScanChannel {
    ChannelInfo info;
    ChannelValues values;
    /// Values of the second returns, one for each ray. Empty if the channel does not
    /// store separate values for second returns.
    ChannelValues second = {};
};

/// Descriptions of the basic channels, which every scan has.
struct BasicChannels {
    ChannelInfo range, median_range, mean_range, intensity, drop_prob, weight, time, ring, instance;
};
/// Returns a reference to a static object.
const BasicChannels& basic_channels();
/// Returns the basic channels that are written to files, in the order of their columns in
/// the files.
std::vector<ChannelInfo> file_channels();
/// Returns the channels that the setting `render.channels` can enable.
const std::vector<ChannelInfo>& optional_channels();
/// Returns the names of the channels in `optional_channels()`, in the same order.
std::vector<std::string> optional_names();

/// Parses a comma-separated list of channel names, and removes duplicates.
/// @throws UsageError for an unknown name; the message suggests the most similar known
/// name
std::vector<ChannelInfo> parse_channels(const std::string& comma_separated_names);

/// Returns the values of the channel with this name, or null if no channel has this name
/// or its values have another type than T.
template <class T>
const std::vector<T>* find_values(const std::vector<ScanChannel>& channels, const std::string& channel_name) {
    for (const ScanChannel& channel : channels)
        if (channel.info.name == channel_name) return std::get_if<std::vector<T>>(&channel.values);
    return nullptr;
}

/// Returns the number of values of a channel: one for each ray or point.
std::size_t count_values(const ChannelValues& values);

/// Returns a copy of the channels with the same names and types, but without values.
std::vector<ScanChannel> copy_layout(const std::vector<ScanChannel>& channels);

/// A column of numbers in a file, float32 or int32. A channel of scalars is written as
/// one column, for example "instance". A channel of vectors is written as three columns,
/// for example "normal_x", "normal_y" and "normal_z".
struct ChannelColumn {
    std::string name;
    bool is_integer;
};
/// Returns the columns that the channels occupy in a file. append_values() writes
/// the numbers in the same order.
/// @param axis_separator  text between the name of a vector channel and its axis, for
/// example "_" in "normal_x"
std::vector<ChannelColumn> list_columns(const std::vector<ScanChannel>& channels,
                                        const std::string& axis_separator = "_");
/// Appends the values of all channels for one ray or point to `output_bytes`. Each number
/// takes 4 bytes in the byte order of the machine.
/// @param index  index of the ray or point in the arrays of the channels
void append_values(std::string& output_bytes, const std::vector<ScanChannel>& channels, std::size_t index);

/// Returns the value where the true value is unknown.
template <class T>
T empty_value(const ChannelInfo& channel) {
    return T(float(channel.none));
}

/// Appends the value of one return to a channel of points. For a second return, this is
/// the value in `ScanChannel::second`. If that array is empty, it is the value of the
/// first return for a channel with `ChannelInfo::of_ray`, otherwise `ChannelInfo::none`.
/// @param return_number_from_1  number of the return, starting at 1
void append_return(ScanChannel& points, const ScanChannel& rays, std::size_t ray, int return_number_from_1);

/// Checks names and sizes of channels before the channels are written to a file.
/// @param size  expected number of values
/// @param element  name of the elements in error messages, for example
/// rays or points
/// @throws DataError if a name is invalid or used twice, or if a channel does not have
/// `size` values
void check_channels(const std::vector<ScanChannel>& channels, std::size_t size, const std::string& element);

}  // namespace relidar
