// SPDX-License-Identifier: Apache-2.0
// Rendered scans as files other tools open, each with what its format can carry of where, when and by what it was made.
#pragma once

#include <filesystem>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <relidar/config.hpp>
#include <relidar/math.hpp>
#include <relidar/sensor.hpp>

namespace relidar {
struct RenderedScan;
struct Run;
struct SensorChoice;
}

namespace relidar::cli {

/// Names of the formats, which are the files' extensions.
std::vector<std::string> scan_formats();
/// "npz,ply" as names, in any case, with or without spaces. @throws UsageError for an unknown one, naming the nearest
std::vector<std::string> parse_formats(const std::string& list);

/// Frame of reference of points, and of the rays in npz and exr.
enum class PointFrame { sensor, world };
/// @throws UsageError for another name than sensor or world
PointFrame parse_point_frame(const std::string& name);

/// What is written, and what the files say of themselves.
struct ScanFormat {
    std::vector<std::string> formats;
    PointFrame frame = PointFrame::sensor;
    bool deskew = false;                       ///< sensor frame: of the scan's reference time for all rays, instead of each ray's firing time
    std::vector<std::string> instance_names;   ///< "background" or the track, by instance
    std::vector<std::string> only;             ///< what was rendered alone; empty: everything
    std::optional<std::uint64_t> sample;       ///< seed of a sampled scan; none: the likeliest
    std::string run;                           ///< its folder
    std::string sensor;
    RangeLimits limits;
    Pose offset;                               ///< of the simulated sensor in the log's sensor frame
    Config config;
};
/// Of a run by a sensor, npz in the sensor's frame.
ScanFormat scan_format(const Run& run, const SensorChoice& sensor, const Pose& offset);

/// Scans written one by one into a folder, and scans.json, which says what they are. Files of one scan are FOLDER/frame_000123.<format>:
///   npz  range, median_range, intensity, drop_prob, weight, time, ring [rows,columns]; directions, origin [rows,columns,3];
///        instance [rows,columns] int32, -1 where nothing was met, and instance_names [instances] its meaning, bytes;
///        pose [4,4] world_from_sensor at time_s; time_s, frame_number, frame, deskewed, sensor, run, units
///   exr  the images as float channels, notes as string attributes
///   png  range, intensity, drop probability as one picture, notes as text
///   ply, pcd, bin  points of returned rays (drop_prob < 0.5); ply and pcd with ring, time and instance, notes as comments
class ScanFolder {
public:
    /// Removes an earlier rendering from the folder, which must be there.
    ScanFolder(std::filesystem::path folder, ScanFormat format);
    void write(int frame, const RenderedScan& scan);
    /// Writes scans.json.
    void finish() const;

private:
    struct Entry {
        int frame;
        double time_s;
        Pose world_from_sensor;
        std::size_t rays, points;
        std::vector<std::string> files;
    };
    std::filesystem::path folder_;
    ScanFormat format_;
    std::vector<Entry> entries_;
};

/// Refuses a folder that holds a rendering: its frames would mix with the new ones. @throws UsageError unless overwrite is set
void check_no_scans(const std::filesystem::path& folder, bool overwrite);

}  // namespace relidar::cli
