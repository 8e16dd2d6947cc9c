// SPDX-License-Identifier: Apache-2.0
// Writes sensor files of tests, and returns the errors of sensors.
#pragma once

#include <filesystem>
#include <fstream>
#include <string>

#include <gtest/gtest.h>

#include <relidar/base/error.hpp>
#include <relidar/log/sensor_files.hpp>

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

/// Returns the message of the error of a sensor file with this text.
inline std::string message_of(const std::string& name, const std::string& text) {
    return message(write(name, text));
}

}  // namespace relidar::test
