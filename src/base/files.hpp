// SPDX-License-Identifier: Apache-2.0
// Reads complete files and parses numbers in texts. Every failure to read a file throws a
// DataError with its path.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Returns the complete content of a file.
/// @throws DataError if the file is missing or cannot be read
std::string read_file(const std::filesystem::path& path);

/// Returns the content of a text file. Removes the UTF-8 byte-order mark at the
/// beginning, which Excel and other programs write.
/// @throws DataError if the file is missing, cannot be read, or begins with a UTF-16
/// byte-order mark
std::string read_text_file(const std::filesystem::path& path);

/// Returns true if a file or folder exists at the path.
/// @throws DataError if the system reports an error, for example missing permission, a
/// loop of links or a name that is too long
bool does_path_exist(const std::filesystem::path& path);

/// Checks that a path is a folder.
/// @param expected_description description of the expected folder, for the error message
/// @throws DataError if the path is not a folder or cannot be accessed
void require_existing_folder(const std::filesystem::path& path, const std::string& expected_description);

/// Returns the paths of all files and folders in a folder, sorted by name.
/// @throws DataError if the path is missing, is not a folder, or cannot be read
std::vector<std::filesystem::path> list_folder_entries(const std::filesystem::path& folder);

/// Returns the number that a file name without its extension represents. The name must
/// consist of digits, and the number must be below 10^8 so that it fits into an int.
/// Returns nullopt for other names.
std::optional<int> parse_file_stem_as_number(const std::string& file_stem);

/// Shortens a text to at most 80 characters for an error message, and replaces control
/// characters.
std::string shorten_for_error_message(std::string_view text);

/// Splits a text into lines without "\n" or "\r\n". A line break at the end of the text
/// does not produce an empty line.
std::vector<std::string> split_lines(const std::string& text);

/// Returns the text without blanks at both ends.
std::string_view trim_blanks_at_both_ends(std::string_view text);

/// Converts a text that consists of one number. Accepts "nan" and "inf". Returns nullopt
/// if the text is not a number.
std::optional<double> parse_number(std::string_view text);

/// Converts a text of numbers that are separated by blanks or line breaks. Returns
/// nullopt if any word is not a number.
std::optional<std::vector<double>> parse_numbers(std::string_view text);

}  // namespace relidar
