// SPDX-License-Identifier: Apache-2.0
#include "log/clouds/other_formats.hpp"

#include <algorithm>
#include <cctype>

#include <fmt/format.h>

#include "base/files.hpp"

namespace relidar {
namespace {

struct OtherFormat {
    const char* ending;
    const char* what;
    const char* tool;
};
constexpr OtherFormat kOtherFormats[] = {
    {".laz", "a LAZ file", "'pdal translate IN.laz OUT.las' or 'laszip' unpacks it"},
    {".e57", "an E57 file", "'pdal translate IN.e57 OUT.ply' writes points of one scan"},
    {".pts", "a PTS file", "CloudCompare saves it as PLY"},
    {".ptx", "a PTX file", "CloudCompare saves it as PLY"},
    {".vtp", "a VTK file", "ParaView saves it as CSV"},
    {".vtk", "a VTK file", "ParaView saves it as CSV"},
    {".lvx", "a Livox recording", "livox_ros_driver converts it to a ROS bag"},
    {".lvx2", "a Livox recording", "livox_ros_driver2 converts it to a ROS bag"},
    {".osf", "an Ouster OSF file", "'ouster-cli source IN.osf save OUT.pcap' converts it"},
    {".rosbag", "a recording of another version", "'rosbags-convert' converts it to a ROS bag"},
    {".record", "an Apollo Cyber record", "'cyber_record' extracts its clouds as PCD"},
    {".h5", "an HDF5 file", "Python's h5py and numpy.save write its points as npy"},
    {".hdf5", "an HDF5 file", "Python's h5py and numpy.save write its points as npy"},
    {".parquet", "a Parquet file", "Python's pandas writes its points as CSV"},
    {".mat", "a MATLAB file", "MATLAB's pcwrite writes its points as PCD"},
    {".gz", "a gzip file", "'gunzip' unpacks it"},
    {".zst", "a Zstandard file", "'zstd -d' unpacks it"},
    {".zstd", "a Zstandard file", "'zstd -d' unpacks it"},
    {".xz", "an xz file", "'unxz' unpacks it"},
    {".zip", "a zip file", "'unzip' unpacks it"},
    {".7z", "a 7z file", "'7z x' unpacks it"},
    {".tar", "a tar file", "'tar xf' unpacks it"},
    {".tgz", "a tar file", "'tar xf' unpacks it"},
};

}  // namespace

std::string describe_other_format(const std::filesystem::path& file) {
    std::string ending = file.extension().string();
    std::ranges::transform(ending, ending.begin(), [](unsigned char c) { return char(std::tolower(c)); });
    for (const OtherFormat& format : kOtherFormats)
        if (ending == format.ending)
            return fmt::format("{}, which relidar does not read; {}", format.what, format.tool);
    return "";
}

std::string describe_other_files(const std::filesystem::path& folder) {
    std::error_code failed;
    if (!std::filesystem::is_directory(folder, failed)) return "";
    for (const std::filesystem::path& file : list_folder(folder))
        if (const std::string about = describe_other_format(file); !about.empty())
            return fmt::format("{} is {}", file.filename().string(), about);
    return "";
}

}  // namespace relidar
