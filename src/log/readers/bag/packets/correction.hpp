// SPDX-License-Identifier: Apache-2.0
// Reads the angle correction file of a Hesai sensor. It contains the angles of each laser
// of one unit in degrees, as measured by the manufacturer. The azimuth is positive
// clockwise. The first line is "Laser id,Elevation,Azimuth" or
// "Channel,Elevation,Azimuth".
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace relidar::packets {

struct LaserAngles {
    double elevation_deg = 0.0, azimuth_deg = 0.0;
};

struct AngleCorrection {
    std::string where;                ///< name of the file
    bool is_named = false;            ///< true if the file has the same name as the recording
    std::vector<LaserAngles> lasers;  ///< measured angles of laser 1, 2 and so on
    std::string problem = {};         ///< why the file cannot be read; empty if it was read
};

/// Parses an angle correction file, which contains the measured angles of each laser.
/// @param error_location  name of the file, for error messages
/// @throws DataError if a line is invalid, or if a laser is missing
AngleCorrection parse_angle_correction(const std::string& csv_text, const std::string& error_location);

/// Finds and reads the angle correction files of a recording. If .csv files have the
/// names of the recording's files, reads only these. Otherwise reads all .csv files in
/// the folder of the recording that begin like an angle correction. A ROS 2 bag is a
/// folder; the folder above it is then also searched. A file that cannot be read has no
/// lasers.
/// @param recording_files  all files of the recording
/// @throws DataError if the file with the name of the recording is damaged
std::vector<AngleCorrection> find_angle_corrections(
    const std::vector<std::filesystem::path>& recording_files);

}  // namespace relidar::packets
