// SPDX-License-Identifier: Apache-2.0
// Compares files of NCore's own writer with the synthetic street from which they were
// made.
#include <algorithm>
#include <cmath>

#include "base/codecs/unpack.hpp"
#include "read/datasets/ncore/ncore_folder.hpp"
#include "read/datasets/ncore/ncore_scans.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::NcoreFolder;

constexpr double kAngle_rad = 0.001 * kPi / 180.0;
constexpr double kRange_m = 1e-3, kTime_s = 1.1e-6;

const Log& load_street_log() {
    static const Log street = load_log(test::ncore_fixture("street").string(), {});
    return street;
}

/// Time 0 of the street in the times of the log.
double street_start_s(const Log& log) { return 1e-9 * double(1'700'000'000'000'000'000 - log.start_unix_ns); }

double angle_rad(const glm::vec3& first, const glm::vec3& second) {
    return double(glm::distance(first, second));
}

/// Compares all rays of an image with those of the street, ray by ray.
void expect_image(const Log& log, const Frame& frame, const Frame& truth) {
    const Scan &scan = frame.scan, &real = truth.scan;
    ASSERT_EQ(scan.rays.rows, real.rays.rows);
    ASSERT_EQ(scan.rays.columns, real.rays.columns);
    for (std::size_t i = 0; i < scan.rays.size(); ++i) {
        ASSERT_NEAR(scan.range_m[i], real.range_m[i], kRange_m) << i;
        ASSERT_LT(angle_rad(scan.rays.direction[i], real.rays.direction[i]), kAngle_rad) << i;
        ASSERT_FLOAT_EQ(scan.intensity[i], real.intensity[i]);
        const double time_s = frame.time_s + double(scan.rays.time_offset_s[i]),
                     real_s = truth.time_s + double(real.rays.time_offset_s[i]) + street_start_s(log);
        ASSERT_NEAR(time_s, real_s, kTime_s) << i;
    }
}

/// Compares the returns of rays without an order.
void expect_returns(const Scan& scan, const Scan& real) {
    ASSERT_EQ(scan.count_returns(), real.count_returns());
    for (std::size_t i = 0; i < real.rays.size(); ++i) {
        if (real.range_m[i] == 0.0f) continue;
        std::size_t best = 0;
        for (std::size_t k = 0; k < scan.rays.size(); ++k)
            if (angle_rad(scan.rays.direction[k], real.rays.direction[i]) <
                angle_rad(scan.rays.direction[best], real.rays.direction[i]))
                best = k;
        ASSERT_LT(angle_rad(scan.rays.direction[best], real.rays.direction[i]), kAngle_rad);
        ASSERT_NEAR(scan.range_m[best], real.range_m[i], kRange_m);
        const auto second = [](const Scan& of, std::size_t ray) {
            return of.second_returns.empty() ? 0.0f : of.second_returns[0].range_m[ray];
        };
        ASSERT_NEAR(second(scan, best), second(real, i), kRange_m);
    }
}

void expect_street(const Log& log) {
    const Log& street = load_street_log();
    ASSERT_EQ(log.lidars.size(), 2u);
    ASSERT_EQ(log.frames.size(), street.frames.size());
    for (std::size_t i = 0; i < log.frames.size(); ++i) {
        const Frame &frame = log.frames[i], &truth = street.frames[i];
        EXPECT_EQ(frame.index, truth.index);
        ASSERT_EQ(log.lidar_of(frame).name, street.lidar_of(truth).name);
        const Pose &mounted = log.lidar_of(frame).vehicle_from_sensor,
                   &real = street.lidar_of(truth).vehicle_from_sensor;
        EXPECT_LT(glm::distance(mounted.translation, real.translation), 1e-9);
        EXPECT_NEAR(std::abs(glm::dot(mounted.rotation, real.rotation)), 1.0, 1e-12);
        EXPECT_LT(glm::distance(
                      log.world_from_vehicle.pose_at(frame.time_s).translation + log.world_offset_m,
                      street.world_from_vehicle.pose_at(truth.time_s).translation + street.world_offset_m),
                  kRange_m);
        if (truth.lidar == 0) expect_image(log, frame, truth);
        else expect_returns(frame.scan, truth.scan);
    }
    ASSERT_EQ(log.boxes.size(), street.boxes.size());
    for (const BoxTrack& truth : street.boxes) {
        const BoxTrack* box = find_box(log, truth.id);
        ASSERT_TRUE(box) << truth.id;
        EXPECT_EQ(box->category, truth.category);
        EXPECT_LT(glm::distance(box->size_m, truth.size_m), kRange_m);
        ASSERT_EQ(box->world_from_box.pose.size(), truth.world_from_box.pose.size());
        for (std::size_t k = 0; k < truth.world_from_box.pose.size(); ++k) {
            const Pose &pose = box->world_from_box.pose[k], &real = truth.world_from_box.pose[k];
            EXPECT_NEAR(box->world_from_box.time_s[k], truth.world_from_box.time_s[k] + street_start_s(log),
                        kTime_s);
            EXPECT_LT(glm::distance(pose.translation + log.world_offset_m,
                                    real.translation + street.world_offset_m),
                      kRange_m);
            EXPECT_NEAR(std::abs(glm::dot(pose.rotation, real.rotation)), 1.0, 1e-9);
        }
    }
}

