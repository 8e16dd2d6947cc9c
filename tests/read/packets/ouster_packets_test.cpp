// SPDX-License-Identifier: Apache-2.0
// Packets of images in every profile must give the pixels of the images (real images are
// skipped if RELIDAR_SHARED does not contain them).
#include <relidar/read/dataset.hpp>

#include <cmath>
#include <cstring>
#include <numeric>
#include <set>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "read/packets/ouster_packets.hpp"
#include "support/logs.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::Names;
using test::OusterImages;
using testing::AllOf;

constexpr const char* kProfileNames[] = {test::kLegacy,  test::kSingle,      test::kDual,
                                         test::kLowRate, test::kLowRateDual, test::kFusa};

fs::path make_fresh_folder(const std::string& name) {
    fs::path folder = fs::path(testing::TempDir()) / "relidar_ouster_packets" / name;
    fs::remove_all(folder);
    fs::create_directories(folder);
    return folder;
}

Log load(const fs::path& file, DatasetOptions options = {}) {
    options.max_range_m = 400.0;
    return load_log(file.string(), options);
}
std::string load_error(const fs::path& file) {
    return test::find_load_error(file.string(), {.max_range_m = 400.0});
}

fs::path write_capture(const OusterImages& images, const std::vector<test::Datagram>& datagrams) {
    const fs::path folder = make_fresh_folder("capture");
    test::write_pcap(folder / "drive.pcap", datagrams);
    test::write_text(folder / "drive.json", test::make_metadata(images, 7502));
    return folder / "drive.pcap";
}
fs::path write_capture(const OusterImages& images) {
    return write_capture(images, test::receive(test::make_packets(images)));
}

/// Skipped if relidar was built without the reader of captures.
class OusterPackets : public testing::Test {
protected:
    void SetUp() override {
        const std::string error = load_error(make_fresh_folder("none") / "none.pcap");
        if (error.find("RELIDAR_PCAP") != error.npos || error.find("RELIDAR_BAGS") != error.npos)
            GTEST_SKIP() << error;
    }
};

/// The column is the encoder position when the ray was fired.
std::pair<std::size_t, int> find_cell(const Scan& scan, std::size_t ray, const SpinningSensor& sensor) {
    const std::size_t ring = scan.rays.channel[ray];
    const glm::vec3 d = scan.rays.direction[ray];
    const double head = std::atan2(double(d.y), double(d.x)) - sensor.beams[ring].azimuth_offset_rad;
    const int column = int(std::lround((kPi - head) / (2.0 * kPi) * sensor.columns));
    return {ring, (column % sensor.columns + sensor.columns) % sensor.columns};
}

/// Returns true if a ray has the returns of a pixel. The direction and the origin of a
/// ray follow from Ouster's equation. Its LiDAR frame is rotated by 180 degrees about z.
bool is_ray_of_pixel(const OusterImages& images, std::size_t frame, std::size_t row, std::size_t column,
                     const Scan& scan, std::size_t ray, const RangeLimits& limits) {
    const std::size_t i = images.at(frame, row, column), at = frame * images.columns;
    using Echo = std::pair<std::uint32_t, std::uint32_t>;  // range in mm, reflectivity
    Echo first{images.range_mm[i], images.reflectivity[i]}, second{0, 0};
    if (images.is_dual()) second = {images.range_2_mm[i], images.reflectivity_2[i]};
    // The range starts at the origin of the beam, beside the axis.
    const auto range_of = [&](const Echo& echo) {
        return 1e-3 * (images.round_mm(echo.first) - images.n_mm);
    };
    for (Echo* echo : {&first, &second})
        if (range_of(*echo) < limits.min_m || range_of(*echo) > limits.max_m) *echo = {0, 0};
    if (second.first > 0 && (first.first == 0 || second.second > first.second)) std::swap(first, second);
    const auto is_echo = [&](const Echo& echo, float range_m, float intensity) {
        if (echo.first == 0) return range_m == 0.0f && intensity == 0.0f;
        return std::abs(range_m - range_of(echo)) < 1e-4 && intensity == float(echo.second / 255.0);
    };
    const auto turned = [](const glm::dvec3& p) { return glm::dvec3(-p.x, -p.y, p.z); };
    const glm::dvec3 origin = turned(images.compute_point(row, column, images.n_mm)),
                     ahead = turned(images.compute_point(row, column, images.n_mm + 1000.0));
    const double time_s =
        1e-9 * (double(images.time_ns[at + column]) - double(images.time_ns[at + images.columns / 2]));
    return is_echo(first, scan.range_m[ray], scan.intensity[ray]) &&
           (!images.is_dual() ||
            is_echo(second, scan.second_returns[0].range_m[ray], scan.second_returns[0].intensity[ray])) &&
           std::abs(double(scan.rays.time_offset_s[ray]) - time_s) < 1e-6 &&
           glm::distance(glm::dvec3(scan.rays.origin[ray]), origin) < 1e-5 &&
           glm::distance(glm::dvec3(scan.rays.direction[ray]), ahead - origin) < 2e-6;
}

