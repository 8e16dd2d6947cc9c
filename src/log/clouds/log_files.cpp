// SPDX-License-Identifier: Apache-2.0
// Reads the scans of a KITTI raw drive, which are n x float32 {x, y, z, reflectance}. If
// a folder is not a KITTI raw drive, returns a text about what the folder probably is.
#include "log/clouds/log_files.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include "base/files.hpp"
#include "log/classes/dataset_classes.hpp"
#include "log/clouds/dropped_ray.hpp"

namespace relidar::kitti {
namespace fs = std::filesystem;
namespace {

// Maximum range of a point. No LiDAR measures ten kilometres, so if the range is larger,
// the file has another number type or byte order.
constexpr double kFarthestReturn_m = 1e4;

std::vector<SurfaceClass> read_classes(const fs::path& file, std::size_t n_points) {
    const std::string bytes = read_file(file);
    if (bytes.size() != 4 * n_points)
        throw DataError(fmt::format("{} has {} bytes, expected 4 bytes for each of the {} points of the scan",
                                    file.string(), bytes.size(), n_points));
    std::vector<SurfaceClass> classes;
    for (std::size_t i = 0; i < n_points; ++i) {
        std::uint32_t label;
        std::memcpy(&label, bytes.data() + 4 * i, sizeof label);
        classes.push_back(convert_semantic_kitti_class(int(label & 0xFFFFu)));
    }
    return classes;
}

}  // namespace

std::string describe_unknown_folder(const fs::path& folder, const std::string& marker) {
    std::error_code failed;
    const auto has = [&](const char* name) { return fs::exists(folder / name, failed); };
    if ((has("velodyne") && (has("times.txt") || has("calib.txt"))) || has("sequences"))
        return "the folder is a KITTI odometry sequence with motion-compensated scans; expected also its "
               "file calib.txt, or the KITTI raw drive from which the sequence was made";
    for (fs::path up = fs::canonical(folder, failed).parent_path(); !failed && up.has_relative_path();
         up = up.parent_path()) {
        if (fs::exists(up / marker, failed))
            return fmt::format("the folder is inside a dataset; use the folder of the dataset, {}",
                               up.string());
    }
    std::string first;
    std::size_t n = 0;
    for (fs::directory_iterator entry(folder, failed), end; !failed && entry != end;
         entry.increment(failed)) {
        if (!fs::exists(entry->path() / marker, failed)) continue;
        const std::string name = entry->path().filename().string();
        if (n++ == 0 || name < first) first = name;
    }
    return n == 0 ? ""
                  : fmt::format(
                        "the folder contains {} dataset{}; use the folder of one of them, such as "
                        "{}",
                        n, n == 1 ? "" : "s", (folder / first).string());
}

std::string format_frame_gaps(const fs::path& folder, const std::vector<int>& frames, bool allow_missing) {
    constexpr std::size_t kShown = 5;
    const std::size_t n = static_cast<std::size_t>(frames.back() - frames.front() + 1) - frames.size();
    if (n == 0) return "";
    std::vector<int> shown;
    for (std::size_t i = 1; i < frames.size(); ++i) {
        for (int frame = frames[i - 1] + 1; frame < frames[i] && shown.size() < kShown; ++frame)
            shown.push_back(frame);
    }
    const std::string gaps = fmt::format("{} of the scans {} to {} are missing ({}{})", n, frames.front(),
                                         frames.back(), fmt::join(shown, ", "), n > kShown ? ", ..." : "");
    if (!allow_missing) throw DataError(fmt::format("{}: {}, expected all scans", folder.string(), gaps));
    return gaps;
}

std::vector<int> list_scans(const fs::path& folder, int begin, int end) {
    check_folder(folder, "KITTI raw scans with names like 0000000000.bin");
    std::vector<int> all, frames;
    bool text_scans = false;
    for (const fs::path& file : list_folder(folder)) {
        const auto number = parse_file_number(file.stem().string());
        if (file.extension() == ".bin" && number) all.push_back(*number);
        else if (file.extension() == ".bin" &&
                 file.stem().string().find_first_not_of("0123456789") == std::string::npos)
            throw DataError(
                fmt::format("{}: the number of a scan is too large, expected a number below "
                            "100000000",
                            file.string()));
        text_scans = text_scans || file.extension() == ".txt";
    }
    if (all.empty() && text_scans)
        throw DataError(
            fmt::format("{}: the scans are text files, so this is an unsynced drive (_extract); expected "
                        "the synced drive (_sync) with files like 0000000000.bin",
                        folder.string()));
    if (all.empty())
        throw DataError(
            fmt::format("{}: no scans were found, expected files like "
                        "0000000000.bin",
                        folder.string()));
    std::sort(all.begin(), all.end());
    std::copy_if(all.begin(), all.end(), std::back_inserter(frames),
                 [&](int f) { return f >= begin && (end < 0 || f < end); });
    if (frames.empty()) {
        throw UsageError(fmt::format("frames {}:{} select no scan of {}, expected numbers in [{}, {}]", begin,
                                     end < 0 ? "" : std::to_string(end), folder.string(), all.front(),
                                     all.back()));
    }
    return frames;
}

ScanPoints read_scan(const fs::path& file, const fs::path& labels) {
    const std::string bytes = read_file(file);
    static_assert(sizeof(glm::vec4) == 16);
    if (bytes.empty())
        throw DataError(fmt::format("{}: the file is empty, expected points of 16 bytes", file.string()));
    if (bytes.size() % 16 != 0) {
        throw DataError(
            fmt::format("{}: the file is truncated: it has {} bytes, which are {} points of 16 bytes and "
                        "{} more bytes",
                        file.string(), bytes.size(), bytes.size() / 16, bytes.size() % 16));
    }
    ScanPoints scan;
    std::vector<glm::vec4>& points = scan.points;
    points.resize(bytes.size() / 16);
    std::memcpy(points.data(), bytes.data(), bytes.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::vec4& p = points[i];
        const double largest = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
        if (!is_return(p) || (std::isfinite(p.w) && largest <= kFarthestReturn_m)) continue;
        throw DataError(
            fmt::format("{}: point {} is ({}, {}, {}) with intensity {}, expected finite values and "
                        "coordinates of at most {} m",
                        file.string(), i, p.x, p.y, p.z, p.w, kFarthestReturn_m));
    }
    if (!labels.empty() && does_path_exist(labels)) scan.classes = read_classes(labels, points.size());
    std::size_t n = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        if (!is_return(points[i])) continue;
        if (!scan.classes.empty()) scan.classes[n] = scan.classes[i];
        points[n++] = points[i];
    }
    points.resize(n);
    if (!scan.classes.empty()) scan.classes.resize(n);
    return scan;
}

}  // namespace relidar::kitti
