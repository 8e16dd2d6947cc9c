// SPDX-License-Identifier: Apache-2.0
// Tests PLY, PCD and KITTI .bin files. A small reader of ten lines reads them back:
// header lines as documented, then packed records.
#include <relidar/simulate/point_files.hpp>

#include <cstring>
#include <sstream>

#include "base/codecs/temporary_folder.hpp"

namespace relidar {
namespace {

using PointFiles = TemporaryFolder;

const FileMetadata kNotes = {{"sensor", "VLP-16"}, {"run", "a\nb"}};

LidarPoints make_some_cloud() {
    LidarPoints cloud;
    cloud.position_m = {{1.5f, -2.0f, 0.25f}, {10.0f, 20.0f, 30.0f}, {-0.5f, 0.0f, 80.0f}};
    cloud.intensity = {0.1f, 0.5f, 1.0f};
    cloud.ring = {0, 63, 65535};
    cloud.time_offset_s = {-0.05f, 0.0f, 0.05f};
    cloud.instance = {0, 70000, -1};
    cloud.world_from_points = {glm::dquat(0.5, 0.5, -0.5, 0.5), glm::dvec3(1.25, -2e6, 0.1)};
    return cloud;
}

struct Parsed {
    std::vector<std::string> header;
    std::string body;
};

Parsed parse(const std::string& file, const std::string& last_line) {
    Parsed parsed;
    std::istringstream stream(file);
    for (std::string line; std::getline(stream, line);) {
        parsed.header.push_back(line);
        if (line == last_line) break;
    }
    parsed.body = file.substr(std::size_t(stream.tellg()));
    return parsed;
}

template <class T>
T value_at(const std::string& bytes, std::size_t offset) {
    T value;
    std::memcpy(&value, bytes.data() + offset, sizeof value);
    return value;
}

void expect_records(const std::string& body, const LidarPoints& cloud, std::size_t stride) {
    ASSERT_EQ(body.size(), cloud.position_m.size() * stride);
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        for (int axis = 0; axis < 3; ++axis)
            EXPECT_EQ(value_at<float>(body, i * stride + 4 * std::size_t(axis)), cloud.position_m[i][axis]);
        EXPECT_EQ(value_at<float>(body, i * stride + 12), cloud.intensity[i]);
        if (stride != 26) continue;
        EXPECT_EQ(value_at<std::uint16_t>(body, i * stride + 16), cloud.ring[i]);
        EXPECT_EQ(value_at<float>(body, i * stride + 18), cloud.time_offset_s[i]);
        EXPECT_EQ(value_at<std::int32_t>(body, i * stride + 22), cloud.instance[i]);
    }
}

TEST_F(PointFiles, WritesPly) {
    write_ply(folder / "a.ply", make_some_cloud(), kNotes);
    const Parsed file = parse(read_contents(folder / "a.ply"), "end_header");
    const std::vector<std::string> expected{"ply",
                                            "format binary_little_endian 1.0",
                                            "comment sensor VLP-16",
                                            "comment run a b",
                                            "element vertex 3",
                                            "property float x",
                                            "property float y",
                                            "property float z",
                                            "property float intensity",
                                            "property uint16 ring",
                                            "property float time",
                                            "property int instance",
                                            "end_header"};
    EXPECT_EQ(file.header, expected);
    expect_records(file.body, make_some_cloud(), 26);
}

TEST_F(PointFiles, WritesPcd) {
    write_pcd(folder / "a.pcd", make_some_cloud(), kNotes);
    const Parsed file = parse(read_contents(folder / "a.pcd"), "DATA binary");
    const std::vector<std::string> expected{"# .PCD v0.7 - Point Cloud Data file format",
                                            "# sensor VLP-16",
                                            "# run a b",
                                            "VERSION 0.7",
                                            "FIELDS x y z intensity ring time instance",
                                            "SIZE 4 4 4 4 2 4 4",
                                            "TYPE F F F F U F I",
                                            "COUNT 1 1 1 1 1 1 1",
                                            "WIDTH 3",
                                            "HEIGHT 1",
                                            "VIEWPOINT 1.25 -2000000 0.1 0.5 0.5 -0.5 0.5",
                                            "POINTS 3",
                                            "DATA binary"};
    EXPECT_EQ(file.header, expected);
    expect_records(file.body, make_some_cloud(), 26);
}

TEST_F(PointFiles, LeavesOutFieldsThatAreMissing) {
    LidarPoints cloud = make_some_cloud();
    cloud.ring.clear();
    cloud.time_offset_s.clear();
    cloud.instance.clear();
    write_ply(folder / "a.ply", cloud);
    write_pcd(folder / "a.pcd", cloud);
    expect_records(parse(read_contents(folder / "a.ply"), "end_header").body, cloud, 16);
    const Parsed pcd = parse(read_contents(folder / "a.pcd"), "DATA binary");
    EXPECT_EQ(pcd.header[2], "FIELDS x y z intensity");
    EXPECT_EQ(pcd.header[3], "SIZE 4 4 4 4");
    EXPECT_EQ(pcd.header[4], "TYPE F F F F");
    EXPECT_EQ(pcd.header[5], "COUNT 1 1 1 1");
    expect_records(pcd.body, cloud, 16);
}

TEST_F(PointFiles, WritesTheSpreadBehindTheOtherFields) {
    LidarPoints cloud = make_some_cloud();
    const std::vector<float> spread{0.0f, 0.5f, 12.25f};
    cloud.channels = {{{.name = "spread"}, spread}};
    write_ply(folder / "a.ply", cloud);
    write_pcd(folder / "a.pcd", cloud);
    EXPECT_NE(
        read_contents(folder / "a.ply").find("property int instance\nproperty float spread\nend_header"),
        std::string::npos);
    EXPECT_NE(read_contents(folder / "a.pcd").find("\nFIELDS x y z intensity ring time instance spread\n"),
              std::string::npos);
    for (const auto& [name, last] : {std::pair("a.ply", "end_header"), {"a.pcd", "DATA binary"}}) {
        const std::string body = parse(read_contents(folder / name), last).body;
        ASSERT_EQ(body.size(), 3u * 30u) << name;
        for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(value_at<float>(body, 30 * i + 26), spread[i]) << name;
    }
    cloud.channels = {{{.name = "spread"}, std::vector<float>(2)}};
    EXPECT_THROW(write_ply(folder / "b.ply", cloud), DataError);
}

TEST_F(PointFiles, WritesNormalsByTheNamesOfEachFormat) {
    LidarPoints cloud = make_some_cloud();
    cloud.ring.clear();
    cloud.time_offset_s.clear();
    cloud.instance.clear();
    const std::vector<glm::vec3> normal{{1.0f, 0.0f, 0.0f}, {0.0f, -1.0f, 0.0f}, {0.6f, 0.0f, 0.8f}};
    cloud.channels = {{{.name = "normal", .turns = true}, normal}};
    write_ply(folder / "a.ply", cloud);
    write_pcd(folder / "a.pcd", cloud);
    const Parsed ply = parse(read_contents(folder / "a.ply"), "end_header"),
                 pcd = parse(read_contents(folder / "a.pcd"), "DATA binary");
    EXPECT_NE(read_contents(folder / "a.ply")
                  .find("property float nx\nproperty float ny\nproperty float nz\nend_header"),
              std::string::npos);
    EXPECT_NE(read_contents(folder / "a.pcd").find("\nFIELDS x y z intensity normal_x normal_y normal_z\n"),
              std::string::npos);
    EXPECT_EQ(ply.body, pcd.body);
    ASSERT_EQ(ply.body.size(), 3u * 28u);
    for (std::size_t i = 0; i < 3; ++i)
        for (int axis = 0; axis < 3; ++axis)
            EXPECT_EQ(value_at<float>(ply.body, 28 * i + 16 + 4 * std::size_t(axis)), normal[i][axis]);
    cloud.channels = {{{.name = "normal"}, std::vector<glm::vec3>(2)}};
    get_data_error_message([&] { write_ply(folder / "b", cloud); });
}

TEST_F(PointFiles, WritesKittiBin) {
    write_kitti_bin(folder / "a.bin", make_some_cloud());
    expect_records(read_contents(folder / "a.bin"), make_some_cloud(), 16);
}

TEST_F(PointFiles, WritesEmptyCloudsWithAllFields) {
    write_ply(folder / "a.ply", {});
    write_pcd(folder / "a.pcd", {});
    write_kitti_bin(folder / "a.bin", {});
    const Parsed pcd = parse(read_contents(folder / "a.pcd"), "DATA binary");
    EXPECT_EQ(parse(read_contents(folder / "a.ply"), "end_header").header[2], "element vertex 0");
    EXPECT_NE(read_contents(folder / "a.ply")
                  .find("property uint16 ring\nproperty float time\nproperty int instance\nend_header"),
              std::string::npos);
    EXPECT_EQ(pcd.header[2], "FIELDS x y z intensity ring time instance");
    EXPECT_EQ(pcd.body, "");
    EXPECT_EQ(read_contents(folder / "a.bin"), "");
}

TEST_F(PointFiles, RefusesArraysOfUnequalLength) {
    for (int which : {0, 1, 2, 3}) {
        LidarPoints cloud = make_some_cloud();
        if (which == 0) cloud.intensity.pop_back();
        if (which == 1) cloud.ring.pop_back();
        if (which == 2) cloud.time_offset_s.pop_back();
        if (which == 3) cloud.instance.pop_back();
        get_data_error_message([&] { write_ply(folder / "a", cloud); });
        get_data_error_message([&] { write_pcd(folder / "a", cloud); });
        get_data_error_message([&] { write_kitti_bin(folder / "a", cloud); });
    }
    EXPECT_TRUE(files().empty());
}

}  // namespace
}  // namespace relidar
