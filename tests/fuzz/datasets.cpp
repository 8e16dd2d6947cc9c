// SPDX-License-Identifier: Apache-2.0
// Fuzzes Feather files, and small logs of datasets in which the input replaces a file.
#include "harness.hpp"

#include <cstdlib>
#include <iterator>

#include <fmt/format.h>

#include "base/codecs/feather.hpp"
#include "base/codecs/unpack.hpp"
#include "changed_files.hpp"
#include "read/datasets/argoverse2/argoverse2_log.hpp"
#include "read/datasets/ncore/ncore_folder.hpp"
#include "read/datasets/nuscenes/nuscenes_folder.hpp"
#include "read/datasets/waymo/waymo_segment.hpp"
#include "read/files/point_writers.hpp"
#include "read/scans/folder_points.hpp"
#include "read/scans/stamped_folders.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

void read_feather(std::string_view input, const fs::path&) {
    const Feather table("input", std::string(input));
    std::string failure;
    for (const char* column : {"a", "b", "c", "d"}) {
        for (const int as : {0, 1, 2}) {
            try {
                if (as == 0) table.read_numbers(column);
                if (as == 1) table.read_integers(column);
                if (as == 2) table.read_texts(column);
            } catch (const DataError& error) {
                failure = error.what();  // only the last failure is reported
            }
        }
    }
    if (!failure.empty()) throw DataError(failure);
}

/// A small log of a dataset. LogFolder creates it in the folder TEST_TMPDIR.
struct Argoverse2 {
    test::Argoverse2Log log{"fuzz", {.sweeps = 2, .firings = 3, .codec = test::FeatherCodec::none}};
    ChangedFiles files{{log.sweep(0), log.sweep(1), log.file("annotations.feather"),
                        log.file("city_SE3_egovehicle.feather"),
                        log.file("calibration/egovehicle_SE3_sensor.feather")}};
    void load() const { load_log("argoverse2:" + log.folder.string(), {}); }
};

struct Nuscenes {
    test::NuscenesFolder log{"fuzz", 6};
    ChangedFiles files{{log.table("scene"), log.table("sample"), log.table("sensor"),
                        log.table("calibrated_sensor"), log.table("sample_data"), log.table("ego_pose"),
                        log.table("sample_annotation"), log.table("instance"), log.table("category"),
                        log.sweep(0), log.sweep(4)}};
    void load() const { load_log("nuscenes:" + log.folder.string(), {.sequence = "scene-0103"}); }
};

struct Boreas {
    test::BoreasFolder log{"fuzz", 0, 40};
    ChangedFiles files{{log.poses(), log.calibration(), log.scan(1)}};
    void load() const { load_log("boreas:" + log.folder.string(), {}); }
};

struct Mulran {
    test::MulranFolder log{"fuzz"};
    ChangedFiles files{{log.poses()}};
    // only two frames, because a scan has 65536 points
    void load() const { load_log("mulran:" + log.folder.string(), {.frames = {1, 2}}); }
};

struct Once {
    test::OnceFolder log{"fuzz", false, 60};
    ChangedFiles files{{log.json(), log.scan(1)}};
    void load() const { load_log("once:" + log.folder.string(), {}); }
};

struct Ncore {
    test::NcoreFolder log{"fuzz"};
    fs::path frame = log.frames("top").front();
    ChangedFiles files{
        {log.main / ".zattrs", log.main / "poses/default/static_poses/.zattrs",
         log.main / "poses/default/dynamic_poses/.zattrs", log.main / "intrinsics/default/lidars/top/.zattrs",
         log.main / "cuboids/default/cuboids/.zattrs", log.lidars / "top/frames/.zattrs",
         frame / "ray_bundle/direction/.zarray", frame / "ray_bundle/direction/0.0",
         frame / "ray_bundle/timestamp_us/0", frame / "ray_bundle/model_element/0.0",
         frame / "ray_bundle_returns/distance_m/0.0", frame / "ray_bundle_returns_valid_mask_packed/0"}};
    void load() const { load_log("ncore:" + log.folder.string(), {}); }
};

/// The input is an archive, or a chunk of an array.
void read_itar(std::string_view input, const fs::path& folder) {
    put(folder / "input.zarr.itar", input);
    if (!input.starts_with('\2')) load_log("ncore:" + (folder / "input.zarr.itar").string(), {});
    else decompress_blosc(input);
}

std::vector<std::string> make_itar_seeds(const fs::path&) {
    const fs::path file = test::ncore_fixture("street.ncore4.zarr.itar");
    const ZarrStore store(test::ncore_fixture("street.ncore4-lidars.zarr.itar"));
    const std::string frame = "lidars/top/frames/" + store.list_children("lidars/top/frames")[0];
    return {read_contents(file), store.read_value(frame + "/ray_bundle/direction/0.0"),
            store.read_value(frame + "/ray_bundle/model_element/0.0")};
}

