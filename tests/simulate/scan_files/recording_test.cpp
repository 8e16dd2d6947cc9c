// SPDX-License-Identifier: Apache-2.0
// Tests recordings as files. They must be created completely or not at all, and their
// index must be correct. Also tests times that cannot be stored.
// tests/tools/recordings_test.sh reads the messages with other programs.

#include <gmock/gmock.h>
#include <zlib.h>

#include <relidar/simulate/scan_packets.hpp>

#include "../../base/codecs/temporary_folder.hpp"
#include "../plates.hpp"
#include "base/codecs/unpack.hpp"
#include "simulate/scan_files/recorded_moment.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using test::Names;
using testing::ElementsAre;
using testing::UnorderedElementsAre;

constexpr const char* kMagic = "\x89MCAP0\r\n";

/// Fired before and after the time of the scan. One ray has a second return.
RenderedScan make_two_rays(double time_s) {
    RenderedScan scan;
    scan.image = {1, 2, {10.0f, 12.0f}, {0.5f, 1.0f}, {0.0f, 0.1f}, {}, {2, glm::vec3(1.0f, 0.0f, 0.0f)}};
    scan.instance = {0, 1};
    scan.time_offset_s = {-0.05f, 0.05f};
    scan.ring = {0, 1};
    scan.second_returns = {{{0.0f, 14.0f}, {0.0f, 0.2f}}};
    scan.time_s = time_s;
    return test::complete(std::move(scan));
}

struct Record {
    std::size_t begin, body, end;  ///< positions in the file
};

/// By record code.
/// @param offset start of the first record
std::multimap<int, Record> records(const std::string& bytes, std::size_t offset, std::size_t end) {
    std::multimap<int, Record> records_by_code;
    while (offset < end) {
        const std::size_t body = offset + 9, next = body + read_at<std::uint64_t>(bytes, offset + 1);
        EXPECT_LE(next, end);
        records_by_code.insert({static_cast<unsigned char>(bytes[offset]), {offset, body, next}});
        offset = next;
    }
    return records_by_code;
}

class Recordings : public TemporaryFolder {
protected:
    ScanOutputOptions format;

    void SetUp() override {
        TemporaryFolder::SetUp();
        format.formats = {"mcap", "rosbag"};
    }
};

TEST_F(Recordings, AppearWhenTheyAreFinished) {
    ScanFolderWriter scans(folder, format);
    scans.write_scan(0, make_two_rays(1.0));
    for (const std::string& name : files())
        EXPECT_EQ(name.front(), '.') << name << ": nothing has a final name yet";
    scans.finish();
    EXPECT_THAT(files(), UnorderedElementsAre("scans.mcap", "rosbag.mcap", "scans.json"));
    EXPECT_THAT(read_contents(folder / "scans.json"),
                testing::HasSubstr("\"recordings\": [\n  \"scans.mcap\",\n  \"rosbag.mcap\"\n ]"));
    EXPECT_EQ(list_scan_files(folder).size(), 3u) << "the next rendering knows them";
}

/// The second ray faces the car after 62.5 ms, in which the car drives 0.625 m.
TEST_F(Recordings, ScansJsonHasTheBoxesAtTheTimeOfTheirRay) {
    format.instance_names = {"background", "car"};
    format.actors = {{.id = "car",
                      .category = "Van",
                      .size_m = {4.0, 2.0, 1.5},
                      .world_from_box = {
                          {0.0, 2.0}, {{{1, 0, 0, 0}, {0.0, -5.0, 0.0}}, {{1, 0, 0, 0}, {0.0, 15.0, 0.0}}}}}};
    ScanFolderWriter scans(folder, format);
    RenderedScan scan = make_two_rays(1.0);
    scan.time_offset_s = {-0.0625f, 0.0625f};
    scan.image.direction[1] = {0.0f, 1.0f, 0.0f};
    scan.actor_views = {{"car", 3, 4}};
    scans.write_scan(0, scan);
    scan.actor_views.clear();
    scans.write_scan(1, scan);
    scans.finish();
    std::string text = read_contents(folder / "scans.json");
    std::erase_if(text, [](char character) { return character == ' ' || character == '\n'; });
    EXPECT_THAT(
        text,
        testing::HasSubstr(
            R"("boxes":[{"track":"car","class":"Van","label":"Van","is_discovered":false,)"
            R"("is_static":false,"note":"","size_m":[4.0,2.0,1.5],"time_s":1.0625,"world_from_box":[[1.0,0.0,0.0,)"
            R"(0.0],[0.0,1.0,0.0,5.625],[0.0,0.0,1.0,0.0],[0.0,0.0,0.0,1.0]],)"));
    EXPECT_THAT(text, testing::HasSubstr(R"("points":1,"visible_share":0.75}])"));
    EXPECT_THAT(text, testing::HasSubstr(R"("boxes":[])")) << "views were not computed";
}

