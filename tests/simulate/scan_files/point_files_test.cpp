// SPDX-License-Identifier: Apache-2.0
// Tests PLY, PCD and KITTI .bin files. A small reader of ten lines reads them back:
// header lines as documented, then packed records.
#include <relidar/simulate/point_files.hpp>

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

Parsed parse(const std::filesystem::path& path) {
    Parsed parsed;
    const std::string file = read_contents(path);
    std::istringstream stream(file);
    for (std::string line; line != "end_header" && line != "DATA binary" && std::getline(stream, line);)
        parsed.header.push_back(line);
    parsed.body = file.substr(std::size_t(stream.tellg()));
    return parsed;
}

void expect_records(const std::string& body, const LidarPoints& cloud, std::size_t stride) {
    ASSERT_EQ(body.size(), cloud.position_m.size() * stride);
    for (std::size_t i = 0; i < cloud.position_m.size(); ++i) {
        for (int axis = 0; axis < 3; ++axis)
            EXPECT_EQ(read_at<float>(body, i * stride + 4 * std::size_t(axis)), cloud.position_m[i][axis]);
        EXPECT_EQ(read_at<float>(body, i * stride + 12), cloud.intensity[i]);
        if (stride != 26) continue;
        EXPECT_EQ(read_at<std::uint16_t>(body, i * stride + 16), cloud.ring[i]);
        EXPECT_EQ(read_at<float>(body, i * stride + 18), cloud.time_offset_s[i]);
        EXPECT_EQ(read_at<std::int32_t>(body, i * stride + 22), cloud.instance[i]);
    }
}

TEST_F(PointFiles, HaveTheFieldsOfTheCloudInTheirHeaders) {
    const LidarPoints full = make_some_cloud();
    LidarPoints plain = full;
    plain.ring.clear();
    plain.time_offset_s.clear();
    plain.instance.clear();
    for (const LidarPoints& cloud : {full, plain}) {
        std::vector<std::string> ply{"ply",
                                     "format binary_little_endian 1.0",
                                     "comment sensor VLP-16",
                                     "comment run a b",
                                     "element vertex 3",
                                     "property float x",
                                     "property float y",
                                     "property float z",
                                     "property float intensity"};
        const bool is_full = !cloud.ring.empty();
        if (is_full)
            ply.insert(ply.end(), {"property uint16 ring", "property float time", "property int instance"});
        ply.push_back("end_header");
        const std::vector<std::string> pcd{
            "# .PCD v0.7 - Point Cloud Data file format",
            "# sensor VLP-16",
            "# run a b",
            "VERSION 0.7",
            is_full ? "FIELDS x y z intensity ring time instance" : "FIELDS x y z intensity",
            is_full ? "SIZE 4 4 4 4 2 4 4" : "SIZE 4 4 4 4",
            is_full ? "TYPE F F F F U F I" : "TYPE F F F F",
            is_full ? "COUNT 1 1 1 1 1 1 1" : "COUNT 1 1 1 1",
            "WIDTH 3",
            "HEIGHT 1",
            "VIEWPOINT 1.25 -2000000 0.1 0.5 0.5 -0.5 0.5",
            "POINTS 3",
            "DATA binary"};
        write_ply(folder / "a.ply", cloud, kNotes);
        write_pcd(folder / "a.pcd", cloud, kNotes);
        EXPECT_EQ(parse(folder / "a.ply").header, ply);
        EXPECT_EQ(parse(folder / "a.pcd").header, pcd);
        for (const char* name : {"a.ply", "a.pcd"})
            expect_records(parse(folder / name).body, cloud, is_full ? 26 : 16);
    }
    write_kitti_bin(folder / "a.bin", full);
    expect_records(read_contents(folder / "a.bin"), full, 16);
}

/// A normal has other names in each format. Channels are behind the other fields.
TEST_F(PointFiles, HaveTheChannelsOfTheCloud) {
    const std::vector<float> spread{0.0f, 0.5f, 12.25f};
    const std::vector<glm::vec3> normal{{1.0f, 0.0f, 0.0f}, {0.0f, -1.0f, 0.0f}, {0.6f, 0.0f, 0.8f}};
    LidarPoints cloud = make_some_cloud();
    cloud.channels = {{{.name = "spread"}, spread}, {{.name = "normal", .turns = true}, normal}};
    write_ply(folder / "a.ply", cloud);
    write_pcd(folder / "a.pcd", cloud);
    EXPECT_NE(read_contents(folder / "a.ply")
                  .find("property int instance\nproperty float spread\nproperty float nx\nproperty float "
                        "ny\nproperty float nz\nend_header"),
              std::string::npos);
    EXPECT_NE(read_contents(folder / "a.pcd")
                  .find("\nFIELDS x y z intensity ring time instance spread normal_x normal_y normal_z\n"),
              std::string::npos);
    for (const char* name : {"a.ply", "a.pcd"}) {
        const std::string body = parse(folder / name).body;
        ASSERT_EQ(body.size(), 3u * 42u) << name;
        for (std::size_t i = 0; i < 3; ++i) {
            EXPECT_EQ(read_at<float>(body, 42 * i + 26), spread[i]) << name;
            EXPECT_EQ(read_at<glm::vec3>(body, 42 * i + 30), normal[i]) << name;
        }
    }
    for (const ChannelValues& values :
         {ChannelValues(std::vector<float>(2)), ChannelValues(std::vector<glm::vec3>(2))}) {
        cloud.channels = {{{.name = "short"}, values}};
        get_data_error_message([&] { write_ply(folder / "b.ply", cloud); });
    }
}

TEST_F(PointFiles, HaveAllFieldsOfAnEmptyCloud) {
    write_ply(folder / "a.ply", {});
    write_pcd(folder / "a.pcd", {});
    write_kitti_bin(folder / "a.bin", {});
    const Parsed pcd = parse(folder / "a.pcd"), ply = parse(folder / "a.ply");
    EXPECT_EQ(ply.header[2], "element vertex 0");
    EXPECT_EQ(ply.header.size(), 11u);
    EXPECT_EQ(pcd.header[2], "FIELDS x y z intensity ring time instance");
    EXPECT_EQ(pcd.body + read_contents(folder / "a.bin"), "");
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
