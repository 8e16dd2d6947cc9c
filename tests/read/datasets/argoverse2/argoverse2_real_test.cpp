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
#include "log/checks/checks.hpp"
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

std::vector<std::string> texts_of(const NamedArray& array) {
    const std::size_t width = array.bytes.size() / array.shape[0];
    std::vector<std::string> texts;
    for (std::size_t i = 0; i < array.shape[0]; ++i) {
        const char* text = reinterpret_cast<const char*>(array.bytes.data()) + i * width;
        texts.emplace_back(text, ::strnlen(text, width));
    }
    return texts;
}

struct RealSweep {
    std::vector<float> xyz;
    std::vector<std::uint8_t> intensity, laser;
    std::vector<std::int32_t> offset_ns;
    Pose city_from_vehicle;
    std::vector<double> boxes;  ///< [n, 10] centre, size, quaternion w x y z
    std::vector<std::string> category, track;
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
            "import sys, numpy as np; z = np.load(sys.argv[1]); np.savez(sys.argv[2], **{k: z[k].astype('S') "
            "if z[k].dtype.kind == 'U' else z[k] for k in z.files})";
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
                          {glm::normalize(glm::quat_cast(rotation)), {m[3], m[7], m[11]}},
                          values_of<double>(arrays.at("boxes")),
                          texts_of(arrays.at("category")),
                          texts_of(arrays.at("track"))});
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
    std::vector<std::int64_t> time_ns;
    std::vector<double> size[3];
    std::vector<std::string> track, category;
    std::vector<Pose> boxes;
    for (std::size_t s = 0; s < 2; ++s) {
        test::write_text(folder / "sensors/lidar" / fmt::format("{}.feather", kTimes_ns[s]),
                         make_sweep_bytes(sweeps[s]));
        for (std::size_t i = 0; i < sweeps[s].track.size(); ++i) {
            const double* b = &sweeps[s].boxes[10 * i];
            time_ns.push_back(kTimes_ns[s]);
            track.push_back(sweeps[s].track[i]);
            category.push_back(sweeps[s].category[i]);
            for (int axis = 0; axis < 3; ++axis) size[axis].push_back(b[3 + axis]);
            boxes.push_back({glm::dquat(b[6], b[7], b[8], b[9]), {b[0], b[1], b[2]}});
        }
    }
    const auto write = [&](const char* file, const std::vector<test::FeatherColumn>& columns) {
        test::write_text(folder / file, test::make_feather_bytes(columns, test::FeatherCodec::lz4));
    };
    write("annotations.feather",
          test::set_poses({test::make_numbers("timestamp_ns", time_ns), test::make_texts("track_uuid", track),
                           test::make_texts("category", category), test::make_numbers("length_m", size[0]),
                           test::make_numbers("width_m", size[1]), test::make_numbers("height_m", size[2])},
                          boxes));
    write("city_SE3_egovehicle.feather",
          test::set_poses(
              {test::make_numbers("timestamp_ns", std::vector<std::int64_t>{kTimes_ns[0], kTimes_ns[1]})},
              {sweeps[0].city_from_vehicle, sweeps[1].city_from_vehicle}));
    write("calibration/egovehicle_SE3_sensor.feather",
          test::set_poses({test::make_texts("sensor_name", {"up_lidar", "down_lidar"})},
                          {kMounted[0], kMounted[1]}));
}

double elevation_deg(const glm::dvec3& point) {
    return std::atan2(point.z, std::hypot(point.x, point.y)) * 180.0 / kPi;
}

