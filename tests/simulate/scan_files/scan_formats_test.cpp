// SPDX-License-Identifier: Apache-2.0
// Tests that every file of a scan contains the same number of returns, with a network
// that predicts a return for every ray. recorded_log_test.cpp tests recordings.

#include <gmock/gmock.h>
#include <png.h>

#include <relidar/read/dataset.hpp>
#include <relidar/simulate/place_points.hpp>
#include <relidar/simulate/scan_files.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../../support/device.hpp"
#include "../../support/drop_networks.hpp"
#include "../plates.hpp"

namespace relidar {
namespace {

constexpr int kBeams = 16, kSteps = 256;
constexpr double kHeight_m = 3.0;  // height of the sensor above a plate of 4 m

std::size_t count_rays_onto_plate(const RayTable& rays, double radius_m) {
    std::size_t n = 0;
    for (const glm::vec3& d : rays.direction)
        n += d.z < 0.0f && kHeight_m / -double(d.z) * std::hypot(double(d.x), double(d.y)) < radius_m;
    return n;
}

std::size_t count_behind(const std::string& text, const std::string& word) {
    return std::stoul(text.substr(text.find(word) + word.size()));
}

std::size_t count_below_half(const std::vector<float>& values) {
    return std::size_t(std::ranges::count_if(values, [](float value) { return value < 0.5f; }));
}

/// Counts the pixels of the first image (the ranges) whose colour differs from the colour
/// of the first pixel, which is sky.
std::size_t count_shown_pixels(const std::filesystem::path& path) {
    png_image text{};
    text.version = PNG_IMAGE_VERSION;
    EXPECT_TRUE(png_image_begin_read_from_file(&text, path.c_str())) << text.message;
    text.format = PNG_FORMAT_RGB;
    std::vector<std::uint8_t> rgb(PNG_IMAGE_SIZE(text));
    EXPECT_TRUE(png_image_finish_read(&text, nullptr, rgb.data(), 0, nullptr)) << text.message;
    EXPECT_EQ(text.width, unsigned(kSteps));
    const std::size_t stretch = std::size_t(std::max(1L, std::lround(kSteps / (8.0 * kBeams))));
    std::size_t n = 0;
    for (std::size_t row = 0; row < std::size_t(kBeams); ++row)
        for (std::size_t i = 0; i < std::size_t(kSteps); ++i) {
            const std::uint8_t* pixel = &rgb[3 * (row * stretch * std::size_t(kSteps) + i)];
            n += !std::equal(pixel, pixel + 3, rgb.begin());
        }
    return n;
}

class Returns : public test::DeviceTest {};

TEST_F(Returns, AreAsManyInEveryFormat) {
    Log log;
    SpinningSensor& sensor = log.lidars[0].sensor;
    sensor = {"sixteen", {}, kSteps};
    for (int row = 0; row < kBeams; ++row) sensor.beams.push_back({.elevation_rad = 0.3 - 0.06 * row});
    log.world_from_vehicle = {{1.0}, {Pose{{1, 0, 0, 0}, {0.0, 0.0, kHeight_m}}}};
    log.rolling_shutter = false;
    const Config config;
    const SimulatedSensor choice = make_sensor(config, log);
    ScanRenderer renderer(device(), wrap_background(test::make_plate({}, glm::vec2(4.0f), true)), config,
                          log);
    renderer.use_network(test::make_network_that_never_drops());
    const RenderedScan scan = renderer.render(choice, 1.0);
    const std::size_t n = place_points(scan, config, {}, PointSelection::first_returns).size();
    EXPECT_GT(n, count_rays_onto_plate(choice.rays, 4.0)) << "one standard deviation of the surfel";
    EXPECT_LT(n, count_rays_onto_plate(choice.rays, 4.0 * 5.0)) << "nobody sees five of them";

    const ScratchFolder files;
    ScanOutputOptions format;
    format.formats = {"npz", "exr", "png", "ply", "pcd", "bin"};
    ScanFolderWriter scans(files.path, format);
    scans.write_scan(0, scan);
    scans.finish();
    const auto file = [&](const char* extension) {
        return files.path / (std::string("frame_000000.") + extension);
    };
    EXPECT_EQ(count_below_half(find_array(read_npz(file("npz")), "drop_prob")->to_floats()), n);
    EXPECT_EQ(count_below_half(read_exr(file("exr")).channels.at("drop_prob")), n);
    EXPECT_EQ(count_shown_pixels(file("png")), n);
    EXPECT_EQ(count_behind(read_contents(file("ply")), "element vertex "), n);
    EXPECT_EQ(count_behind(read_contents(file("pcd")), "POINTS "), n);
    EXPECT_EQ(std::filesystem::file_size(file("bin")) / (4 * sizeof(float)), n);
}

/// A merged scan of a rig has no image rows. 5,000 rays need three lines of 2,048.
TEST(ScanPicture, RaysWithoutRowsAreDrawnInLines) {
    constexpr std::size_t kRays = 5000;
    RenderedScan scan;
    scan.image.range_m.assign(kRays, 10.0f);
    const Image picture = draw_scan(test::complete(scan));
    EXPECT_EQ(picture.columns, 2048);
    EXPECT_LT(picture.rows, 1000);
    const auto pixel_of = [&](std::size_t ray) {
        const std::size_t line_height = std::size_t(std::lround(2048 / (8.0 * 3)));
        return picture.rgb.data() + 3 * (ray / 2048 * line_height * 2048 + ray % 2048);
    };
    EXPECT_TRUE(std::equal(pixel_of(0), pixel_of(0) + 3, pixel_of(kRays - 1)));
    EXPECT_FALSE(std::equal(pixel_of(0), pixel_of(0) + 3, pixel_of(kRays))) << "there is no such ray";
}

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
    const Scan scan = load_log(folder.string(), {}).frames.at(0).scan;
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
    EXPECT_THROW(load_log(folder.string(), {}), DataError) << "its rays are no longer those of the sensor";
}

}  // namespace

}  // namespace relidar