TEST(Ncore, ArchivesOfNcoresWriter) {
    const std::string file = test::ncore_fixture("street.ncore4.zarr.itar").string();
    EXPECT_EQ(detect_kind(file), "ncore");
    const Log log = load_log(file, {});
    expect_street(log);
    EXPECT_THAT(log.notes, testing::Contains(test::Names("cameras (camera_front) ... org.relidar.unknown")));
    const Log part = load_log(file, {.frames = {1, 3}, .lidars = {"top"}});
    ASSERT_EQ(part.frames.size(), 2u);
    EXPECT_EQ(part.frames[0].index, 1);
    EXPECT_EQ(part.frames[0].scan.count_returns(), log.frames[2].scan.count_returns());
}

TEST(Ncore, Folders) {
    const NcoreFolder data("ncore-folders");
    expect_street(data.load());
    EXPECT_EQ(detect_kind(data.main), "ncore");
    expect_street(load_log(data.main.string(), {}));
    fs::rename(data.main, data.folder / "blob");
    fs::create_directory_symlink("blob", data.main);
    expect_street(load_log(data.main.string() + "/", {}));
    fs::copy(data.folder / "blob", data.folder / "other.ncore4.zarr", fs::copy_options::recursive);
    data.expect_error("log ... other ... street");
}

/// Keeps the rays whose column `select` returns in another numbering.
void change_columns(const NcoreFolder& data, int (*select)(int column)) {
    for (const fs::path& frame : data.frames("top")) {
        const ZarrStore store(frame);
        const std::vector<std::size_t> shape =
            NcoreFolder::read_json(frame / "ray_bundle/model_element/.zarray")["shape"];
        const auto element = read_zarr_array<std::uint16_t>(store, "ray_bundle/model_element", shape);
        std::vector<std::size_t> kept;
        std::string elements;
        for (std::size_t i = 0; i < shape[0]; ++i)
            if (const int column = select(element[2 * i + 1]); column >= 0) {
                kept.push_back(i);
                for (const std::uint16_t number : {element[2 * i], std::uint16_t(column)})
                    elements.append(reinterpret_cast<const char*>(&number), 2);
            }
        NcoreFolder::keep_rays<std::uint16_t>(frame, "ray_bundle/model_element", kept);
        test::write_text(frame / "ray_bundle/model_element/0.0", elements);
        NcoreFolder::keep_rays<float>(frame, "ray_bundle/direction", kept);
        NcoreFolder::keep_rays<std::uint64_t>(frame, "ray_bundle/timestamp_us", kept);
        NcoreFolder::keep_rays<float>(frame, "ray_bundle_returns/distance_m", kept);
        NcoreFolder::keep_rays<float>(frame, "ray_bundle_returns/intensity", kept);
        // The distances of missing returns are NaN, so the mask is not necessary.
        fs::remove_all(frame / "ray_bundle_returns_valid_mask_packed");
        NcoreFolder::write_json(frame / "ray_bundle/.zattrs", {{"n_rays", kept.size()}});
    }
}