class Argoverse2Real : public testing::Test {
protected:
    static void SetUpTestSuite() {
        folder_ = fs::path(testing::TempDir()) / "relidar_argoverse2_real";
        real_ = read_real(folder_);
        if (real_.empty()) return;
        write_log(folder_, real_);
        log_ = load_sequence(folder_.string(), {.max_range_m = 300.0});
        beams_ =
            std::get<SpinningSensor>(
                find_sensor((get_shared_folder() / "data/sensors/VLP-32C_Argoverse2.csv").string()).pattern)
                .beams;
    }
    static void TearDownTestSuite() {
        std::error_code failed;
        fs::remove_all(folder_, failed);
    }
    void SetUp() override {
        if (real_.empty())
            GTEST_SKIP() << get_shared_folder() / "data/argoverse2"
                         << " or python3 with numpy is not there";
    }

    /// Assumes that the vehicle moves uniformly between sweeps.
    static glm::dvec3 measured(std::size_t s, std::size_t index, int lidar) {
        const double at = double(kTimes_ns[s] + real_[s].offset_ns[index] - kTimes_ns[0]) /
                          double(kTimes_ns[1] - kTimes_ns[0]);
        const Pose vehicle = interpolate(real_[0].city_from_vehicle, real_[1].city_from_vehicle, at);
        const glm::dvec3 stored(real_[s].xyz[3 * index], real_[s].xyz[3 * index + 1],
                                real_[s].xyz[3 * index + 2]);
        return inverse(vehicle * kMounted[lidar]) * (real_[s].city_from_vehicle * stored);
    }

    inline static fs::path folder_;
    inline static std::vector<RealSweep> real_;
    inline static Log log_;
    inline static std::vector<Beam> beams_;  ///< beams of the table, highest first
};

TEST_F(Argoverse2Real, ElevationsAreThoseOfTheTable) {
    for (const Frame& frame : log_.frames) {
        std::vector<double> sum(32), n(32);
        std::size_t off = 0, returns = 0;
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            if (frame.scan.range_m[i] == 0.0f) continue;
            const std::size_t beam = frame.scan.rays.channel[i];
            const double error =
                elevation_deg(frame.scan.rays.direction[i]) - beams_[beam].elevation_rad * 180.0 / kPi;
            sum[beam] += error;
            n[beam] += 1.0;
            off += std::abs(error) > 0.1;
            ++returns;
        }
        double worst = 0.0;
        for (std::size_t k = 0; k < 32; ++k) worst = std::max(worst, std::abs(sum[k] / n[k]));
        EXPECT_LT(worst, 0.1) << log_.lidar_of(frame).name;
        EXPECT_LT(double(off), 5e-3 * double(returns));
    }
}

TEST_F(Argoverse2Real, SwappedHalvesAreClearlyWorse) {
    double error[2] = {0.0, 0.0};  // correct order, swapped order
    std::map<int, double> elevation;
    const std::string table = test::read_text(get_shared_folder() / "data/sensors/VLP-32C_Argoverse2.csv");
    for (std::size_t at = table.find('\n') + 1; at < table.size(); at = table.find('\n', at) + 1) {
        int channel = 0;
        double degrees = 0.0;
        ASSERT_EQ(std::sscanf(table.c_str() + at, "%d,%lf", &channel, &degrees), 2);
        elevation[channel] = degrees;
    }
    for (std::size_t i = 0; i < real_[0].laser.size(); ++i) {
        const int laser = real_[0].laser[i];
        for (int swapped = 0; swapped < 2; ++swapped)
            error[swapped] +=
                std::abs(elevation_deg(measured(0, i, laser / 32 ^ swapped)) - elevation.at(laser % 32)) /
                double(real_[0].laser.size());
    }
    EXPECT_LT(error[0], 0.02);
    EXPECT_GT(error[1], 50.0 * error[0]);
}

