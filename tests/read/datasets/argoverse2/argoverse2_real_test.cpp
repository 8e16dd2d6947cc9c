// SPDX-License-Identifier: Apache-2.0
// Reads two sweeps of a published log, if RELIDAR_SHARED (../shared) contains
// data/argoverse2 and Python has numpy. They have no calibration, so the pose of each
// LiDAR was fitted with five numbers. The elevations of 64 lasers still show errors of
// half precision, order and compensation.
#include <relidar/log/sensor_files.hpp>

#include <cstdlib>
#include <cstring>

#include <fmt/format.h>

#include <relidar/base/arrays.hpp>
#include <relidar/base/files.hpp>
#include "read/datasets/argoverse2/argoverse2_log.hpp"
#include "read/datasets/kitti/kitti_drive.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kTimes_ns[2] = {315966265259836000, 315966265360032000};
const Pose kMounted[2] = {
    {glm::normalize(glm::dquat(1.0, -0.0000762, 0.0000566, 0.0)), {1.3626, 0.0006, 1.6406}},
    {glm::normalize(glm::dquat(0.000639, 0.9944968, -0.1047668, 0.0000928)), {1.37536, 0.00165, 1.52427}}};

fs::path get_shared_folder() {
    const char* shared = std::getenv("RELIDAR_SHARED");
    return shared ? fs::path(shared) : fs::path(RELIDAR_SOURCE_DIR).parent_path() / "shared";
}

template <class T>
std::vector<T> values_of(const NamedArray& array) {
    std::vector<T> values(array.bytes.size() / sizeof(T));
    std::memcpy(values.data(), array.bytes.data(), values.size() * sizeof(T));
    return values;
}

struct RealSweep {
    std::vector<float> xyz;
    std::vector<std::uint8_t> intensity, laser;
    std::vector<std::int32_t> offset_ns;
    Pose city_from_vehicle;
};

/// @return the sweeps, or an empty list if the data or numpy are missing
std::vector<RealSweep> read_real(const fs::path& scratch) {
    std::vector<RealSweep> sweeps;
    for (const std::int64_t time_ns : kTimes_ns) {
        const fs::path source =
                           get_shared_folder() / "data/argoverse2" / fmt::format("7fab2350_{}.npz", time_ns),
                       bytes = scratch / "sweep.npz";
        if (!fs::exists(source)) return {};
        fs::create_directories(scratch);
        const std::string script =
            "import sys, numpy as np; z = np.load(sys.argv[1]); np.savez(sys.argv[2], **{k: z[k] for k in "
            "('xyz', 'intensity', 'laser', 'offset_ns', 'city_T_ego')})";
        const auto run = [&](const char* python) {
            return std::system(fmt::format("{} -c \"{}\" '{}' '{}' 2>/dev/null", python, script,
                                           source.string(), bytes.string())
                                   .c_str()) == 0;
        };
        if (!run("python3") && !run("/usr/bin/python3")) return {};
        std::map<std::string, NamedArray> arrays;
        for (NamedArray& array : read_npz(bytes)) arrays[array.name] = std::move(array);
        const std::vector<double> m = values_of<double>(arrays.at("city_T_ego"));
        // GLM matrices are column-major.
        const glm::dmat3 rotation(m[0], m[4], m[8], m[1], m[5], m[9], m[2], m[6], m[10]);
        sweeps.push_back({values_of<float>(arrays.at("xyz")),
                          values_of<std::uint8_t>(arrays.at("intensity")),
                          values_of<std::uint8_t>(arrays.at("laser")),
                          values_of<std::int32_t>(arrays.at("offset_ns")),
                          {glm::normalize(glm::quat_cast(rotation)), {m[3], m[7], m[11]}}});
    }
    return sweeps;
}

std::string make_sweep_bytes(const RealSweep& sweep) {
    std::vector<float> coordinate[3];
    for (std::size_t i = 0; i < sweep.xyz.size(); ++i) coordinate[i % 3].push_back(sweep.xyz[i]);
    return test::make_feather_bytes(
        {test::make_halves("x", coordinate[0]), test::make_halves("y", coordinate[1]),
         test::make_halves("z", coordinate[2]), test::make_numbers("intensity", sweep.intensity),
         test::make_numbers("laser_number", sweep.laser), test::make_numbers("offset_ns", sweep.offset_ns)},
        test::FeatherCodec::lz4);
}

void write_log(const fs::path& folder, const std::vector<RealSweep>& sweeps) {
    for (std::size_t s = 0; s < 2; ++s)
        test::write_text(folder / "sensors/lidar" / fmt::format("{}.feather", kTimes_ns[s]),
                         make_sweep_bytes(sweeps[s]));
    const auto write = [&](const char* file, const std::vector<test::FeatherColumn>& columns) {
        test::write_text(folder / file, test::make_feather_bytes(columns, test::FeatherCodec::lz4));
    };
    write("city_SE3_egovehicle.feather",
          test::set_poses(
              {test::make_numbers("timestamp_ns", std::vector<std::int64_t>{kTimes_ns[0], kTimes_ns[1]})},
              {sweeps[0].city_from_vehicle, sweeps[1].city_from_vehicle}));
    write("calibration/egovehicle_SE3_sensor.feather",
          test::set_poses({test::make_texts("sensor_name", {"up_lidar", "down_lidar"})},
                          {kMounted[0], kMounted[1]}));
}

TEST(Argoverse2Real, ElevationsAreThoseOfTheTable) {
    const test::LogFolder data("relidar_argoverse2_real");
    const std::vector<RealSweep> sweeps = read_real(data.folder);
    if (sweeps.empty())
        GTEST_SKIP() << get_shared_folder() / "data/argoverse2"
                     << " or python3 with numpy is not there";
    write_log(data.folder, sweeps);
    const Log log = data.load({.max_range_m = 300.0});
    const fs::path table = get_shared_folder() / "data/sensors/VLP-32C_Argoverse2.csv";
    const std::vector<Beam> beams = std::get<SpinningSensor>(find_sensor(table.string()).pattern).beams;
    for (const Frame& frame : log.frames) {
        std::vector<double> sum(32), n(32);
        std::size_t off = 0, returns = 0;
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            if (frame.scan.range_m[i] == 0.0f) continue;
            const std::size_t beam = frame.scan.rays.channel[i];
            const double error =
                (std::asin(double(frame.scan.rays.direction[i].z)) - beams[beam].elevation_rad) * 180.0 / kPi;
            sum[beam] += error;
            n[beam] += 1.0;
            off += std::abs(error) > 0.1;
            ++returns;
        }
        double worst = 0.0;
        for (std::size_t k = 0; k < 32; ++k) worst = std::max(worst, std::abs(sum[k] / n[k]));
        EXPECT_LT(worst, 0.1) << log.lidar_of(frame).name;
        EXPECT_LT(double(off), 5e-3 * double(returns));
    }
}

}  // namespace
}  // namespace relidar
