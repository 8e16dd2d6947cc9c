// SPDX-License-Identifier: Apache-2.0
// Writes sensor files of tests, and returns the errors of sensors.
#pragma once

#include <filesystem>
#include <fstream>
#include <string>

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>

#include "support/names.hpp"

namespace relidar::test {

/// Returns the path of a file in the temporary folder.
inline std::string path_of(const std::string& name) {
    return (std::filesystem::path(testing::TempDir()) / name).string();
}

/// Writes a file in the temporary folder and returns its path.
inline std::string write(const std::string& name, const std::string& text) {
    std::ofstream(path_of(name)) << text;
    return path_of(name);
}

/// Returns the message of the error of a sensor, or an empty text.
inline std::string message(const std::string& sensor) {
    try {
        make_rays(find_sensor(sensor));
    } catch (const Error& error) {
        return error.what();
    }
    return "";
}

/// Checks the message of the error of a sensor file with this text, see Names().
inline void expect_message(const std::string& name, const std::string& text, const std::string& parts) {
    EXPECT_THAT(message(write(name, text)), Names(parts));
}

}  // namespace relidar::test