TEST_F(Argoverse2Real, BoxesHoldPoints) {
    // points of the first sweep in the world frame at the time of the sweep, as published
    std::vector<glm::dvec3> points;
    for (std::size_t i = 0; i < real_[0].laser.size(); ++i)
        points.push_back(real_[0].city_from_vehicle *
                         glm::dvec3(real_[0].xyz[3 * i], real_[0].xyz[3 * i + 1], real_[0].xyz[3 * i + 2]));
    std::vector<glm::dvec3> read;
    for (const Frame& frame : log_.frames) {
        if (frame.index != 0) continue;
        const PoseTrack track = log_.lidar_track(frame.lidar);
        for (std::size_t i = 0; i < frame.scan.rays.size(); ++i) {
            if (frame.scan.range_m[i] == 0.0f) continue;
            const WorldRay ray = make_world_ray(track, frame.time_s, frame.scan.rays, i, true);
            read.push_back(ray.origin_m + double(frame.scan.range_m[i]) * ray.direction);
        }
    }
    ASSERT_EQ(log_.boxes.size(), 81u);
    EXPECT_EQ(checks::describe_fault(log_), "");
    std::size_t n_near_boxes = 0, n_empty_boxes = 0;
    for (const BoxTrack& box : log_.boxes) {
        const auto count = [&](const std::vector<glm::dvec3>& cloud, const glm::dvec3& shift) {
            return std::count_if(cloud.begin(), cloud.end(), [&](const glm::dvec3& point) {
                return box.contains_point(point - shift, 0.0, 0.0);
            });
        };
        const auto n_published_points = count(points, log_.world_offset_m),
                   n_read_points = count(read, glm::dvec3(0.0));
        EXPECT_NEAR(double(n_read_points), double(n_published_points), 2.0)
            << box.category << ": points at its faces may fall to either side";
        if (glm::distance(box.world_from_box.pose[0].translation,
                          log_.world_from_vehicle.pose[0].translation) > 40.0)
            continue;
        ++n_near_boxes;
        n_empty_boxes += n_read_points == 0;
    }
    EXPECT_GT(n_near_boxes, 20u);
    EXPECT_LE(n_empty_boxes, 1u) << "a bollard 30 m away has none as published";
}

/// Selects the beam that is nearest in elevation, and of its rays within a millisecond of
/// the point the ray that is nearest in azimuth. Its cell must contain the point.
TEST_F(Argoverse2Real, PointsAreFoundInTheirCells) {
    for (std::size_t s = 0; s < 2; ++s) {
        std::size_t in_another_cell = 0;
        for (std::size_t i = 0; i < real_[s].laser.size(); ++i) {
            const int lidar = real_[s].laser[i] / 32;
            const Frame& frame = log_.frames[2 * s + std::size_t(lidar)];
            const RayTable& rays = frame.scan.rays;
            const glm::dvec3 p = measured(s, i, lidar);
            const double elevation = std::atan2(p.z, std::hypot(p.x, p.y)),
                         time_s = 1e-9 * double(real_[s].offset_ns[i]);
            std::size_t row = 0;
            for (std::size_t k = 1; k < 32; ++k)
                if (std::abs(beams_[k].elevation_rad - elevation) <
                    std::abs(beams_[row].elevation_rad - elevation))
                    row = k;
            std::size_t cell = 0;
            double nearest = 10.0;
            for (std::size_t at = row * std::size_t(rays.columns); at < (row + 1) * std::size_t(rays.columns);
                 ++at) {
                if (std::abs(double(rays.time_offset_s[at]) - time_s) > 1e-3) continue;
                const double azimuth = std::atan2(p.y * rays.direction[at].x - p.x * rays.direction[at].y,
                                                  p.x * rays.direction[at].x + p.y * rays.direction[at].y);
                if (std::abs(azimuth) < nearest) {
                    nearest = std::abs(azimuth);
                    cell = at;
                }
            }
            const bool here = std::abs(double(frame.scan.range_m[cell]) - glm::length(p)) < 1e-3 &&
                              glm::distance(glm::dvec3(frame.scan.return_point(cell)), p) < 1e-3;
            in_another_cell += !here;
        }
        EXPECT_LT(double(in_another_cell), 1e-3 * double(real_[s].laser.size()));
    }
}

}  // namespace
}  // namespace relidar