void expect_same_log(const OusterImages& images, const Log& log) {
    SCOPED_TRACE(images.product + " " + images.profile);
    const SpinningSensor& sensor = log.lidars[0].sensor;
    ASSERT_EQ(log.frames.size(), images.frames);
    EXPECT_EQ(sensor.columns, int(images.columns));
    ASSERT_EQ(sensor.beams.size(), images.rows);
    std::vector<std::size_t> row_of_ring(images.rows);
    std::iota(row_of_ring.begin(), row_of_ring.end(), std::size_t(0));
    std::ranges::stable_sort(row_of_ring, std::greater(),
                             [&](std::size_t row) { return images.altitude_deg[row]; });
    const auto forward_ns = [&](std::size_t f) {
        return images.time_ns[f * images.columns + images.columns / 2];
    };
    for (std::size_t f = 0; f < images.frames; ++f) {
        const Scan& scan = log.frames[f].scan;
        EXPECT_NEAR(log.frames[f].time_s, 1e-9 * double(forward_ns(f) - forward_ns(0)), 1e-6);
        ASSERT_EQ(scan.rays.size(), images.rows * images.columns);
        ASSERT_EQ(scan.second_returns.size(), images.is_dual() ? 1u : 0u);
        std::set<std::pair<std::size_t, int>> cells;
        std::size_t n_wrong = 0;
        for (std::size_t ray = 0; ray < scan.rays.size(); ++ray) {
            const auto [ring, column] = *cells.insert(find_cell(scan, ray, sensor)).first;
            n_wrong += !is_ray_of_pixel(images, f, row_of_ring[ring], std::size_t(column), scan, ray,
                                        sensor.range_limits());
        }
        EXPECT_EQ(cells.size(), scan.rays.size());
        EXPECT_EQ(n_wrong, 0u) << "of " << cells.size();
    }
}

TEST_F(OusterPackets, RealScansAreThoseOfTheImages) {
    const std::pair<const char*, const char*> kReal[] = {{"OS-1-128_v2.3.0_1024x10_lb_n3.npz", "OS-1-128"},
                                                         {"OS-2-128-U1_v2.3.0_1024x10.npz", "OS-2-128"}};
    for (const auto& [name, product] : kReal)
        for (const char* profile : kProfileNames) {
            const std::optional<OusterImages> images = test::load_real_images(name, product, profile);
            if (!images) GTEST_SKIP() << name << " is not there; RELIDAR_SHARED names another folder";
            const Log loaded = load(write_capture(*images));
            EXPECT_THAT(test::join_lines(loaded.notes),
                        Names(fmt::format("{} packets ... 128-beam Ouster, {}, profile {}",
                                          64 * images->frames, product, profile)));
            expect_same_log(*images, loaded);
        }
}

TEST_F(OusterPackets, SmallScansAreThoseOfTheImages) {
    for (const char* profile : kProfileNames) {
        const OusterImages images = test::make_small_images(profile);
        const Log loaded = load(write_capture(images));
        EXPECT_EQ(loaded.frames[0].scan.second_returns.size(), images.is_dual() ? 1u : 0u);
        expect_same_log(images, loaded);
    }
}

TEST_F(OusterPackets, NestedMetadataSaysTheSame) {
    const OusterImages images = test::make_small_images(test::kSingle);
    const fs::path capture = write_capture(images);
    test::write_text(fs::path(capture).replace_extension(".json"), test::make_metadata(images, 7502, true));
    const Log loaded = load(capture);
    expect_same_log(images, loaded);
}

