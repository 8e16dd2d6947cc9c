// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <fmt/format.h>

#include "read/datasets/kitti/kitti_drive.hpp"
#include "read/files/point_writers.hpp"

namespace relidar::test {

namespace fs = std::filesystem;

/// Members of sequence.json for points of a .bin file.
inline constexpr const char* kRings = R"(, "columns": ["x", "y", "z", "intensity", "ring"])";
/// The same points without rings, whose column is skipped.
inline constexpr const char* kNoRings = R"(, "columns": ["x", "y", "z", "intensity", "unused"])";

/// Returns sequence.json with these additional members.
inline std::string make_head(const std::string& members = "", double rate_hz = 10.0) {
    return fmt::format(R"({{"format": "relidar log", "version": 1, "rate_hz": {}{}}})", rate_hz, members);
}

inline std::string make_beams(const SpinningSensor& sensor, double factor = 1.0) {
    std::string beams;
    for (const Beam& beam : sensor.beams)
        beams += fmt::format("{}{{\"elevation_deg\": {}}}", beams.empty() ? "" : ", ",
                             factor * beam.elevation_rad * 180.0 / kPi);
    return "\"beams\": [" + beams + "]";
}

inline fs::path make_fresh_folder_path(const std::string& name) {
    const fs::path folder = fs::path(testing::TempDir()) / "relidar_folder" / name;
    fs::remove_all(folder);
    fs::create_directories(folder.parent_path());
    return folder;
}

/// Writes a log with one frame at the origin, but without its scan in scans/.
inline fs::path make_frame_folder(const std::string& name, const std::string& head = make_head()) {
    const fs::path folder = make_fresh_folder_path(name);
    fs::create_directories(folder / "scans");
    write_text(folder / "sequence.json", head);
    write_text(folder / "poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n");
    return folder;
}

/// Adds second returns `farther_m` behind every `step`-th first return.
inline void add_second_returns(Log& files, std::size_t step, float farther_m, float max_range_m) {
    for (Frame& frame : files.frames) {
        Scan& scan = frame.scan;
        const std::vector<float> none(scan.range_m.size());
        AdditionalReturns& second = scan.second_returns.emplace_back(AdditionalReturns{none, none});
        for (std::size_t i = 0; i < none.size(); i += step)
            if (scan.range_m[i] > 0.0f && scan.range_m[i] < max_range_m) {
                second.range_m[i] = scan.range_m[i] + farther_m;
                second.intensity[i] = 0.125f;
            }
    }
}

/// The points are in the order of the rays of the street.
struct PointLog {
    Log street = make_street_log(
        {.n_frames = 4, .rows = 16, .columns = 360, .range_noise_m = 0.0, .moving_cars = false});
    fs::path folder;

    PointLog(const std::string& name, const std::string& ending,
             const std::function<std::string(const FilePoints&)>& written, const std::string& members)
        : folder(make_fresh_folder_path(name)) {
        fs::create_directories(folder / "scans");
        std::string poses;
        for (const Frame& frame : street.frames) {
            const std::size_t i = std::size_t(&frame - street.frames.data());
            write_text(folder / "scans" / fmt::format("{:02}.{}", i, ending), written(points(frame)));
            const glm::dmat4 m = to_matrix(street.world_from_vehicle.pose[i]);
            for (int row = 0; row < 3; ++row)
                for (int column = 0; column < 4; ++column) poses += fmt::format("{} ", m[column][row]);
            poses += "\n";
        }
        write_text(folder / "poses.txt", poses);
        put_head(members);
    }
    void put_head(const std::string& members, double rate_hz = 10.0) const {
        write_text(folder / "sequence.json", make_head(members, rate_hz));
    }
    Log load(const DatasetOptions& options = {}) const { return load_log(folder.string(), options); }
    void change_points(std::size_t frame, const std::function<void(FilePoint&)>& change) const {
        FilePoints changed = points(street.frames[frame]);
        for (FilePoint& point : changed) change(point);
        write_text(folder / fmt::format("scans/{:02}.bin", frame), bin(changed));
    }

    static FilePoints points(const Frame& frame) {
        FilePoints points;
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i)
            if (frame.scan.range_m[i] > 0.0f)
                points.push_back(
                    {frame.scan.return_point(i), std::round(frame.scan.intensity[i] * 255.0f) / 255.0f,
                     frame.scan.rays.channel[i], frame.time_s + double(frame.scan.rays.time_offset_s[i])});
        return points;
    }
};

struct Difference {
    double point_m = 0.0, time_s = 0.0, intensity = 0.0, ray = 0.0;
    std::size_t rings = 0, drops = 0;
};

/// The image must have the rows and columns of the street.
inline Difference measure_difference(const Log& log, const Log& street) {
    Difference worst;
    for (std::size_t f = 0; f < street.frames.size(); ++f) {
        const Scan &a = log.frames[f].scan, &b = street.frames[f].scan;
        if (a.range_m.size() != b.range_m.size()) return {1e9, 1e9, 1e9, 1e9, 0, 0};
        for (std::size_t i = 0; i < b.range_m.size(); ++i) {
            worst.drops += (a.range_m[i] > 0.0f) != (b.range_m[i] > 0.0f);
            worst.rings += a.rays.channel[i] != b.rays.channel[i];
            worst.ray = std::max(worst.ray, double(glm::distance(a.rays.direction[i], b.rays.direction[i])));
            worst.time_s =
                std::max(worst.time_s, double(std::abs(a.rays.time_offset_s[i] - b.rays.time_offset_s[i])));
            if (a.range_m[i] == 0.0f || b.range_m[i] == 0.0f) continue;
            worst.intensity = std::max(worst.intensity, double(std::abs(a.intensity[i] - b.intensity[i])));
            worst.point_m =
                std::max(worst.point_m, glm::distance(locate_return(log, log.frames[f], i).point_m,
                                                      locate_return(street, street.frames[f], i).point_m));
        }
    }
    return worst;
}

inline void expect_street(const PointLog& files, double time_s) {
    const Log log = load_log(files.folder.string(), {});
    ASSERT_EQ(log.lidars[0].sensor.columns, files.street.lidars[0].sensor.columns);
    const Difference worst = measure_difference(log, files.street);
    EXPECT_LT(worst.point_m, 1e-4);
    EXPECT_LT(worst.time_s, time_s);
    EXPECT_LT(worst.intensity, 0.51 / 255.0);
    EXPECT_LT(worst.ray, 2e-4) << "of dropped rays too";
    EXPECT_EQ(worst.rings, 0u);
    EXPECT_EQ(worst.drops, 0u);
}

/// Members of sequence.json for points with intensities from 0 to 255 and absolute times.
inline constexpr const char* kStamped = R"(, "intensity_max": 255, "point_times": "absolute")";

}  // namespace relidar::test
