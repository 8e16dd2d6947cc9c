// SPDX-License-Identifier: Apache-2.0
// What a scan says of each ray. One list, which scans, files, recordings, the service,
// the viewer and Python walk: docs/architecture.md says how a channel is added.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <variant>
#include <vector>

#include <glm/glm.hpp>

namespace relidar {

/// How the values of several rays become one: of the sub-rays of a beam, and of the rays
/// whose points lie in one cell of a grid.
enum class ChannelJoin {
    /// beam: of the strongest return's sub-ray nearest to the middle; cell: of the ray
    /// that has the cell
    nearest,
    /// beam: mean over the strongest return, by light; cell: of the ray that has it,
    /// measured from the grid's origin
    range,
    /// beam: sum over the strongest return, over the number of sub-rays; cell: of the ray
    /// that has it
    intensity,
    drop,  ///< beam: mean over all sub-rays; cell: the smallest
};

/// What a channel is.
struct ChannelInfo {
    std::string name;                         ///< lower case letters, digits and _: what files call it
    std::string unit = {};                    ///< empty: a plain number
    std::string meaning = {};                 ///< for people, one sentence without a full stop
    ChannelJoin join = ChannelJoin::nearest;  ///< of floats; integers and vectors are joined as nearest
    bool turns = false;   ///< a direction: vectors turn where points change their frame of reference
    bool of_ray = false;  ///< says something of the ray, whatever came back: its second return has it, too
    /// value where nothing was met, of second returns, and of rays that do not have the
    /// channel
    double none = 0.0;
    bool needs_normals = false;  ///< made of the blended normals of surfels: 3D Gaussians cannot have it
};

/// [n] an entry a ray, or a point.
using ChannelValues = std::variant<std::vector<float>, std::vector<std::int32_t>, std::vector<glm::vec3>>;

/// A channel of a scan or of a point cloud, rendered or of the caller's own.
struct ScanChannel {
    ChannelInfo info;
    ChannelValues values;
    /// of the second returns, as many; empty where it says nothing of them of its own
    ChannelValues second = {};
};

/// Those that every scan has.
struct BasicChannels {
    ChannelInfo range, median_range, mean_range, intensity, drop_prob, weight, time, ring, instance;
};
/// What they are. @return the one list of them
const BasicChannels& basic_channels();
/// Those of them that files hold, in their order.
std::vector<ChannelInfo> file_channels();
/// Those that the setting render.channels may ask for.
const std::vector<ChannelInfo>& optional_channels();
/// Their names, in their order.
std::vector<std::string> optional_channel_names();

/// Those that a setting names, separated by commas. @throws UsageError for an unknown
/// name, with the nearest one
std::vector<ChannelInfo> wanted_channels(const std::string& names);

/// Values of the channel of this name; null where there is none, or where they are of
/// another type.
template <class T>
const std::vector<T>* find_values(const std::vector<ScanChannel>& channels, const std::string& name) {
    for (const ScanChannel& channel : channels)
        if (channel.info.name == name) return std::get_if<std::vector<T>>(&channel.values);
    return nullptr;
}

/// How many rays or points the values are of.
std::size_t size(const ChannelValues& values);

/// The channels without values, of the same types.
std::vector<ScanChannel> emptied(const std::vector<ScanChannel>& channels);

/// A number of a channel, float32 or int32: "seen"; of a vector three, "normal_x",
/// "normal_y", "normal_z".
struct ChannelNumber {
    std::string name;
    bool is_integer;
};
/// In the order of append_row(). @param joint  between a vector's name and its axis
std::vector<ChannelNumber> numbers_of(const std::vector<ScanChannel>& channels,
                                      const std::string& joint = "_");
/// Appends what the channels say of one ray or point, 4 bytes a number, as they lie in
/// memory.
void append_row(std::string& bytes, const std::vector<ScanChannel>& channels, std::size_t at);

/// What a channel says where nothing was met, or nothing is known.
template <class T>
T nothing_of(const ChannelInfo& channel) {
    return T(static_cast<float>(channel.none));
}

/// Appends what a channel of rays says of a return: of a second one what is known of the
/// ray. @param number  of the return, from 1
void append_return(ScanChannel& of_points, const ScanChannel& of_rays, std::size_t ray, int number);

/// @throws DataError where a channel has no name that files can have, one that another
/// has, or another number of values than there are
/// @param what  the rays or points, for the message
void check_channels(const std::vector<ScanChannel>& channels, std::size_t n, const std::string& what);

}  // namespace relidar
