// SPDX-License-Identifier: Apache-2.0
// Rendered scans as files other tools open.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace relidar {
struct RenderedScan;
}

namespace relidar::cli {

/// "npz,ply" as names. @throws UsageError for an unknown one, naming the nearest
std::vector<std::string> parse_formats(const std::string& list);

/// Writes FOLDER/frame_000123.<format> for each format:
///   npz  range, median_range, intensity, drop_prob, weight [rows,columns]; directions, origin [rows,columns,3] (sensor frame);
///        pose [4,4] world_from_sensor in the dataset's world; time_s
///   exr  the five images as float channels           png  range, intensity, drop probability as one picture
///   ply, pcd, bin  points of returned rays (drop_prob < 0.5), sensor frame
void write_scan(const std::filesystem::path& folder, int frame, const RenderedScan& scan, const std::vector<std::string>& formats);

}  // namespace relidar::cli