TEST_F(OusterPackets, ReflectivitiesOf16BitsCountAsThoseOfClouds) {
    OusterImages images = test::make_small_images(test::kLegacy);
    for (std::uint32_t& bright : images.reflectivity) bright *= 8;  // up to 2040
    const Log loaded = load(write_capture(images));
    EXPECT_THAT(test::join_lines(loaded.notes),
                AllOf(Names("reflectivities ... 2040"), Names("99.5th percentile")));
    float most = 0.0f;
    for (const float intensity : loaded.frames[0].scan.intensity) most = std::max(most, intensity);
    EXPECT_EQ(most, 1.0f);
}

struct Columns {
    std::vector<std::size_t> rays, returns;

    Columns(const Log& log, std::size_t frame)
        : rays(std::size_t(log.lidars[0].sensor.columns)), returns(rays.size()) {
        const Scan& scan = log.frames[frame].scan;
        for (std::size_t ray = 0; ray < scan.rays.size(); ++ray) {
            const auto column = std::size_t(find_cell(scan, ray, log.lidars[0].sensor).second);
            ++rays[column];
            returns[column] += scan.range_m[ray] > 0.0f;
        }
    }
};

TEST_F(OusterPackets, ColumnsThatWereNotMeasuredWereNotFired) {
    for (const char* profile : {test::kLegacy, test::kSingle}) {
        OusterImages images = test::make_small_images(profile);
        images.is_valid.assign(images.frames * images.columns, true);
        for (const std::size_t column : {0, 20, 21, 127}) images.is_valid[images.columns + column] = false;
        const Log loaded = load(write_capture(images));
        ASSERT_EQ(loaded.frames.size(), 4u);
        const Columns columns(loaded, 1), complete(loaded, 2);
        for (const std::size_t column : {0, 20, 21, 127}) EXPECT_EQ(columns.rays[column], 0u) << column;
        EXPECT_EQ(columns.rays[19], 3u * images.rows);  // also has the rays of missing columns
        EXPECT_EQ(std::ranges::count(complete.rays, images.rows), std::ptrdiff_t(images.columns));
        EXPECT_THAT(test::join_lines(loaded.notes), testing::Not(Names("missing")));
    }
}

TEST_F(OusterPackets, ASectorThatWasNotMeasuredHasNoReturn) {
    OusterImages images = test::make_small_images(test::kSingle);
    for (std::size_t k = 0; k < images.frames * images.columns; ++k)
        images.is_valid.push_back(k % 128 < 40 || k % 128 >= 70);
    const Log loaded = load(write_capture(images));
    ASSERT_EQ(loaded.frames.size(), 4u);
    const Columns columns(loaded, 1);
    for (std::size_t column = 0; column < images.columns; ++column) {
        EXPECT_EQ(columns.rays[column], images.rows) << column;
        EXPECT_EQ(columns.returns[column] > 0, images.is_valid[column]) << column;
    }
}

TEST_F(OusterPackets, TheOnlyMetadataMayNameAnotherPort) {
    const OusterImages images = test::make_small_images(test::kLegacy);
    const Log loaded = load(write_capture(images, test::receive(test::make_packets(images), 7512)));
    expect_same_log(images, loaded);
}

TEST_F(OusterPackets, RaysOfMissingPacketsAreUnknown) {
    const OusterImages images = test::make_small_images(test::kSingle);
    auto datagrams = test::receive(test::make_packets(images));
    datagrams[10].bytes.resize(500);          // columns 32 to 47 of frame 1
    datagrams.erase(datagrams.begin() + 15);  // columns 112 to 127, the end of the turn
    const Log loaded = load(write_capture(images, datagrams));
    ASSERT_EQ(loaded.frames.size(), 4u);
    EXPECT_THAT(test::join_lines(loaded.notes), Names("2 packets ... missing"));
    const Columns columns(loaded, 1);
    for (std::size_t column = 0; column < images.columns; ++column) {
        const bool is_missing = column / 16 == 2 || column / 16 == 7;
        EXPECT_EQ(columns.rays[column], is_missing ? 0u : images.rows) << column;
        EXPECT_EQ(columns.returns[column] == 0, is_missing) << column;
    }
}

