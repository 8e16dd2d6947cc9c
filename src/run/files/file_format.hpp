// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <map>
#include <string>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/fail.hpp"

namespace relidar::run_detail {

/// Of a safetensors file.
/// @throws DataError with the value from the file
inline void require_format_and_version(const std::map<std::string, std::string>& metadata,
                                       const std::string& file_name, const std::string& expected_format,
                                       const std::string& expected_version) {
    const auto value = [&](const char* key) {
        const auto it = metadata.find(key);
        return it == metadata.end() ? std::string() : it->second;
    };
    if (value("format") != expected_format)
        fail(
            "{}: the entry \"format\" in the metadata of the file is \"{}\", expected \"{}\" as in a file "
            "that relidar has written",
            file_name, value("format"), expected_format);
    if (value("version") != expected_version)
        fail("{}: metadata version: found \"{}\", but relidar {} reads only version {}; train the run again",
             file_name, value("version"), RELIDAR_VERSION, expected_version);
}

}  // namespace relidar::run_detail
