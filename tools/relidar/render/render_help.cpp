// SPDX-License-Identifier: Apache-2.0
#include "render/render_help.hpp"

#include <fmt/format.h>

#include <relidar/log/channels.hpp>

namespace relidar::cli {

std::string make_output_files_help_text() {
    return R"(Files are named DIR/frame_000123.npz and so on, by the dataset's frame number; with --trajectory
they are counted from 0. DIR/scans.json holds run, sensor, offset, poses, times and settings, and
`unseen`: the share of rays that mainly cross space that the log did not observe.
`unseen_sides`: sides of actors that the log did not observe, so that rays pass through them.
`completed_sides`: sides of actors that are mirror images of the other side.
`boxes` (with --boxes): the box of each actor at the time at which the sensor faces it, in the
dataset's world; the number of first returns from it; and its visible share, which is the share of
its rays that no other object blocks.
npz: range, median_range, intensity, drop_prob, weight, time, ring [rows,columns]; directions,
origin [rows,columns,3]; pose [4,4], sensor to the dataset's world at time_s. Metres, seconds.
ply, pcd, bin: the points of rays with drop_prob < 0.5, where half of the light is absorbed (the
median range). With --set render.points=range they use the mean range, which lies between two
surfaces at edges. The VIEWPOINT of a pcd is the pose in the dataset's world.
ring: beam, 0 is the highest. time: firing time of the ray, seconds from time_s.
instance (npz, exr, ply, pcd): surface at the median range, the number in `relidar info RUN`;
0 background, -1 nothing. npz also has instance_names.
mcap: DIR/scans.mcap, one file with all scans of all sensors, for Foxglove. rosbag:
DIR/rosbag.mcap, a ROS 2 bag. Both contain the transforms of world, base_link (the log's vehicle)
and sensors, and the boxes of actors. --deskew moves points to the time of the first ray.
pcap: DIR/packets.pcap, the packets that the sensor sends, with its rounding and timing; with
packets.csv (Hesai) or packets.json (Ouster), the calibration for its driver.
)";
}

std::string make_channels_help_text() {
    std::string text =
        "Channels of --channels, one value per ray in npz and exr, one per point in ply, pcd, mcap and "
        "rosbag:\n";
    for (const ChannelInfo& channel : get_optional_channels())
        text += fmt::format("  {:<17} {}{}\n", channel.name, channel.meaning,
                            channel.unit.empty() ? "" : " [" + channel.unit + "]");
    return text;
}

}  // namespace relidar::cli