fs::path model_file(const NcoreFolder& data) { return data.main / "intrinsics/default/lidars/top/.zattrs"; }

TEST(Ncore, CounterClockwiseModel) {
    const NcoreFolder data("ncore-ccw");
    nlohmann::json json = NcoreFolder::read_json(model_file(data));
    nlohmann::json& model = json["lidar_model_parameters"];
    std::vector<double> azimuths = model["column_azimuths_rad"];
    std::ranges::reverse(azimuths);
    model["column_azimuths_rad"] = azimuths;
    model["spinning_direction"] = "ccw";
    NcoreFolder::write_json(model_file(data), json);
    change_columns(data, [](int column) { return 119 - column; });
    expect_street(data.load());
}

TEST(Ncore, MissingRaysWereDropped) {
    const NcoreFolder data("ncore-returns");
    constexpr double kUneven_rad = 0.01;
    nlohmann::json json = NcoreFolder::read_json(model_file(data));
    nlohmann::json& azimuth = json["lidar_model_parameters"]["column_azimuths_rad"][10];
    azimuth = azimuth.get<double>() + kUneven_rad;
    NcoreFolder::write_json(model_file(data), json);
    change_columns(data, [](int column) { return column % 7 == 3 ? -1 : column; });
    const Log log = data.load(), &street = load_street_log();
    for (std::size_t i = 0; i < log.frames.size(); ++i) {
        if (log.frames[i].lidar != 0) continue;
        const Scan &scan = log.frames[i].scan, &real = street.frames[i].scan;
        std::size_t n_removed = 0, n_turned = 0;
        for (std::size_t ray = 0; ray < real.rays.size(); ++ray) {
            const glm::dvec3 d(real.rays.direction[ray]);
            const glm::vec3 turned(make_rotation(kUneven_rad, 0.0, 0.0) * d);
            const bool is_turned = angle_rad(scan.rays.direction[ray], turned) < kAngle_rad;
            ASSERT_TRUE(is_turned || angle_rad(scan.rays.direction[ray], glm::vec3(d)) < kAngle_rad) << ray;
            n_turned += is_turned;
            ASSERT_NEAR(log.frames[i].time_s + double(scan.rays.time_offset_s[ray]),
                        street.frames[i].time_s + double(real.rays.time_offset_s[ray]) + street_start_s(log),
                        3.0 * kTime_s);
            n_removed += real.range_m[ray] > 0.0f && scan.range_m[ray] == 0.0f;
        }
        EXPECT_GT(n_removed, 100u);
        EXPECT_EQ(n_turned, real.rays.channel.back() + 1u) << "column 10 of each row";
    }
}

TEST(Ncore, LimitedFieldOfView) {
    const NcoreFolder data("ncore-fov");
    nlohmann::json json = NcoreFolder::read_json(model_file(data));
    nlohmann::json& model = json["lidar_model_parameters"];
    std::vector<double> azimuths = model["column_azimuths_rad"];
    model["column_azimuths_rad"] = std::vector<double>(azimuths.begin() + 40, azimuths.begin() + 80);
    model["n_columns"] = 40;
    NcoreFolder::write_json(model_file(data), json);
    change_columns(data, [](int column) { return column >= 40 && column < 80 ? column - 40 : -1; });
    const Log log = data.load(), &street = load_street_log();
    for (std::size_t i = 0; i < log.frames.size(); ++i) {
        if (log.frames[i].lidar != 0) continue;
        const Scan& scan = log.frames[i].scan;
        // 40 columns, and one at each side for rows with an azimuth offset
        EXPECT_EQ(scan.rays.columns, 42);
        std::size_t n_same = 0;
        for (std::size_t ray = 0; ray < scan.rays.size(); ++ray) {
            if (scan.range_m[ray] == 0.0f) continue;
            const Scan& real = street.frames[i].scan;
            for (std::size_t k = 0; k < real.rays.size(); ++k)
                n_same += angle_rad(scan.rays.direction[ray], real.rays.direction[k]) < kAngle_rad &&
                          std::abs(scan.range_m[ray] - real.range_m[k]) < float(kRange_m);
        }
        EXPECT_EQ(n_same, scan.count_returns());
        // The columns 40 to 79 have 97 % returns or more.
        EXPECT_GT(n_same, 300u);
        EXPECT_LE(n_same, 320u);
    }
}

