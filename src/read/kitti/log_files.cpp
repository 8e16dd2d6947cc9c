// SPDX-License-Identifier: Apache-2.0
// Reads the scans of a KITTI raw drive, which are n x float32 {x, y, z, reflectance}. If
// a folder is not a KITTI raw drive, describes what it probably is.
#include "read/kitti/log_files.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/classes/dataset_classes.hpp"
#include "read/readers.hpp"
#include "read/scans/dropped_ray.hpp"

namespace relidar::kitti {
namespace fs = std::filesystem;
namespace {

// A larger range means that the file has another number type or byte order.
constexpr double kFarthestReturn_m = 1e4;

/// The lower 16 bits of a label are the class, the upper bits the instance.
std::vector<SurfaceClass> read_classes(const fs::path& label_file, std::size_t n_points) {
    const std::string bytes = read_file(label_file);
    if (bytes.size() != 4 * n_points)
        fail("file {} has {} bytes, expected 4 bytes for each of the {} points of the scan",
             label_file.string(), bytes.size(), n_points);
    std::vector<SurfaceClass> classes;
    for (std::size_t i = 0; i < n_points; ++i) {
        std::uint32_t label;
        std::memcpy(&label, bytes.data() + 4 * i, sizeof label);
        classes.push_back(from_semantic_kitti(int(label & 0xFFFFu)));
    }
    return classes;
}

}  // namespace

std::string describe_mistake(const fs::path& folder, const std::string& expected_subfolder) {
    std::error_code failed;
    const auto has = [&](const char* name) { return fs::exists(folder / name, failed); };
    if ((has("velodyne") && (has("times.txt") || has("calib.txt"))) || has("sequences"))
        return "the folder is a KITTI odometry sequence with motion-compensated scans; expected also its "
               "file calib.txt, or the KITTI raw drive from which the sequence was made";
    // A folder above this one may be the dataset.
    for (fs::path up = fs::canonical(folder, failed).parent_path(); !failed && up.has_relative_path();
         up = up.parent_path()) {
        if (fs::exists(up / expected_subfolder, failed))
            return fmt::format("the folder is inside a dataset; use the folder of the dataset, {}",
                               up.string());
    }
    // Subfolders may be datasets. The message suggests the first of them by name.
    std::string first;
    std::size_t n = 0;
    for (fs::directory_iterator entry(folder, failed), end; !failed && entry != end;
         entry.increment(failed)) {
        if (!fs::exists(entry->path() / expected_subfolder, failed)) continue;
        const std::string name = entry->path().filename().string();
        if (n++ == 0 || name < first) first = name;
    }
    return n == 0 ? ""
                  : fmt::format("the folder contains {} dataset{}; use the folder of one of them, such as {}",
                                n, n == 1 ? "" : "s", (folder / first).string());
}

void note_missing_scans(Log& log, const fs::path& folder, const std::vector<int>& numbers,
                        bool allow_missing) {
    constexpr std::size_t kMaxShownNumbers = 5;
    // number of missing scans; `numbers` is sorted
    const std::size_t n = std::size_t(numbers.back() - numbers.front() + 1) - numbers.size();
    if (n == 0) return;
    std::vector<int> shown;
    for (std::size_t i = 1; i < numbers.size(); ++i) {
        for (int frame = numbers[i - 1] + 1; frame < numbers[i] && shown.size() < kMaxShownNumbers; ++frame)
            shown.push_back(frame);
    }
    const std::string gaps =
        fmt::format("{} of the scans with numbers {} to {} are missing ({}{})", n, numbers.front(),
                    numbers.back(), fmt::join(shown, ", "), n > kMaxShownNumbers ? ", ..." : "");
    if (!allow_missing) fail("{}: {}, expected one file for each scan number", folder.string(), gaps);
    log.notes.push_back(gaps);
}

std::vector<int> list_scans(const fs::path& folder, int begin_number, int end_number) {
    require_folder(folder, "KITTI raw scans with names like 0000000000.bin");
    std::vector<int> all, frames;
    bool text_scans = false;
    for (const fs::path& file : list_folder(folder)) {
        const auto number = parse_stem(file.stem().string());
        if (file.extension() == ".bin" && number) all.push_back(*number);
        text_scans = text_scans || file.extension() == ".txt";
    }
    if (all.empty() && text_scans)
        fail("{}: found text files of an unsynced drive (_extract), expected the synced drive (_sync)",
             folder.string());
    if (all.empty()) fail("{}: no scans were found, expected files like 0000000000.bin", folder.string());
    std::sort(all.begin(), all.end());
    std::copy_if(all.begin(), all.end(), std::back_inserter(frames),
                 [&](int f) { return f >= begin_number && (end_number < 0 || f < end_number); });
    if (frames.empty())
        fail_empty_range({begin_number, end_number}, folder.string(), all.front(), all.back());
    return frames;
}

ScanPoints read_kitti_scan(const fs::path& file, const fs::path& label_file) {
    const std::string bytes = read_file(file);
    static_assert(sizeof(glm::vec4) == 16);
    if (bytes.empty()) fail("{}: the file is empty, expected at least one point of 16 bytes", file.string());
    if (bytes.size() % 16 != 0) {
        fail("{}: the file is truncated: it has {} bytes, which are {} points of 16 bytes and {} more bytes",
             file.string(), bytes.size(), bytes.size() / 16, bytes.size() % 16);
    }
    ScanPoints scan;
    std::vector<glm::vec4>& points = scan.points;
    points.resize(bytes.size() / 16);
    std::memcpy(points.data(), bytes.data(), bytes.size());
    for (std::size_t i = 0; i < points.size(); ++i) {
        const glm::vec4& p = points[i];
        const double largest = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
        // A ray without a return may have any values, because it is removed below.
        if (!is_return_point(p) || (std::isfinite(p.w) && largest <= kFarthestReturn_m)) continue;
        fail("{}: point {} is ({}, {}, {}) with intensity {}, expected finite values up to {} m",
             file.string(), i, p.x, p.y, p.z, p.w, kFarthestReturn_m);
    }
    if (!label_file.empty() && does_path_exist(label_file))
        scan.classes = read_classes(label_file, points.size());
    // Removes rays without a return, together with their classes.
    std::size_t n = 0;
    for (std::size_t i = 0; i < points.size(); ++i) {
        if (!is_return_point(points[i])) continue;
        if (!scan.classes.empty()) scan.classes[n] = scan.classes[i];
        points[n++] = points[i];
    }
    points.resize(n);
    if (!scan.classes.empty()) scan.classes.resize(n);
    return scan;
}

}  // namespace relidar::kitti
