// SPDX-License-Identifier: Apache-2.0
// Fuzzes plain folders. "points" reads a scan of points, and the first byte selects the
// format. "folder" reads the text files of a folder (sequence.json, poses.txt,
// boxes.json), separated by lines of "=====". "exr" reads a scan as a range image, with
// the rays of the image or of the log's sensor.
#include "harness.hpp"

#include <iterator>

#include <fmt/format.h>

#include <relidar/base/images.hpp>

#include "read/files/point_writers.hpp"
#include "read/scans/folder_points.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr const char* kEndings[] = {"pcd", "ply", "bin", "npy", "csv", "las"};
constexpr std::string_view kParting = "\n=====\n";

test::FilePoints make_cylinder() { return test::make_cylinder(40, 0.001); }

std::vector<std::string> make_point_seeds(const fs::path&) {
    test::FilePoints some = make_cylinder();
    some.resize(12);
    std::vector<std::string> seeds;
    const auto add = [&](char format, const std::string& bytes) { seeds.push_back(format + bytes); };
    add(0, test::make_pcd_text(some));
    add(0, test::make_pcd_binary(some));
    add(0, test::make_pcd_compressed(some));
    add(1, test::make_ply_text(some));
    add(1, test::make_ply_binary(some));
    add(2, test::bin(some));
    add(3, test::npy(some));
    std::string fields =
        "{'descr': [('x', '<f4'), ('y', '<f4'), ('z', '<f4'), ('', '|V2'), ('ring', '<u2'), ('n', '<f4', "
        "(3,))], 'fortran_order': False, 'shape': (2,), }";
    fields.resize(166, ' ');
    add(3, std::string("\x93NUMPY\x01\x00\xA6\x00", 10) + fields + std::string(2 * 28, '\1'));
    add(4, "//X;Y;Z;scalar_intensity\n1;2;3;4\n5;6;7;8\n");
    add(5, test::las(make_cylinder()));
    return seeds;
}

void read_points(std::string_view input, const fs::path& folder) {
    if (input.empty()) return;
    const char* ending = kEndings[static_cast<unsigned char>(input[0]) % std::size(kEndings)];
    const fs::path file = folder / fmt::format("scan.{}", ending);
    put(file, input.substr(1));
    std::vector<std::string> columns = {"x", "y", "z", "intensity", "ring"};
    if (ending == kEndings[3]) columns.push_back("timestamp");
    read::PointFileUnits units;
    units.intensity_max = 255.0;
    read::convert_table(read::read_point_file(file, columns), units, 0.0, "scan");
}

fs::path log_in(const fs::path& folder) {
    static const fs::path log = [&] {
        fs::create_directories(folder / "log/scans");
        put(folder / "log/scans/0.pcd", test::make_pcd_binary(make_cylinder()));
        put(folder / "log/scans/1.bin", test::bin(make_cylinder()));
        put(folder / "log/scans/2.npy", test::npy(make_cylinder()));
        return folder / "log";
    }();
    return log;
}

std::vector<std::string> make_folder_seeds(const fs::path& folder) {
    const Log street = make_street_log({.n_frames = 2, .rows = 4, .columns = 16});
    save_folder(street, folder / "saved", {.overwrite = true});
    std::string saved;
    for (const char* name : {"sequence.json", "poses.txt", "boxes.json"})
        saved += read_contents(folder / "saved" / name) + std::string(kParting);
    return {
        saved,
        R"({"format": "relidar log", "version": 1, "columns": ["x", "y", "z", "intensity", "ring"], "intensity_max": 255, "frames":
               [{"number": 0, "time_s": 0, "scan": "scans/1.bin"}, {"number": 1, "time_s": 0.1, "scan": "scans/1.bin"}]})"
        "\n=====\n0 0 0 0 1 0 0 0\n1 0 0 0 1 0 0 0\n=====\n"
        R"({"boxes": [{"track": "a", "category": "Car", "frame": 0, "size": [4, 2, 1], "position": [5, 0, 0], "yaw_deg": 0}]})",
        R"({"format": "relidar log", "version": 1, "time_unit": "ms", "point_times": "absolute", "intensity_max": 9,
               "motion_compensated": true,
               "lidars": [{"name": "a", "ring_0": "lowest", "vehicle_from_sensor": {"translation": [0, 0, 1], "quaternion": [1, 0, 0, 0]},
                           "sensor": {"columns": 40, "period_s": 0.1, "beams": [{"elevation_deg": 1}, {"elevation_deg": 0}]}}],
               "frames": [{"number": 0, "time_s": 0, "scan": "scans/0.pcd", "lidar": "a"}]})"
        "\n=====\n1 0 0 0 0 1 0 0 0 0 1 0\n=====\n"};
}

void read_folder(std::string_view input, const fs::path& folder) {
    const fs::path log = log_in(folder);
    for (const char* name : {"sequence.json", "poses.txt", "boxes.json"}) {
        const std::size_t end = std::min(input.find(kParting), input.size());
        put(log / name, input.substr(0, end));
        input.remove_prefix(std::min(end + kParting.size(), input.size()));
    }
    load_sequence("folder:" + log.string(), {});
}

fs::path make_image_log_in(const fs::path& folder) {
    static const fs::path log = [&] {
        fs::create_directories(folder / "images/scans");
        put(folder / "images/sequence.json",
            R"({"format": "relidar log", "version": 1, "rate_hz": 10, "lidars": [{"sensor": {"columns": 16,
            "beams": [{"elevation_deg": 3}, {"elevation_deg": 2}, {"elevation_deg": 1}, {"elevation_deg": 0}]}}]})");
        put(folder / "images/poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0");
        return folder / "images";
    }();
    return log;
}

std::vector<std::string> make_exr_seeds(const fs::path& folder) {
    constexpr int kRows = 4, kColumns = 16;
    std::map<std::string, std::vector<float>> channels;
    for (int i = 0; i < kRows * kColumns; ++i) {
        for (const auto& [name, value] : {std::pair("range", 1.0f + float(i)),
                                          {"median_range", 1.5f + float(i)},
                                          {"intensity", 0.25f},
                                          {"drop_prob", i % 3 == 0 ? 1.0f : 0.0f},
                                          {"time", 0.001f * float(i)},
                                          {"ring", float(i % 4)},
                                          {"range_2", 2.5f + float(i)},
                                          {"intensity_2", 0.125f},
                                          {"direction.x", 0.6f},
                                          {"direction.y", 0.8f},
                                          {"direction.z", 0.0f},
                                          {"origin.x", 0.1f},
                                          {"origin.y", 0.0f},
                                          {"origin.z", 0.0f}})
            channels[name].push_back(value);
    }
    std::vector<std::string> seeds;
    const auto add = [&](const FileMetadata& notes) {
        write_exr(folder / "seed.exr", kRows, kColumns, channels, notes);
        seeds.push_back(read_contents(folder / "seed.exr"));
    };
    add({{"points_in", "sensor at each ray's firing time"}, {"sensor", "VLP-16"}});
    std::erase_if(channels, [](const auto& channel) {
        return channel.first != "range" && channel.first != "intensity";
    });
    add({});
    return seeds;
}

void read_exr_scan(std::string_view input, const fs::path& folder) {
    const fs::path log = make_image_log_in(folder);
    put(log / "scans/0.exr", input);
    load_sequence("folder:" + log.string(), {});
}

}  // namespace

std::vector<Harness> list_folder_harnesses() {
    return {{"points", make_point_seeds, read_points},
            {"folder", make_folder_seeds, read_folder, false},
            {"exr", make_exr_seeds, read_exr_scan}};
}

}  // namespace relidar::fuzz