TEST(Ncore, FittedSensorEqualsTheModel) {
    const NcoreFolder data("ncore-fitted");
    const SpinningSensor& truth = load_street_log().lidars[0].sensor;
    const auto expect_beams = [&](const SpinningSensor& sensor) {
        EXPECT_EQ(sensor.columns, truth.columns);
        ASSERT_EQ(sensor.beams.size(), truth.beams.size());
        for (std::size_t b = 0; b < truth.beams.size(); ++b)
            EXPECT_NEAR(sensor.beams[b].elevation_rad, truth.beams[b].elevation_rad, 10.0 * kAngle_rad);
    };
    fs::remove_all(model_file(data).parent_path());
    const Log fitted = data.load();
    expect_beams(fitted.lidars[0].sensor);
    for (std::size_t i = 0; i < fitted.frames.size(); ++i)
        expect_returns(fitted.frames[i].scan, load_street_log().frames[i].scan);
    for (const fs::path& frame : data.frames("top")) fs::remove_all(frame / "ray_bundle/model_element");
    expect_beams(data.load().lidars[0].sensor);
}

TEST(Ncore, OtherFramesOfCoordinates) {
    const NcoreFolder data("ncore-frames");
    const fs::path fixed = data.main / "poses/default/static_poses/.zattrs",
                   moving = data.main / "poses/default/dynamic_poses/.zattrs";
    // "rig" gets another name, and the pose of "top" the other direction
    nlohmann::json poses = NcoreFolder::read_json(fixed), track = NcoreFolder::read_json(moving);
    poses["('platform', 'top')"] = poses["('top', 'rig')"];  // the identity
    poses["('wide', 'platform')"] = poses["('wide', 'rig')"];
    poses.erase("('top', 'rig')");
    poses.erase("('wide', 'rig')");
    track["('platform', 'world')"] = track["('rig', 'world')"];
    track.erase("('rig', 'world')");
    NcoreFolder::write_json(fixed, poses);
    NcoreFolder::write_json(moving, track);
    expect_street(data.load());
    poses.erase("('wide', 'platform')");
    NcoreFolder::write_json(fixed, poses);
    const Log without = data.load();
    EXPECT_EQ(without.lidars.size(), 1u);
    EXPECT_THAT(without.notes, testing::Contains(test::Names("wide ... platform")));
    NcoreFolder::write_json(moving, nlohmann::json::object());
    data.expect_error("world ... dataset.poses=none");
    EXPECT_EQ(data.load({.poses_file = kNoPoses}).frames.size(), 3u);
}

TEST(Ncore, DamagedFiles) {
    const NcoreFolder data("ncore-damaged");
    const fs::path frame = data.frames("top").front(), array = frame / "ray_bundle/direction";
    const auto expect_changed = [&](const fs::path& file, const std::string& from, const std::string& to,
                                    const std::string& parts) {
        data.expect_error_with(file, test::replace_first(test::read_text(file), from, to), parts);
    };
    const std::string chunk = test::read_text(array / "0.0");
    data.expect_error_with(array / "0.0", chunk.substr(0, chunk.size() / 2), "ray_bundle/direction/0.0");
    data.expect_error_with(array / "0.0", "", "ray_bundle/direction/0.0");
    data.expect_error_with(array / ".zarray", "{", "ray_bundle/direction");
    expect_changed(array / ".zarray", "<f4", "<f8", "'<f8' ... '<f4'");
    expect_changed(array / ".zarray", "blosc", "zlib", "'zlib' ... blosc");
    expect_changed(data.main / ".zattrs", "\"v4\"", "\"v3\"", "v3 ... v4");
    expect_changed(data.main / ".zattrs", "synthetic", "other", "street.ncore4.zarr");
    expect_changed(model_file(data), "row-offset-spinning", "rosette", "rosette ... row-offset-spinning");
    expect_changed(data.main / "poses/default/dynamic_poses/.zattrs", "('rig', 'world')", "rig",
                   "dynamic_poses/.zattrs ... rig");
    fs::remove(array / "0.0");
    data.expect_error("ray_bundle/direction/0.0");
    EXPECT_EQ(data.load({.skip_broken = true}).frames.size(), load_street_log().frames.size() - 1);

    const std::string archive = test::read_text(test::ncore_fixture("street.ncore4-lidars.zarr.itar"));
    const fs::path cut = data.folder / "cut/street.ncore4.zarr.itar";
    for (const std::string& bytes : {archive.substr(0, archive.size() / 2), std::string("itar"),
                                     std::string(), std::string(512, 'x'), archive.substr(1)}) {
        test::write_text(cut, bytes);
        EXPECT_THAT(test::find_load_error(cut.string()), test::Names("street.ncore4.zarr.itar"));
    }
    test::write_text(cut, archive);
    EXPECT_THAT(test::find_load_error(cut.string()), test::Names("street.ncore4.zarr.itar"));
}

