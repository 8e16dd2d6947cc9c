// SPDX-License-Identifier: Apache-2.0
// Fuzzes plain folders. "points" reads a scan of points, and the first byte selects the
// format. "folder" reads the text files of a folder (sequence.json, poses.txt,
// boxes.json), separated by lines of "=====". "exr" reads a scan as a range image, with
// the rays of the image or of the log's sensor.
#include "harness.hpp"

#include <iterator>

#include <fmt/format.h>

#include <relidar/base/images.hpp>

#include "read/files/point_writers.hpp"
#include "read/scans/folder_points.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr const char* kEndings[] = {"pcd", "ply", "bin", "npy", "csv", "las"};
constexpr std::string_view kParting = "\n=====\n";

test::FilePoints make_cylinder() { return test::make_cylinder(40, 0.001); }

void read_points(std::string_view input, const fs::path& folder) {
    if (input.empty()) return;
    const char* ending = kEndings[static_cast<unsigned char>(input[0]) % std::size(kEndings)];
    const fs::path file = folder / fmt::format("scan.{}", ending);
    put(file, input.substr(1));
    std::vector<std::string> columns = {"x", "y", "z", "intensity", "ring"};
    if (ending == kEndings[3]) columns.push_back("timestamp");
    read::PointFileUnits units;
    units.intensity_max = 255.0;
    read::convert_table(read::read_point_file(file, columns), units, 0.0, "scan");
}

fs::path log_in(const fs::path& folder) {
    static const fs::path log = [&] {
        fs::create_directories(folder / "log/scans");
        put(folder / "log/scans/0.pcd", test::make_pcd_binary(make_cylinder()));
        put(folder / "log/scans/1.bin", test::bin(make_cylinder()));
        put(folder / "log/scans/2.npy", test::npy(make_cylinder()));
        return folder / "log";
    }();
    return log;
}

void read_folder(std::string_view input, const fs::path& folder) {
    const fs::path log = log_in(folder);
    for (const char* name : {"sequence.json", "poses.txt", "boxes.json"}) {
        const std::size_t end = std::min(input.find(kParting), input.size());
        put(log / name, input.substr(0, end));
        input.remove_prefix(std::min(end + kParting.size(), input.size()));
    }
    load_sequence("folder:" + log.string(), {});
}

fs::path make_image_log_in(const fs::path& folder) {
    static const fs::path log = [&] {
        fs::create_directories(folder / "images/scans");
        put(folder / "images/sequence.json",
            R"({"format": "relidar log", "version": 1, "rate_hz": 10, "lidars": [{"sensor": {"columns": 16,
            "beams": [{"elevation_deg": 3}, {"elevation_deg": 2}, {"elevation_deg": 1}, {"elevation_deg": 0}]}}]})");
        put(folder / "images/poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0");
        return folder / "images";
    }();
    return log;
}

void read_exr_scan(std::string_view input, const fs::path& folder) {
    const fs::path log = make_image_log_in(folder);
    put(log / "scans/0.exr", input);
    load_sequence("folder:" + log.string(), {});
}

}  // namespace

std::vector<Harness> list_folder_harnesses() {
    return {{"points", nullptr, read_points},
            {"folder", nullptr, read_folder, false},
            {"exr", nullptr, read_exr_scan}};
}

}  // namespace relidar::fuzz
