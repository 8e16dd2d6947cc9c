// SPDX-License-Identifier: Apache-2.0
// Tests that a rendering that was written as EXR can be read as a scan of a plain folder.
#include <gmock/gmock.h>

#include <relidar/read/dataset.hpp>
#include <relidar/simulate/scan_files.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../plates.hpp"

namespace relidar {
namespace {

using ExrScans = TemporaryFolder;

RenderedScan make_four_rays() {
    RenderedScan scan;
    scan.image.range_m = {10.0f, 12.0f, 7.0f, 55.125f};
    scan.image.intensity = {0.5f, 1.0f, 0.25f, 0.125f};
    scan.image.drop_prob = {0.0f, 0.1f, 0.9f, 0.4f};
    scan.image.origin.assign(4, glm::vec3(0.125f, 0.0f, -0.25f));
    scan.image.direction = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0.6f, 0.8f, 0.0f}};
    scan.median_range_m = {10.5f, 12.0f, 7.0f, 55.25f};
    scan.mean_range_m = {10.0f, 12.5f, 7.0f, 54.25f};
    scan.instance = {0, 1, -1, 0};
    scan.time_offset_s = {-0.05f, 0.05f, 0.0f, 0.025f};
    scan.ring = {1, 0, 1, 0};
    scan.second_returns = {{{0.0f, 14.0f, 0.0f, 0.0f}, {0.0f, 0.2f, 0.0f, 0.0f}}};
    scan.time_s = 3.0;
    return test::complete(std::move(scan));
}

TEST_F(ExrScans, AreReadAsScans) {
    ScanOutputOptions format;
    format.formats = {"exr"};
    RenderedScan truth = make_four_rays();
    const auto write = [&] {
        ScanFolderWriter scans(folder / "scans", format);
        scans.write_scan(5, truth);
        scans.finish();
    };
    std::filesystem::create_directories(folder / "scans");
    write();
    write_text_file(folder / "sequence.json", R"({"format": "relidar log", "version": 1, "rate_hz": 10})");
    write_text_file(folder / "poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n");
    const Scan scan = load_sequence(folder.string(), {}).frames.at(0).scan;
    EXPECT_THAT(scan.range_m, testing::ElementsAre(10.5f, 12.0f, 0.0f, 55.25f))
        << "the median, where the ray returns";
    EXPECT_THAT(scan.intensity, testing::ElementsAre(0.5f, 1.0f, 0.0f, 0.125f));
    EXPECT_EQ(to_vector(scan.rays.direction), truth.image.direction);
    EXPECT_EQ(to_vector(scan.rays.origin), truth.image.origin);
    EXPECT_EQ(to_vector(scan.rays.channel), truth.ring);
    EXPECT_EQ(to_vector(scan.rays.time_offset_s), truth.time_offset_s);
    ASSERT_EQ(scan.second_returns.size(), 1u);
    EXPECT_EQ(scan.second_returns[0].range_m, truth.second_returns[0].range_m);
    EXPECT_EQ(scan.second_returns[0].intensity, truth.second_returns[0].intensity);
    EXPECT_EQ(read_exr(folder / "scans" / "frame_000005.exr").channels.count("spread"), 0u);
    truth.channels = {{{.name = "spread"}, range_spread(truth)}};
    write();
    EXPECT_THAT(read_exr(folder / "scans" / "frame_000005.exr").channels.at("spread"),
                testing::ElementsAre(0.5f, 0.5f, 0.0f, 1.0f));
    format.deskew = true;
    write();
    EXPECT_THROW(load_sequence(folder.string(), {}), DataError)
        << "its rays are no longer those of the sensor";
}

}  // namespace
}  // namespace relidar
