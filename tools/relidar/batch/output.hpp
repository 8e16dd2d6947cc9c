// SPDX-License-Identifier: Apache-2.0
// What the commands of a job print, all in one file, and what is taken out of it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace relidar::cli {

/// Writes the command, as typed, and the time behind what is in the log. @return where what it prints will begin
/// @throws DataError where the log cannot be written
std::uintmax_t begin_log(const std::filesystem::path& log, const std::vector<std::string>& words);

/// The last complete line behind a place; empty where there is none.
std::string last_line(const std::filesystem::path& log, std::uintmax_t begin);

/// The last "relidar: ..." behind a place that is no note, without "relidar: "; empty where there is none.
std::string error_line(const std::filesystem::path& log, std::uintmax_t begin);

}  // namespace relidar::cli
