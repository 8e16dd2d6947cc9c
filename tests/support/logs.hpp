// SPDX-License-Identifier: Apache-2.0
// A temporary folder with a log, and checks of its errors and poses.
#pragma once

#include <cmath>
#include <filesystem>
#include <string>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/read/dataset.hpp>

#include "support/names.hpp"

namespace relidar::test {

void write_text(const std::filesystem::path& path, const std::string& text);
std::string read_text(const std::filesystem::path& path);

/// Loads a log. Returns the message of the error, which must be a single line, or
/// "nothing" without an error.
inline std::string find_load_error(const std::string& dataset, const DatasetOptions& options = {}) {
    try {
        load_log(dataset, options);
    } catch (const Error& error) {
        const std::string message = error.what();
        EXPECT_TRUE(error.code() == ExitCode::data || error.code() == ExitCode::usage) << message;
        EXPECT_EQ(message.find('\n'), std::string::npos) << message;
        return message;
    }
    return "nothing";
}

/// A temporary folder that is deleted with this object.
struct LogFolder {
    std::filesystem::path folder;
    /// Prefix such as "mulran:" that selects the reader even if files are missing. If it
    /// is empty, the reader is detected automatically.
    std::string kind = "";

    /// @param name path below the temporary folder
    /// @param subfolder folder of the log below `name`
    explicit LogFolder(const std::string& name, const std::string& subfolder = "")
        : root_(std::filesystem::path(testing::TempDir()) / name) {
        folder = subfolder.empty() ? root_ : root_ / subfolder;
        std::filesystem::remove_all(root_);
    }
    ~LogFolder() {
        std::error_code failed;
        std::filesystem::remove_all(root_, failed);
    }
    LogFolder(const LogFolder&) = delete;
    LogFolder& operator=(const LogFolder&) = delete;

    Log load(const DatasetOptions& options = {}) const { return load_log(kind + folder.string(), options); }
    /// Checks that reading fails with a message that contains `parts`, see Names().
    void expect_error(const std::string& parts, const DatasetOptions& options = {}) const {
        EXPECT_THAT(find_load_error(kind + folder.string(), options), Names(parts));
    }
    /// Same, while `file` contains `text`.
    void expect_error_with(const std::filesystem::path& file, const std::string& text,
                           const std::string& parts, const DatasetOptions& options = {}) const {
        const std::string good = read_text(file);
        write_text(file, text);
        expect_error(parts, options);
        write_text(file, good);
    }

private:
    std::filesystem::path root_;
};

/// Replaces the first `from` in a text.
inline std::string replace_first(std::string text, const std::string& from, const std::string& to) {
    EXPECT_NE(text.find(from), std::string::npos) << from;
    return text.replace(text.find(from), from.size(), to);
}

/// Start of a ray and point of its return, in the dataset's world.
struct PlacedReturn {
    glm::dvec3 origin_m, point_m;
};
/// @param world_from_sensor poses of the LiDAR in relidar's world
inline PlacedReturn place_return(const Log& log, const PoseTrack& world_from_sensor, const Frame& frame,
                                 std::size_t ray) {
    const WorldRay placed = make_world_ray(world_from_sensor, frame.time_s, frame.scan.rays, ray, true);
    const glm::dvec3 origin_m = placed.origin_m + log.world_offset_m;
    return {origin_m, origin_m + double(frame.scan.range_m[ray]) * placed.direction};
}

/// Compares a pose in relidar's world with a pose in the dataset's world.
inline void expect_pose(const Log& log, const Pose& pose, const Pose& truth, double tolerance_m = 1e-8,
                        double cosine_tolerance = 1e-12) {
    EXPECT_LT(glm::distance(pose.translation + log.world_offset_m, truth.translation), tolerance_m);
    EXPECT_NEAR(std::abs(glm::dot(pose.rotation, truth.rotation)), 1.0, cosine_tolerance);
}

}  // namespace relidar::test
