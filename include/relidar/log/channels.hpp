// SPDX-License-Identifier: Apache-2.0
// Channels: the values that a scan stores for each ray. This file has the list of
// channels that scans, files, recordings, the gRPC service, the viewer and the Python
// module share. docs/architecture.md explains how to add a channel.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// How the values of several rays are combined into a single value. Used in two cases:
/// for the sub-rays of a beam, and for the rays whose points fall into the same cell of a
/// range grid.
enum class ChannelJoin {
    /// Beam: value of the sub-ray nearest to the beam axis, among the sub-rays of the
    /// strongest return. Cell: value of the ray that was selected for the cell.
    nearest,
    /// Beam: mean over the sub-rays of the strongest return, weighted by light. Cell:
    /// distance from the grid origin to the point of the selected ray.
    range,
    /// Beam: sum over the sub-rays of the strongest return, divided by the number of all
    /// sub-rays. Cell: value of the selected ray.
    intensity,
    drop,  ///< beam: mean over all sub-rays; cell: minimum over all rays in the cell
};

/// Description of a channel.
struct ChannelInfo {
    std::string name;          ///< name in files: lower case letters, digits and _
    std::string unit = {};     ///< unit; empty for a plain number
    std::string meaning = {};  ///< description for users: a sentence without a full stop
    /// rule for float values; integers and vectors always use `nearest`
    ChannelJoin join = ChannelJoin::nearest;
    /// the values are directions: they are rotated when the points change to another
    /// frame
    bool turns = false;
    bool of_ray = false;  ///< the value depends on the ray alone, so the second return has the same value
    /// Value if the ray hits nothing, for second returns, and for rays that do not have
    /// the channel.
    double none = 0.0;
    /// the channel needs the blended normals of surfels, so 3D Gaussians do not support
    /// it
    bool needs_normals = false;
};

/// Values of a channel. [n] an entry for each ray or point.
using ChannelValues = std::variant<std::vector<float>, std::vector<std::int32_t>, std::vector<glm::vec3>>;

/// A channel of a scan or a point cloud. Either relidar has rendered it, or the caller
/// has added it.
struct ScanChannel {
    ChannelInfo info;
    ChannelValues values;
    /// [n] values of the second returns. Empty if the channel has no separate values for
    /// them.
    ChannelValues second = {};
};

/// Descriptions of the channels that every scan has.
struct BasicChannels {
    ChannelInfo range, median_range, mean_range, intensity, drop_prob, weight, time, ring, instance;
};
/// Returns the descriptions of the channels that every scan has. @return a reference to a
/// single static object
const BasicChannels& basic_channels();
/// Returns the basic channels that are written to files, in the order in which files
/// store them.
std::vector<ChannelInfo> file_channels();
/// Returns the channels that the setting `render.channels` can enable.
const std::vector<ChannelInfo>& optional_channels();
/// Returns the names of `optional_channels()`, in the same order.
std::vector<std::string> optional_channel_names();

/// Parses a setting with channel names, separated by commas. Removes duplicates.
/// @throws UsageError for an unknown name; the message suggests the most similar known
/// name
std::vector<ChannelInfo> wanted_channels(const std::string& names);

/// Returns the values of the channel with this name. Returns null if the channel does not
/// exist or its values have another type.
template <class T>
const std::vector<T>* find_values(const std::vector<ScanChannel>& channels, const std::string& name) {
    for (const ScanChannel& channel : channels)
        if (channel.info.name == name) return std::get_if<std::vector<T>>(&channel.values);
    return nullptr;
}

/// Returns the number of values of a channel: one for each ray or point.
std::size_t size(const ChannelValues& values);

/// Returns the same channels with the same types, but without values.
std::vector<ScanChannel> emptied(const std::vector<ScanChannel>& channels);

/// A scalar column of a channel, float32 or int32. A scalar channel has a single column,
/// for example "seen". A vector channel has three: "normal_x", "normal_y", "normal_z".
struct ChannelNumber {
    std::string name;
    bool is_integer;
};
/// Returns the scalar columns of the channels, in the order in which append_row() writes
/// them.
/// @param joint  text between a vector's name and its axis
std::vector<ChannelNumber> numbers_of(const std::vector<ScanChannel>& channels,
                                      const std::string& joint = "_");
/// Appends the values of all channels for a ray or point to `bytes`. Writes 4 bytes for
/// each number, in the byte order of the machine.
/// @param at  index of the ray or point
void append_row(std::string& bytes, const std::vector<ScanChannel>& channels, std::size_t at);

/// Returns the value that a channel has if the ray hits nothing or the value is unknown.
template <class T>
T nothing_of(const ChannelInfo& channel) {
    return T(static_cast<float>(channel.none));
}

/// Appends the value of a return of a ray to a channel of points. A second return gets
/// its value in `ScanChannel::second`, if that is not empty. Otherwise it gets the value
/// of the ray if `ChannelInfo::of_ray` is set, or else `ChannelInfo::none`.
/// @param number  number of the return, starting at 1
void append_return(ScanChannel& of_points, const ScanChannel& of_rays, std::size_t ray, int number);

/// Checks channels before they are written to a file.
/// @param n  expected number of values
/// @param what  the rays or points, for the error message
/// @throws DataError if a channel has an invalid name, the name of another channel, or a
/// number of values other than `n`
void check_channels(const std::vector<ScanChannel>& channels, std::size_t n, const std::string& what);

}  // namespace relidar
