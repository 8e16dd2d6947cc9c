// SPDX-License-Identifier: Apache-2.0
// Reads files and parses numbers in texts. Every failure is a DataError with the path.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

std::string read_file(const std::filesystem::path& path);

/// Returns the content of a text file without the UTF-8 byte-order mark that Excel
/// writes.
/// @throws DataError if the file cannot be read, or begins with a UTF-16 byte-order mark
std::string read_text_file(const std::filesystem::path& path);

bool does_path_exist(const std::filesystem::path& path);

void require_folder(const std::filesystem::path& path, const std::string& expected_description);

std::vector<std::filesystem::path> list_folder(const std::filesystem::path& folder);

/// Returns the number (below 10^8) in a file name of digits, or nullopt.
std::optional<int> parse_stem(const std::string& file_stem);

/// Shortens a text to 80 characters for a message, and replaces control characters.
std::string quote(std::string_view text);

std::vector<std::string> split_lines(const std::string& text);

std::string_view trim(std::string_view text);

/// Converts a text that is one number, "nan" or "inf". Returns nullopt for other texts.
std::optional<double> parse_number(std::string_view text);

std::optional<std::vector<double>> parse_numbers(std::string_view text);

}  // namespace relidar
