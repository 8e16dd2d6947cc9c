// SPDX-License-Identifier: Apache-2.0
// Reads the angle correction of a Hesai: a file with the measured angles of each laser of
// one unit. The first line is "Laser id,Elevation,Azimuth" or
// "Channel,Elevation,Azimuth". Angles are in degrees, and the azimuth is positive
// clockwise.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

namespace relidar::packets {

struct LaserAngles {
    double elevation_deg = 0.0, azimuth_deg = 0.0;
};

struct Correction {
    std::string where;                ///< name of the file
    bool is_named = false;            ///< true if the file has the name of the recording
    std::vector<LaserAngles> lasers;  ///< angles of laser 1, 2, ...
};

/// Reads an angle correction.
/// @param where  name of the file, for messages
/// @throws DataError if a line is invalid, or if a laser is missing
Correction read_correction(const std::string& text, const std::string& where);

/// Reads the angle corrections next to a recording. A .csv file with the name of the
/// recording has priority: the result then contains only this file. Otherwise, searches
/// the folder of the recording for all .csv files with the first line of a correction.
/// For a ROS 2 bag, also searches the folder that contains the bag's folder.
/// @throws DataError if the file with the name of the recording is damaged
std::vector<Correction> find_corrections(const std::filesystem::path& recording);

}  // namespace relidar::packets
