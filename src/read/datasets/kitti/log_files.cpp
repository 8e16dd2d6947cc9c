// SPDX-License-Identifier: Apache-2.0
// Reads the scans of KITTI, which are n x float32 {x, y, z, reflectance}.
#include "read/datasets/kitti/log_files.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/classes/dataset_classes.hpp"
#include "read/files/dropped_ray.hpp"
#include "read/readers.hpp"

namespace relidar::kitti {
namespace fs = std::filesystem;
namespace {

// A larger range means that the file has another number type or byte order.
constexpr double kFarthestReturn_m = 1e4;

/// Reads the class of each point from a file of SemanticKITTI. It has 32 bits per point:
/// the lower 16 bits are the class, the upper bits the instance.
std::vector<SurfaceClass> read_classes(const fs::path& label_file, std::size_t n_points) {
    constexpr std::uint32_t kClassBits = 0xFFFF;
    const std::string bytes = read_file(label_file);
    if (bytes.size() != 4 * n_points)
        fail("file {} has {} bytes, expected 4 bytes for each of the {} points of the scan",
             label_file.string(), bytes.size(), n_points);
    std::vector<SurfaceClass> classes;
    for (std::size_t i = 0; i < n_points; ++i) {
        std::uint32_t label;
        std::memcpy(&label, bytes.data() + 4 * i, sizeof label);
        classes.push_back(from_semantic_kitti(int(label & kClassBits)));
    }
    return classes;
}

}  // namespace

void note_missing_scans(Log& log, const fs::path& folder, const std::vector<int>& numbers,
                        bool allow_missing) {
    constexpr std::size_t kMaxShownNumbers = 5;
    const int first = numbers.front(), last = numbers.back();  // `numbers` is sorted
    const std::size_t n_missing = std::size_t(last - first + 1) - numbers.size();
    if (n_missing == 0) return;
    std::vector<int> shown;
    for (int number = first; number < last && shown.size() < kMaxShownNumbers; ++number)
        if (!std::ranges::binary_search(numbers, number)) shown.push_back(number);
    const std::string gaps =
        fmt::format("{} of the scans with numbers {} to {} are missing ({}{})", n_missing, first, last,
                    fmt::join(shown, ", "), n_missing > kMaxShownNumbers ? ", ..." : "");
    if (!allow_missing) fail("{}: {}, expected one file for each scan number", folder.string(), gaps);
    log.notes.push_back(gaps);
}

std::vector<int> list_scans(const fs::path& folder, int begin_number, int end_number) {
    require_folder(folder, "KITTI raw scans with names like 0000000000.bin");
    std::vector<int> all, requested;
    bool has_text_files = false;
    for (const fs::path& file : list_folder(folder)) {
        const auto number = parse_stem(file.stem().string());
        if (file.extension() == ".bin" && number) all.push_back(*number);
        if (file.extension() == ".txt") has_text_files = true;
    }
    if (all.empty() && has_text_files)
        fail("{}: found text files of an unsynced drive (_extract), expected the synced drive (_sync)",
             folder.string());
    if (all.empty()) fail("{}: no scans were found, expected files like 0000000000.bin", folder.string());
    std::sort(all.begin(), all.end());
    const FrameRange range{begin_number, end_number};
    std::ranges::copy_if(all, std::back_inserter(requested), [&](int n) { return range.contains(n); });
    if (requested.empty()) fail_empty_range(range, folder.string(), all.front(), all.back());
    return requested;
}

LidarPoints read_kitti_scan(const fs::path& file, const fs::path& label_file) {
    const std::string bytes = read_file(file);
    constexpr std::size_t kPointBytes = sizeof(glm::vec4);  // x, y, z, reflectance
    if (bytes.empty())
        fail("{}: the file is empty, expected at least one point of {} bytes", file.string(), kPointBytes);
    if (bytes.size() % kPointBytes != 0)
        fail("{}: the file is truncated: it has {} bytes, which are {} points of {} bytes and {} more bytes",
             file.string(), bytes.size(), bytes.size() / kPointBytes, kPointBytes,
             bytes.size() % kPointBytes);
    std::vector<glm::vec4> stored(bytes.size() / kPointBytes);
    std::memcpy(stored.data(), bytes.data(), bytes.size());
    std::vector<SurfaceClass> classes;
    if (!label_file.empty() && does_path_exist(label_file)) classes = read_classes(label_file, stored.size());
    LidarPoints points;
    for (std::size_t i = 0; i < stored.size(); ++i) {
        const glm::vec4& p = stored[i];
        if (!is_return_point(p)) continue;  // may have any values
        const double largest = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
        if (!std::isfinite(p.w) || largest > kFarthestReturn_m)
            fail("{}: point {} is ({}, {}, {}) with intensity {}, expected finite values up to {} m",
                 file.string(), i, p.x, p.y, p.z, p.w, kFarthestReturn_m);
        points.position_m.emplace_back(p);
        points.intensity.push_back(p.w);
        if (!classes.empty()) points.classes.push_back(classes[i]);
    }
    return points;
}

}  // namespace relidar::kitti