// Random changes of Waymo's files would fail at CRCs and zlib streams. Therefore the
// first byte of an input selects its use: the file, the data of a record, or an
// uncompressed matrix of TOP.
enum Part : unsigned { kFile, kRecord, kImage, kPixelPoses, kParts };

const test::WaymoSegment& make_segment_in(const fs::path& folder) {
    static const test::WaymoSegment segment((::setenv("TEST_TMPDIR", folder.c_str(), 1), "fuzz_waymo"));
    return segment;
}

/// Returns a matrix with only eight columns, because libFuzzer inputs are short.
std::string make_small_matrix(int channels) {
    const int rows = test::WaymoSegment::kTopRows, columns = 8;
    return test::make_waymo_unpacked_matrix(std::vector<float>(std::size_t(rows * columns * channels), 5.0f),
                                            {rows, columns, channels});
}

/// @param image, poses uncompressed matrices of the TOP LiDAR
std::string record_with(const test::WaymoSegment& segment, const std::string& image,
                        const std::string& poses) {
    test::WaymoFrame frame = segment.frames[0];
    frame.lasers = {test::make_waymo_laser(1, test::deflate_bytes(image), test::deflate_bytes(image),
                                           test::deflate_bytes(poses))};
    return frame.encode_frame_message();
}

std::string file_of(std::string_view input, const test::WaymoSegment& segment) {
    const unsigned part = input.empty() ? 0u : static_cast<unsigned char>(input[0]) % kParts;
    const std::string bytes(input.substr(std::min<std::size_t>(1, input.size())));
    if (part == kFile) return bytes;
    if (part == kRecord) return test::make_tfrecord(bytes);
    if (part == kImage) return test::make_tfrecord(record_with(segment, bytes, make_small_matrix(6)));
    return test::make_tfrecord(record_with(segment, make_small_matrix(4), bytes));
}

void read_waymo(std::string_view input, const fs::path& folder) {
    const test::WaymoSegment& segment = make_segment_in(folder);
    put(segment.file, file_of(input, segment));
    load_log("waymo:" + segment.file.string(), {});
}

template <class Dataset>
Harness make_harness(const char* name) {
    return {name,
            [](const fs::path& folder) { return dataset_in<Dataset>(folder).files.make_seeds_of_one(); },
            [](std::string_view input, const fs::path& folder) {
                const Dataset& dataset = dataset_in<Dataset>(folder);
                dataset.files.read_one(input, [&] { dataset.load(); });
            }};
}

// Plain folders. "points" reads a scan of points, and the first byte selects the format.
// "folder" reads the text files of a folder (sequence.json, poses.txt, boxes.json),
// separated by lines of "=====". "exr" reads a scan as a range image, with the rays of
// the image or of the log's sensor.
constexpr const char* kPointEndings[] = {"pcd", "ply", "bin", "npy", "csv", "las"};
constexpr std::string_view kParting = "\n=====\n";

test::FilePoints make_cylinder() { return test::make_cylinder(40, 0.001); }

void read_points(std::string_view input, const fs::path& folder) {
    if (input.empty()) return;
    const char* ending = kPointEndings[static_cast<unsigned char>(input[0]) % std::size(kPointEndings)];
    const fs::path file = folder / fmt::format("scan.{}", ending);
    put(file, input.substr(1));
    std::vector<std::string> columns = {"x", "y", "z", "intensity", "ring"};
    if (ending == kPointEndings[3]) columns.push_back("timestamp");
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

void read_folder(std::string_view input, const fs::path& folder) {
    const fs::path log = log_in(folder);
    for (const char* name : {"sequence.json", "poses.txt", "boxes.json"}) {
        const std::size_t end = std::min(input.find(kParting), input.size());
        put(log / name, input.substr(0, end));
        input.remove_prefix(std::min(end + kParting.size(), input.size()));
    }
    load_log("folder:" + log.string(), {});
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

void read_exr_scan(std::string_view input, const fs::path& folder) {
    const fs::path log = make_image_log_in(folder);
    put(log / "scans/0.exr", input);
    load_log("folder:" + log.string(), {});
}

}  // namespace

std::vector<Harness> list_dataset_harnesses() {
    return {{"feather", nullptr, read_feather, false},
            make_harness<Argoverse2>("argoverse2"),
            make_harness<Nuscenes>("nuscenes"),
            make_harness<Boreas>("boreas"),
            make_harness<Mulran>("mulran"),
            make_harness<Once>("once"),
            make_harness<Ncore>("ncore"),
            {"waymo", nullptr, read_waymo},
            {"points", nullptr, read_points},
            {"folder", nullptr, read_folder, false},
            {"exr", nullptr, read_exr_scan},
            {"itar", make_itar_seeds, read_itar, false}};
}

}  // namespace relidar::fuzz
