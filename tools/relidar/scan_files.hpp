// SPDX-License-Identifier: Apache-2.0
// Rendered scans as files other tools open.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace relidar {
struct RenderedScan;
struct Scene;
}

namespace relidar::cli {

/// "npz,ply" as names. @throws UsageError for an unknown one, naming the nearest
std::vector<std::string> parse_formats(const std::string& list);

/// "background" or the track, by instance.
std::vector<std::string> instance_names(const Scene& scene);

/// Which files are written, and what the instance numbers in them mean.
struct ScanFormat {
    std::vector<std::string> formats;
    std::vector<std::string> instance_names;
};

/// Writes FOLDER/frame_000123.<format> for each format:
///   npz  range, median_range, intensity, drop_prob, weight [rows,columns]; directions, origin [rows,columns,3] (sensor frame);
///        instance [rows,columns] int32, -1 where nothing was met, and instance_names [instances] its meaning, bytes;
///        pose [4,4] world_from_sensor in the dataset's world; time_s
///   exr  the five images as float channels           png  range, intensity, drop probability as one picture
///   ply, pcd, bin  points of returned rays (drop_prob < 0.5), sensor frame; ply and pcd with their instance
void write_scan(const std::filesystem::path& folder, int frame, const RenderedScan& scan, const ScanFormat& wanted);

}  // namespace relidar::cli