TEST_F(Recordings, LeaveNothingWhereTheRenderingWasInterrupted) {
    {
        ScanFolderWriter scans(folder, format);
        scans.write_scan(0, make_two_rays(1.0));
    }
    EXPECT_THAT(files(), ElementsAre());
}

TEST_F(Recordings, IndexLeadsToChunksAndTheirMessages) {
    ScanFolderWriter scans(folder, format);
    for (int i = 0; i < 3; ++i) scans.write_scan(i, make_two_rays(1.0 + 0.1 * i));
    scans.finish();
    for (const char* name : {"scans.mcap", "rosbag.mcap"}) {
        const std::string bytes = read_contents(folder / name);
        ASSERT_EQ(bytes.substr(0, 8), kMagic);
        ASSERT_EQ(bytes.substr(bytes.size() - 8), kMagic);
        const auto all = records(bytes, 8, bytes.size() - 8);
        // the summary offset in the footer
        const std::size_t summary = read_at<std::uint64_t>(bytes, all.find(2)->second.body);
        ASSERT_EQ(all.find(15)->second.end, summary) << "behind the end of data";
        ASSERT_EQ(all.count(6), 3u);
        ASSERT_EQ(all.count(8), 3u);
        const auto [first, last] = all.equal_range(8);
        for (auto index = first; index != last; ++index) {
            const std::size_t at = index->second.body, chunk = read_at<std::uint64_t>(bytes, at + 16);
            EXPECT_EQ(bytes[chunk], 6);
            const std::uint64_t size = read_at<std::uint64_t>(bytes, chunk + 9 + 16);
            // Behind size, checksum, the name "zstd" and the packed size.
            ASSERT_EQ(bytes.substr(chunk + 9 + 32, 4), "zstd");
            const std::uint64_t packed_size = read_at<std::uint64_t>(bytes, chunk + 9 + 36);
            const std::size_t packed = chunk + read_at<std::uint64_t>(bytes, at + 24) - packed_size;
            std::string inside(size, '\0');
            decompress_zstd(std::string_view(bytes).substr(packed, packed_size), inside);
            EXPECT_EQ(read_at<std::uint32_t>(bytes, chunk + 9 + 24),
                      crc32(0, reinterpret_cast<const Bytef*>(inside.data()), uInt(size)));
            std::size_t n_indexed = 0;
            // entries of 2 + 8 bytes
            for (std::uint32_t entry_offset = 0; entry_offset < read_at<std::uint32_t>(bytes, at + 32);
                 entry_offset += 10) {
                const std::size_t entry = read_at<std::uint64_t>(bytes, at + 36 + entry_offset + 2);
                EXPECT_EQ(bytes[entry], 7) << "a message index";
                EXPECT_EQ(read_at<std::uint16_t>(bytes, entry + 9),
                          read_at<std::uint16_t>(bytes, at + 36 + entry_offset));
                EXPECT_EQ(inside[read_at<std::uint64_t>(bytes, entry + 9 + 2 + 4 + 8)], 5);
                n_indexed += read_at<std::uint32_t>(bytes, entry + 9 + 2) / 16;
            }
            EXPECT_EQ(records(inside, 0, size).count(5), n_indexed);
            EXPECT_EQ(read_at<std::uint32_t>(bytes, at + 32) / 10, all.count(4) / 2);
        }
    }
}

