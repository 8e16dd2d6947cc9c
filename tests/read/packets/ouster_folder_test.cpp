// SPDX-License-Identifier: Apache-2.0
// Real scans as plain folders, with points by Ouster's equation and beams of the
// calibration. Skipped if RELIDAR_SHARED (../shared) does not contain the scans.
#include <relidar/read/dataset.hpp>

#include <fmt/format.h>

#include <relidar/base/files.hpp>

#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/packets/ouster_packets.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::OusterImages;

/// Points have neither rings nor times.
fs::path write_folder(const OusterImages& scans, const std::string& name, bool with_beams) {
    const fs::path folder = fs::path(testing::TempDir()) / "relidar_ouster" / name;
    fs::remove_all(folder);
    fs::create_directories(folder / "scans");
    std::string beams, frames, poses;
    for (std::size_t b = 0; b < scans.rows; ++b)
        beams +=
            fmt::format("{}{{\"elevation_deg\": {}, \"azimuth_offset_deg\": {}, \"origin_offset_m\": {}}}",
                        b ? ", " : "", scans.altitude_deg[b], -scans.azimuth_deg[b], 1e-3 * scans.n_mm);
    for (std::size_t f = 0; f < scans.frames; ++f) {
        std::string bytes;
        for (std::size_t row = 0; row < scans.rows; ++row)
            for (std::size_t column = 0; column < scans.columns; ++column) {
                const std::uint32_t mm = scans.range_mm[scans.at(f, row, column)];
                if (mm == 0) continue;
                const glm::vec3 p(scans.compute_point(row, column, mm));
                for (const float v : {p.x, p.y, p.z, 0.5f})
                    bytes.append(reinterpret_cast<const char*>(&v), 4);
            }
        test::write_text(folder / fmt::format("scans/{}.bin", f), bytes);
        poses += "1 0 0 0 0 1 0 0 0 0 1 0\n";
    }
    test::write_text(folder / "poses.txt", poses);
    const std::string sensor =
        with_beams ? fmt::format(R"("columns": {}, "max_range_m": 400, "beams": [{}])", scans.columns, beams)
                   : R"("max_range_m": 400)";
    test::write_text(
        folder / "sequence.json",
        fmt::format(
            R"({{"format": "relidar log", "version": 1, "rate_hz": 10, "lidars": [{{"sensor": {{{}}}}}]}})",
            sensor));
    return folder;
}

/// Returns with the right beam, column and range, if columns start at a given one.
struct Found {
    std::size_t right = 0, all = 0;
};
Found compare(const OusterImages& scans, std::size_t f, const Scan& actual_scan, const SpinningSensor& sensor,
              std::size_t first) {
    Found counts;
    for (std::size_t row = 0; row < scans.rows; ++row) {
        const int shift = offset_columns(sensor.beams[row], sensor.columns);
        for (std::size_t column = 0; column < scans.columns; ++column) {
            const std::uint32_t mm = scans.range_mm[scans.at(f, row, column)];
            if (mm == 0) continue;
            const double range_m = 1e-3 * mm;
            ++counts.all;
            // A sweep starts in the backward direction, which is at half of the columns
            // of an image.
            const std::size_t firing = (column + scans.columns / 2 + first) % scans.columns;
            const std::size_t at =
                row * scans.columns +
                (firing + scans.columns - std::size_t(shift + sensor.columns)) % scans.columns;
            const double off_m =
                glm::distance(glm::dvec3(actual_scan.return_point(at)), scans.compute_point(row, column, mm));
            counts.right +=
                actual_scan.rays.channel[at] == row &&
                std::abs(double(actual_scan.range_m[at]) - (range_m - 1e-3 * scans.n_mm)) < 1e-3 &&
                off_m < 1e-3;
        }
    }
    return counts;
}

TEST(OusterFolder, EveryReturnFindsItsBeamAndColumn) {
    for (const char* name : {"OS-1-128_v2.3.0_1024x10_lb_n3", "OS-2-128-U1_v2.3.0_1024x10"}) {
        const auto images = test::load_real_images(std::string(name) + ".npz", "", test::kSingle);
        if (!images) GTEST_SKIP() << name << " is not there; RELIDAR_SHARED names another folder";
        const OusterImages& scans = *images;
        const Log log = load_log(write_folder(scans, name, true).string(), {.max_range_m = 400.0});
        ASSERT_EQ(log.frames.size(), scans.frames);
        for (std::size_t f = 0; f < scans.frames; ++f) {
            std::size_t right = 0, all = 0;
            for (const std::size_t first :
                 // a firing at exactly +180 degrees may be the last
                 {std::size_t(0), std::size_t(1), scans.columns - 1}) {
                const Found match_counts = compare(scans, f, log.frames[f].scan, log.lidars[0].sensor, first);
                right = std::max(right, match_counts.right);
                all = match_counts.all;
            }
            EXPECT_GE(double(right), 0.999 * double(all)) << name << " frame " << f;
            EXPECT_EQ(log.frames[f].scan.count_returns(), all);
        }
    }
}

TEST(OusterFolder, BeamsAreFoundInThePoints) {
    const auto images = test::load_real_images("OS-1-128_v2.3.0_1024x10_lb_n3.npz", "", test::kSingle);
    if (!images) GTEST_SKIP() << "the scans are not there; RELIDAR_SHARED names another folder";
    const OusterImages& scans = *images;
    const Log log = load_log(write_folder(scans, "found", false).string(), {.max_range_m = 400.0});
    const SpinningSensor& sensor = log.lidars[0].sensor;
    EXPECT_EQ(sensor.columns, int(scans.columns));
    ASSERT_EQ(sensor.beams.size(), scans.rows);
    // The estimated elevation refers to the centre of the sensor. It differs from the
    // calibration by n sin(altitude) / range, which is 0.08 degrees at 4 m.
    for (std::size_t b = 0; b < scans.rows; ++b)
        EXPECT_NEAR(sensor.beams[b].elevation_rad * 180.0 / kPi, scans.altitude_deg[b], 0.1) << "beam " << b;
    for (std::size_t f = 0; f < scans.frames; ++f) {
        std::size_t all = 0;
        for (std::size_t i = 0; i < scans.rows * scans.columns; ++i)
            all += scans.range_mm[f * scans.rows * scans.columns + i] > 0;
        EXPECT_EQ(log.frames[f].scan.count_returns(), all);
    }
}

}  // namespace
}  // namespace relidar
