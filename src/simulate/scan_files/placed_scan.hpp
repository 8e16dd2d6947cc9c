// SPDX-License-Identifier: Apache-2.0
// Converts the rays of a scan to the coordinate frame of the output files.
#pragma once

#include <glm/glm.hpp>

#include <relidar/simulate/render.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar::scan_files {

/// Returns the elements of a pose's 4 x 4 matrix, row by row.
std::vector<double> row_major(const Pose& pose);

/// Rays and their optional channels, [n] each, in the coordinate frame of the files. In
/// the world frame, positions are relative to points_origin_m().
struct PlacedRays {
    std::vector<glm::vec3> origin, direction, end_m;
    std::vector<ScanChannel> channels;
};

/// A scan for the output files. Converts its rays and its points only when a format first
/// needs them, and each only once.
class ScanInOutputFrame {
public:
    /// @param frame frame number of the dataset
    /// @param notes metadata of the files
    ScanInOutputFrame(const RenderedScan& rendered, const ScanOutputOptions& options, int frame,
                      FileMetadata notes = {});
    /// @throws DataError if check_channels() finds an invalid channel
    const PlacedRays& rays();
    /// Returns one point for each return of the scan. In the world frame, positions are
    /// relative to world_origin_m().
    const LidarPoints& points();
    /// Returns points_origin_m() in the world frame, its place on the map if there is
    /// one, and no value in the sensor frame.
    std::optional<glm::dvec3> world_origin_m() const;

    const RenderedScan& scan;
    const ScanOutputOptions& format;
    const int frame;
    const FileMetadata notes;

private:
    /// pose of the points' coordinate frame in the dataset's world frame; no value if
    /// each point is in the frame that the sensor had when it fired the point's ray
    std::optional<Pose> dataset_from_points_;
    std::optional<PlacedRays> rays_;
    std::optional<LidarPoints> points_;
};

/// Calls visit(info, values) for each channel of the output files, in the order of the
/// files. Second returns have the channels range_2 and intensity_2.
template <class Visit>
void for_each_channel(ScanInOutputFrame& placed_scan, Visit&& visit) {
    const RenderedScan& scan = placed_scan.scan;
    const BasicChannels& basic = basic_channels();
    visit(basic.range, scan.image.range_m);
    visit(basic.median_range, scan.median_range_m);
    visit(basic.intensity, scan.image.intensity);
    visit(basic.drop_prob, scan.image.drop_prob);
    visit(basic.weight, scan.weight);
    visit(basic.time, scan.time_offset_s);
    visit(basic.ring, scan.ring);
    visit(basic.instance, scan.instance);
    if (!scan.second_returns.empty()) {
        visit(ChannelInfo{"range_2", "m"}, scan.second_returns[0].range_m);
        visit(ChannelInfo{"intensity_2"}, scan.second_returns[0].intensity);
    }
    for (const ScanChannel& channel : placed_scan.rays().channels) {
        std::visit([&](const auto& values) { visit(channel.info, values); }, channel.values);
        ChannelInfo of_second = channel.info;
        of_second.name += "_2";
        if (count_values(channel.second) > 0)
            std::visit([&](const auto& values) { visit(of_second, values); }, channel.second);
    }
}

/// Returns the pose of the frame that all points share: the world at points_origin_m(),
/// the axes of ScanOutputOptions::map at the world's offset, or the sensor frame at one
/// time. Returns no value if each point is written in the
/// sensor frame at the firing time of its ray.
/// @param world_from_deskewed pose of the sensor frame in which deskewed
/// (motion-compensated) points are expressed
std::optional<Pose> world_from_output(const ScanOutputOptions& format, const Pose& world_from_deskewed);

}  // namespace relidar::scan_files