TEST_F(OusterPackets, ATurnWithoutMostOfItsPacketsIsLeftOut) {
    const OusterImages images = test::make_small_images(test::kDual);
    auto datagrams = test::receive(test::make_packets(images));
    datagrams.erase(datagrams.begin() + 9, datagrams.begin() + 15);  // packets of frame 1
    const Log loaded = load(write_capture(images, datagrams));
    ASSERT_EQ(loaded.frames.size(), 3u);
    EXPECT_NEAR(loaded.frames[1].time_s, 2 * 128 * 781250e-9, 1e-6);
    EXPECT_THAT(test::join_lines(loaded.notes), Names("1 revolutions"));
}

TEST_F(OusterPackets, AWindowOfColumnsIsTheWholeTurn) {
    for (const auto& [first, last] :
         std::vector<std::pair<int, int>>{{32, 95}, {5, 40}, {0, 63}, {100, 127}}) {
        SCOPED_TRACE(fmt::format("{} to {}", first, last));
        OusterImages images = test::make_small_images(test::kLowRate);
        images.first = std::size_t(first);
        images.last = std::size_t(last);
        const Log loaded = load(write_capture(images));
        ASSERT_EQ(loaded.frames.size(), 4u);
        EXPECT_THAT(test::join_lines(loaded.notes), testing::Not(Names("missing")));
        for (std::size_t f = 0; f < 4; ++f) {
            EXPECT_EQ(loaded.frames[f].scan.rays.columns, last - first + 1);
            const Columns columns(loaded, f);
            for (std::size_t column = 0; column < images.columns; ++column)
                EXPECT_EQ(columns.rays[column], images.is_in_window(column) ? images.rows : 0u) << column;
            EXPECT_NEAR(loaded.frames[f].time_s, double(f) * 128 * 781250e-9, 1e-5);
        }
    }
}

TEST_F(OusterPackets, AClockSinceBootAndOneOfPtpAreTheSame) {
    OusterImages images = test::make_small_images(test::kSingle);
    const Log boot = load(write_capture(images));
    for (std::uint64_t& ns : images.time_ns) ns += 1700000000000000000;
    const Log ptp = load(write_capture(images, test::receive(test::make_packets(images), 7502, 0)));
    ASSERT_EQ(ptp.frames.size(), 4u);
    for (std::size_t f = 0; f < 4; ++f) {
        EXPECT_EQ(boot.frames[f].time_s, ptp.frames[f].time_s);
        EXPECT_EQ(boot.frames[f].scan.rays.time_offset_s, ptp.frames[f].scan.rays.time_offset_s);
        EXPECT_EQ(boot.frames[f].scan.range_m, ptp.frames[f].scan.range_m);
    }
}

// A sensor on PTP has TAI, which is 37 s ahead of UTC, the clock of the capture.
TEST_F(OusterPackets, PosesMayHaveTheClockOfTheSensor) {
    constexpr std::int64_t kSecond_ns = 1000000000;
    OusterImages images = test::make_small_images(test::kSingle);
    for (std::uint64_t& ns : images.time_ns) ns += 1700000032 * kSecond_ns;  // from 1700000037 s
    const fs::path capture =
        write_capture(images, test::receive(test::make_packets(images), 7502, -37 * kSecond_ns));
    std::string poses;
    for (int k = -20; k < 30; ++k)
        poses += fmt::format("{:.2f} {:.2f} 0 0 1 0 0 0\n", 1700000037 + 0.05 * k, 0.5 * k);
    const fs::path poses_file = capture.parent_path() / "poses.txt";
    test::write_text(poses_file, poses);
    const Log loaded = load(capture, {.poses_file = poses_file});
    EXPECT_THAT(test::join_lines(loaded.notes), Names("37.000 s"));
    for (std::size_t f = 0; f < images.frames; ++f) {
        const double measured_s =
            1e-9 * double(images.time_ns[f * images.columns + images.columns / 2] - 1700000037 * kSecond_ns);
        EXPECT_NEAR(loaded.world_from_vehicle.pose[f].translation.x + loaded.world_offset_m.x,
                    10.0 * measured_s, 0.02);  // the packets arrive 0.2 ms to 1 ms late
    }
}

