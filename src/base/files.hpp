// SPDX-License-Identifier: Apache-2.0
// Reading files whole, and numbers out of their lines. Every failure is a DataError that
// names the file.
#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Content of a file. @throws DataError where it is missing or cannot be read
std::string read_file(const std::filesystem::path& path);

/// Content of a text file without the byte-order mark that Excel and others write in
/// front of UTF-8.
/// @throws DataError if the file is missing, cannot be read, or begins with the mark of
/// UTF-16
std::string read_text(const std::filesystem::path& path);

/// Whether a path leads to something. @throws DataError where the system does not say (no
/// permission, a loop of links, too long a name)
bool path_exists(const std::filesystem::path& path);

/// @throws DataError where a path is no folder, or cannot be reached; the message ends
/// with what was expected there
void check_folder(const std::filesystem::path& path, const std::string& expected);

/// What a folder holds, by name. @throws DataError where it is missing, no folder, or
/// cannot be read
std::vector<std::filesystem::path> list_folder(const std::filesystem::path& folder);

/// The number a file's name stands for: digits only, below 10^8, so that arithmetic with
/// it fits an int. @return nothing otherwise
std::optional<int> file_number(const std::string& stem);

/// At most 80 characters of a text, without control characters: what a message may quote
/// of a file.
std::string excerpt(std::string_view text);

/// Lines without their ends ("\n" or "\r\n"); a final newline makes no empty line.
std::vector<std::string> split_lines(const std::string& text);

/// Text without blanks at both ends.
std::string_view trimmed(std::string_view text);

/// One number that fills the text, "nan" and "inf" included. @return nothing where it is
/// no number
std::optional<double> parse_number(std::string_view text);

/// All numbers of a text parted by blanks or line ends. @return nothing where a word is
/// no number
std::optional<std::vector<double>> parse_numbers(std::string_view text);

}  // namespace relidar