TEST_F(Recordings, AllTimesHaveTheShiftOfTheRun) {
    const auto first_stamp_ns = [&](std::int64_t time_shift_ns, double scan_s) {
        format.time_shift_ns = time_shift_ns;
        ScanFolderWriter scans(folder, format);
        scans.write_scan(0, make_two_rays(scan_s));  // its first ray is fired 0.05 s earlier
        scans.finish();
        const std::string bytes = read_contents(folder / "rosbag.mcap");
        const auto all = records(bytes, 8, bytes.size() - 8);
        return read_at<std::uint64_t>(bytes, all.find(8)->second.body);  // of the first chunk
    };
    EXPECT_EQ(first_stamp_ns(1'000'000'000, 0.0), 950'000'000u);
    EXPECT_THAT(read_contents(folder / "rosbag.mcap"),
                testing::HasSubstr(std::string("time_shift_s\1\0\0\0001", 17)));
    EXPECT_EQ(first_stamp_ns(1'000'000'000, 0.5), 1'450'000'000u) << "later scans have the same shift";
    EXPECT_EQ(first_stamp_ns(0, 0.5), 450'000'000u) << "not 449,999,999, although -0.05f is not -0.05";
    EXPECT_EQ(first_stamp_ns(1317042145594360375, 10.0), 1317042155544360375u) << "nanoseconds of a date";
    for (const char* name : {"rosbag.mcap", "scans.mcap"})
        EXPECT_THAT(read_contents(folder / name), testing::HasSubstr("1317042145.594360375")) << name;
    EXPECT_THAT(read_contents(folder / "scans.json"),
                testing::HasSubstr("\"time_shift_ns\": 1317042145594360375"));
    EXPECT_THAT(get_data_error_message([&] { first_stamp_ns(0, 0.0); }), Names("0 s ... -0.050 ... 0.050"));
}

/// Packets must have the times of the other files: the first ray of the scan is fired at
/// 1.95 s of the log.
TEST_F(Recordings, PacketsHaveTheSameTimes) {
    const auto sensor = std::get<SpinningSensor>(find_built_in("VLP-16")->pattern);
    format.packets.sensor = sensor;
    RenderedScan scan;
    const RayTable rays = make_rays(sensor);
    scan.image = {rays.rows,
                  rays.columns,
                  std::vector(rays.size(), 10.0f),
                  std::vector(rays.size(), 0.5f),
                  std::vector(rays.size(), 0.0f),
                  {rays.origin.begin(), rays.origin.end()},
                  {rays.direction.begin(), rays.direction.end()}};
    scan.median_range_m = scan.mean_range_m = scan.image.range_m;
    scan.time_offset_s = {rays.time_offset_s.begin(), rays.time_offset_s.end()};
    scan.ring = {rays.channel.begin(), rays.channel.end()};
    scan.time_s = 2.0;
    const double first_s = 2.0 + double(*std::ranges::min_element(scan.time_offset_s));
    for (const std::int64_t shift_ns : {std::int64_t(0), std::int64_t(1317042145594360375)}) {
        format.time_shift_ns = shift_ns;
        ScanPacketEncoder encoder({format});
        const auto packets = encoder.encode({&scan, 1});
        ASSERT_FALSE(packets[0].empty());
        // A packet begins up to 12 blocks before the first ray.
        EXPECT_NEAR(double(packets[0][0].time_ns - shift_ns), 1e9 * first_s, 1e9 * 12 * 110.592e-6);
    }
    format.time_shift_ns = 0;
    scan.time_s = 0.0;
    EXPECT_THAT(get_data_error_message([&] {
                    ScanPacketEncoder({format}).encode({&scan, 1});
                }),
                Names("0 s"));
}

TEST_F(Recordings, FilesOfOthersStay) {
    format.formats = {"npz", "rosbag"};
    for (const char* name : {"rosbag.mcap", "packets.csv", "frame_000007.npz", "scans.json"}) {
        put(folder / name, "of the user");
        EXPECT_THAT(list_scan_files(folder), ElementsAre()) << name;
        EXPECT_EQ(find_foreign_file(folder).filename(), name);
        EXPECT_THAT(error_message<UsageError>([&] { ScanFolderWriter(folder, format); }), Names(name));
        EXPECT_EQ(read_contents(folder / name), "of the user");
        std::filesystem::remove(folder / name);
    }
    put(folder / "notes.txt", "of the user");
    {
        ScanFolderWriter interrupted(folder, format);
        interrupted.write_scan(3, make_two_rays(1.0));
    }
    EXPECT_EQ(list_scan_files(folder).size(), 1u) << "files of an interrupted rendering are known";
    ScanFolderWriter scans(folder, format);
    scans.write_scan(4, make_two_rays(1.0));
    scans.finish();
    EXPECT_THAT(files(), UnorderedElementsAre("notes.txt", "frame_000004.npz", "rosbag.mcap", "scans.json"));
    put(folder / "frame_000005.npz", "of the user");
    EXPECT_EQ(list_scan_files(folder).size(), 3u);
    EXPECT_EQ(find_foreign_file(folder).filename(), "frame_000005.npz");
}

TEST_F(Recordings, TimesThatNoFileHasAreRefused) {
    ScanFolderWriter scans(folder, format);
    scans.write_scan(0, make_two_rays(100.0));
    EXPECT_THAT(get_data_error_message([&] { scans.write_scan(1, make_two_rays(-5.0)); }), Names("-5 s"));
    EXPECT_THAT(get_data_error_message([&] { scans.write_scan(1, make_two_rays(99.0)); }), Names("decrease"));
    EXPECT_THAT(get_data_error_message([&] { scans.write_scan(1, make_two_rays(3e9)); }), Names("2037"));
}

TEST_F(Recordings, OfARigAreOne) {
    ScanOutputOptions left = format, right = format;
    name_topics(left, "left");
    name_topics(right, "2nd-right");
    ScanRecordingsWriter recordings(folder, {left, right});
    const std::vector<RenderedScan> scans{make_two_rays(1.0), make_two_rays(1.0)};
    recordings.write_scans(scans);
    EXPECT_THAT(error_message<UsageError>([&] { recordings.write_scans(std::span(scans).first(1)); }),
                Names("1 scans ... 2"));
    recordings.finish();
    EXPECT_THAT(recordings.list_file_names(), ElementsAre("scans.mcap", "rosbag.mcap"));
    EXPECT_THAT(files(), UnorderedElementsAre("scans.mcap", "rosbag.mcap", "scans.json"));
    EXPECT_EQ(list_scan_files(folder).size(), 3u);
    for (const char* name : {"scans.mcap", "rosbag.mcap"})
        for (const char* topic : {"/lidar/left/points", "/lidar/_2nd_right/points"})
            EXPECT_THAT(read_contents(folder / name), testing::HasSubstr(topic)) << name;
}

/// Sensor k of a rig has kPoints[k] returns of the car, all at the time 1 + 0.01 k s. The
/// third sensor has most of them, but less than the first two together.
TEST_F(Recordings, HaveTheBoxOfTheSensorWithMostPoints) {
    constexpr std::array<std::size_t, 3> kPoints{4, 3, 5};
    format.instance_names = {"background", "car"};
    format.actors = {{.id = "car",
                      .category = "Van",
                      .size_m = {4.0, 2.0, 1.5},
                      .world_from_box = {
                          {0.0, 2.0}, {{{1, 0, 0, 0}, {0.0, -5.0, 0.0}}, {{1, 0, 0, 0}, {0.0, 15.0, 0.0}}}}}};
    std::vector<RenderedScan> scans;
    for (std::size_t k = 0; k < kPoints.size(); ++k) {
        const int n = int(kPoints[k]);
        RenderedScan scan;
        scan.image = {1,
                      n,
                      std::vector<float>(kPoints[k], 10.0f),
                      std::vector<float>(kPoints[k], 0.5f),
                      std::vector<float>(kPoints[k], 0.0f),
                      {},
                      std::vector<glm::vec3>(kPoints[k], {1.0f, 0.0f, 0.0f})};
        scan.instance.assign(kPoints[k], 1);
        scan.ring.assign(kPoints[k], 0);
        scan.time_offset_s.assign(kPoints[k], 0.01f * float(k));
        scan.time_s = 1.0;
        scans.push_back(test::complete(std::move(scan)));
    }
    std::vector<ScanOutputOptions> sensors(kPoints.size(), format);
    scan_files::SweepRecorder recorder(sensors);
    const scan_files::RecordedSweep sweep = recorder.record(scans);
    ASSERT_EQ(sweep.actors.size(), 1u);
    EXPECT_EQ(sweep.actors[0].n_points, 12u);
    EXPECT_NEAR(sweep.actors[0].faced_s, 1.02, 1e-6);
    EXPECT_NEAR(sweep.actors[0].faced.world_from_object.translation.y, 5.2, 1e-6);  // drives 10 m/s
}

TEST_F(Recordings, RefuseNamesThatRosDoesNotTakeOrThatAreTaken) {
    const auto error = [&](const char* topic, const char* frame_id) {
        ScanOutputOptions other = format;
        other.topic = topic;
        other.frame_id = frame_id;
        return error_message<UsageError>([&] { ScanRecordingsWriter(folder, {format, other}); });
    };
    for (const char* topic : {"", "/", "points", "/lidar//points", "/lidar/points/", "/2nd/points",
                              "/lidar/top-left", "/lidar points"})
        EXPECT_THAT(error(topic, "other"), Names("/lidar/points")) << topic;
    for (const char* frame : {"", "/other", "lidar", "world", "base_link"})
        EXPECT_THAT(error("/other", frame), Names("base_link")) << frame;
    for (const char* topic : {"/lidar/points", "/tf", "/tf_static", "/actors"})
        EXPECT_THAT(error(topic, "other"), Names(std::string("topic ") + topic + " ... twice")) << topic;
    EXPECT_THAT(files(), ElementsAre()) << "nothing is left of those that were refused";
}

TEST_F(Recordings, AFolderThatCannotBeWrittenIsNamed) {
    EXPECT_THAT(get_data_error_message([&] {
                    ScanFolderWriter(folder / "file" / "below", (put(folder / "file", "x"), format));
                }),
                Names("file"));
}

}  // namespace
}  // namespace relidar
