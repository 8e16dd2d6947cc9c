// SPDX-License-Identifier: Apache-2.0
#include "read/files/other_formats.hpp"

#include <algorithm>
#include <cctype>

#include <fmt/format.h>

#include "base/files.hpp"

namespace relidar {
namespace {

struct UnsupportedPointFormat {
    const char* ending;
    const char* what;
    const char* tool;
};
constexpr UnsupportedPointFormat kOtherFormats[] = {
    {".laz", "a LAZ file", "convert it with 'pdal translate IN.laz OUT.las'"},
    {".e57", "an E57 file", "convert it with 'pdal translate IN.e57 OUT.ply'"},
    {".pts", "a PTS file", "save it as PLY with CloudCompare"},
    {".ptx", "a PTX file", "save it as PLY with CloudCompare"},
    {".vtp", "a VTK file", "save it as CSV with ParaView"},
    {".vtk", "a VTK file", "save it as CSV with ParaView"},
    {".lvx", "a Livox recording", "convert it to a ROS bag with livox_ros_driver"},
    {".lvx2", "a Livox recording", "convert it to a ROS bag with livox_ros_driver2"},
    {".osf", "an Ouster OSF file", "convert it with 'ouster-cli source IN.osf save OUT.pcap'"},
    {".rosbag", "a rosbag recording of another version", "convert it to a ROS bag with 'rosbags-convert'"},
    {".record", "an Apollo Cyber record", "extract its clouds as PCD with 'cyber_record'"},
    {".h5", "an HDF5 file", "save its points as npy with Python (h5py and numpy.save)"},
    {".hdf5", "an HDF5 file", "save its points as npy with Python (h5py and numpy.save)"},
    {".parquet", "a Parquet file", "save its points as CSV with Python (pandas)"},
    {".mat", "a MATLAB file", "save its points as PCD with pcwrite of MATLAB"},
    {".gz", "a gzip file", "unpack it with 'gunzip'"},
    {".zst", "a Zstandard file", "unpack it with 'zstd -d'"},
    {".zstd", "a Zstandard file", "unpack it with 'zstd -d'"},
    {".xz", "an xz file", "unpack it with 'unxz'"},
    {".zip", "a zip file", "unpack it with 'unzip'"},
    {".7z", "a 7z file", "unpack it with '7z x'"},
    {".tar", "a tar file", "unpack it with 'tar xf'"},
    {".tgz", "a tar file", "unpack it with 'tar xf'"},
};

}  // namespace

std::string describe_format(const std::filesystem::path& file) {
    std::string ending = file.extension().string();
    std::ranges::transform(ending, ending.begin(),
                           [](unsigned char character) { return char(std::tolower(character)); });
    for (const UnsupportedPointFormat& format : kOtherFormats)
        if (ending == format.ending)
            return fmt::format("{}, which relidar cannot read; {}", format.what, format.tool);
    return "";
}

std::string find_unsupported(const std::filesystem::path& folder) {
    std::error_code failed;
    if (!std::filesystem::is_directory(folder, failed)) return "";
    for (const std::filesystem::path& file : list_folder(folder))
        if (const std::string text = describe_format(file); !text.empty())
            return fmt::format("{} is {}", file.filename().string(), text);
    return "";
}

}  // namespace relidar