TEST_F(OusterPackets, TwoSensorsHaveTheirOwnMetadata) {
    const OusterImages one = test::make_small_images(test::kSingle);
    OusterImages other = test::make_small_images(test::kSingle);
    other.product = "OS-0-16";
    other.n_mm = 27.0;
    for (std::uint32_t& mm : other.range_mm) mm += mm > 0 ? 1000 : 0;
    auto datagrams = test::receive(test::make_packets(one));
    std::ranges::copy(test::receive(test::make_packets(other), 7504), std::back_inserter(datagrams));
    // packets of the IMU
    for (int k = 0; k < 40; ++k)
        datagrams.push_back({datagrams[0].stamp_ns + k * 10000000, std::string(48, '\1'), 7503});
    std::ranges::stable_sort(datagrams, {}, &test::Datagram::stamp_ns);
    const fs::path folder = make_fresh_folder("two");
    test::write_pcap(folder / "drive.pcap", datagrams);
    test::write_text(folder / "front.json", test::make_metadata(one, 7502));
    test::write_text(folder / "rear.json", test::make_metadata(other, 7504));
    test::write_text(folder / "notes.json", R"({"weather": "fair"})");
    for (const auto& [port, images] : {std::pair(7502, &one), std::pair(7504, &std::as_const(other))}) {
        const Log loaded = load(folder / "drive.pcap", {.lidars = {fmt::format("192.168.1.201:{}", port)}});
        expect_same_log(*images, loaded);
        EXPECT_THAT(test::join_lines(loaded.notes), testing::Not(Names("expected")));
    }
    test::write_text(folder / "rear.json", test::make_metadata(other, 7502));
    EXPECT_THAT(load_error(folder / "drive.pcap"), Names("3328 ... port 7502"));
    fs::remove(folder / "rear.json");
    // Packets must not be decoded with the metadata of another sensor.
    const Log half = load(folder / "drive.pcap");
    EXPECT_THAT(test::join_lines(half.notes), Names("3328 ... port 7504"));
    expect_same_log(one, half);
}

TEST_F(OusterPackets, WhatIsWrongIsSaidInOneLine) {
    const OusterImages images = test::make_small_images(test::kSingle);
    const auto error_with = [&](const std::string& metadata) {
        const fs::path capture = write_capture(images);
        test::write_text(fs::path(capture).replace_extension(".json"), metadata);
        return load_error(capture);
    };
    const fs::path bare = write_capture(images);
    fs::remove(fs::path(bare).replace_extension(".json"));
    EXPECT_THAT(load_error(bare), Names("3328 ... port 7502 ... drive.json"));
    const std::string metadata = test::make_metadata(images, 7502);
    EXPECT_THAT(error_with(metadata.substr(0, metadata.size() / 2)), Names("drive.json ... truncated"));
    const std::array<const char*, 3> cases[] = {
        {test::kSingle, "RNG15_RFL8_NIR8_ZONE16", "RNG15_RFL8_NIR8_ZONE16 ... LEGACY"},
        {test::kSingle, test::kDual,
         "3328 ... port 7502 ... 4352 ... RNG19_RFL8_SIG16_NIR16_DUAL, 16 ... 16"},
        {"\"columns_per_frame\": 128", "\"columns_per_frame\": 1024", "columns_per_frame ... 1024 ... 128"},
        {"\"pixels_per_column\": 16", "\"pixels_per_column\": 64", "pixels_per_column ... 64 ... 16"},
        {"[0, 127]", "[0, 128]", "column_window"},
        {"\"columns_per_packet\": 16", "\"columns_per_packet\": 24", "divisor"},
        {"\"lidar_mode\": \"128x10\"", "\"lidar_mode\": \"64x10\"", "columns_per_frame ... 128"},
    };
    for (const auto& [from, to, parts] : cases) {
        std::string text = metadata;
        EXPECT_THAT(error_with(text.replace(text.find(from), std::strlen(from), to)),
                    Names(std::string(parts)));
    }
    auto datagrams = test::receive(test::make_packets(images));
    for (test::Datagram& datagram : datagrams) datagram.bytes[0] = 2;
    EXPECT_THAT(load_error(write_capture(images, datagrams)), Names("2 ... 1 ... LiDAR"));
    for (test::Datagram& datagram : datagrams) {
        datagram.bytes[0] = 1;
        datagram.bytes[32 + 9] = 4;  // column 1024 and above
    }
    EXPECT_THAT(load_error(write_capture(images, datagrams)), Names("128 ... lidar_mode"));
}

}  // namespace
}  // namespace relidar