std::string from_hex(const std::string& hex) {
    std::string bytes;
    for (std::size_t i = 0; i < hex.size(); i += 2) bytes += char(std::stoi(hex.substr(i, 2), nullptr, 16));
    return bytes;
}

// Chunks that numcodecs 0.11 wrote: i / 7, with the codec lz4.
TEST(Ncore, Zarr3IsRefused) {
    const NcoreFolder data("zarr3");
    for (const char* name : {".zgroup", ".zattrs"}) fs::remove(data.main / name);
    NcoreFolder::write_json(data.main / "zarr.json", {{"zarr_format", 3}, {"node_type", "group"}});
    data.expect_error("street.ncore4.zarr ... zarr 3 (zarr.json) ... zarr 2");
    std::string archive = test::read_text(test::ncore_fixture("street.ncore4.zarr.itar"));
    const std::string key(".zgroup\0\0", 9);
    std::size_t header = archive.find(key);  // names are at the start of blocks of 512 bytes
    while (header % 512 != 0) header = archive.find(key, header + 1);
    archive.replace(header, key.size(), "zarr.json");
    const fs::path file = data.folder / "other" / "street.ncore4.zarr.itar";
    test::write_text(file, archive);
    EXPECT_THAT(test::find_load_error(file.string()), test::Names("zarr 3 (zarr.json) ... zarr 2"));
}

TEST(Blosc, ChunksOfNumcodecs) {
    const std::string bits = from_hex(
        "02012402000400000004000096000000140000006e0000007f803fe00ff803fe0700267f00c0ff0f00fcff0700267f000000"
        "f0ff"
        "ffff07002801020012ff0100010c000f0e001a002f000602000246000402000618000002000416000202000012000f02000d"
        "022a"
        "000f0200030f3c000d0f02000d0456000f28000d0f0200085000000000000c0000001f000100ffe8500000000000");
    const std::string bytes = from_hex(
        "02012104b0040000b0040000f700000014000000af0000001200010012010100120201001203010012040100120501001206"
        "0100"
        "120701001208010012090100120a0100120b0100120c0100120d0100120e0100120f01001210010012110100121201001213"
        "01"
        "00121401001215010012160100121701001218010012190100121a0100121b0100121c0100121d0100121e0100121f010012"
        "2001"
        "00122101001222010012230100122401001225010012260100122701001228010012290100602a2a2a2a2a2a0c0000001f00"
        "0100"
        "ff145000000000000c0000001f000100ff145000000000000c0000001f000100ff14500000000000");
    const std::string shorts = decompress_blosc(bits), words = decompress_blosc(bytes);
    ASSERT_EQ(shorts.size(), 1024u);
    ASSERT_EQ(words.size(), 1200u);
    for (std::size_t i = 0; i < 512; ++i)
        ASSERT_EQ(reinterpret_cast<const std::uint16_t*>(shorts.data())[i], i / 7);
    for (std::size_t i = 0; i < 300; ++i)
        ASSERT_EQ(reinterpret_cast<const std::uint32_t*>(words.data())[i], i / 7);
    for (std::size_t n = 0; n < bytes.size(); ++n)
        EXPECT_THROW(decompress_blosc(bytes.substr(0, n)), DataError);
}

}  // namespace
}  // namespace relidar
