// SPDX-License-Identifier: Apache-2.0
// Reads complete files, and parses numbers in their lines. Every failure is a DataError
// that names the file.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Returns the content of a file.
/// @throws DataError if the file is missing or cannot be read
std::string read_file(const std::filesystem::path& path);

/// Returns the content of a text file, without the byte-order mark that Excel and other
/// programs write before UTF-8.
/// @throws DataError if the file is missing, cannot be read, or begins with a UTF-16
/// byte-order mark
std::string read_text(const std::filesystem::path& path);

/// Returns true if the path exists.
/// @throws DataError if the system reports an error (no permission, a loop of links, too
/// long a name)
bool path_exists(const std::filesystem::path& path);

/// Checks that a path is a folder.
/// @param expected description of the expected folder, for the message
/// @throws DataError if the path is not a folder or cannot be reached
void check_folder(const std::filesystem::path& path, const std::string& expected);

/// Lists the contents of a folder, sorted by name.
/// @throws DataError if the folder is missing, not a folder, or cannot be read
std::vector<std::filesystem::path> list_folder(const std::filesystem::path& folder);

/// Returns the number in a file's name: digits only, below 10^8, so that arithmetic with
/// it fits an int. Returns nullopt for other names.
std::optional<int> file_number(const std::string& stem);

/// Returns at most 80 characters of a text, without control characters, to quote in a
/// message.
std::string excerpt(std::string_view text);

/// Splits a text into lines, without "\n" or "\r\n". A final newline does not produce an
/// empty line.
std::vector<std::string> split_lines(const std::string& text);

/// Returns the text without blanks at both ends.
std::string_view trimmed(std::string_view text);

/// Parses a text that is one number, including "nan" and "inf". Returns nullopt if it is
/// not a number.
std::optional<double> parse_number(std::string_view text);

/// Parses all numbers of a text, separated by blanks or line ends. Returns nullopt if a
/// word is not a number.
std::optional<std::vector<double>> parse_numbers(std::string_view text);

}  // namespace relidar
