// SPDX-License-Identifier: Apache-2.0
// Bytes to and from files, with every failure noticed: short writes, failed flushes,
// files that shrink while read. Messages name only what failed; write_atomically and the
// readers add path and purpose. Private to export.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace relidar::export_detail {

static_assert(std::endian::native == std::endian::little, "every format written here is little-endian");

/// A file opened for writing. Destruction without close() leaves the file as it is,
/// unflushed data lost.
class OutputFile {
public:
    explicit OutputFile(const std::filesystem::path& path);
    ~OutputFile();
    OutputFile(const OutputFile&) = delete;
    OutputFile& operator=(const OutputFile&) = delete;

    void write(const void* data, std::size_t n_bytes);
    void write(std::string_view bytes) { write(bytes.data(), bytes.size()); }
    /// Flushes and closes. @throws DataError where the system could not take all bytes
    void close();

private:
    std::FILE* file_ = nullptr;
};

/// Writes a whole file through write_atomically.
void write_file(const std::filesystem::path& path, std::string_view bytes);

/// A whole file. @throws DataError naming the path
std::vector<std::byte> read_file(const std::filesystem::path& path);

/// A note of a file as one line of its header.
std::string note_line(const std::pair<std::string, std::string>& note);

/// Message of a system error number, as strerror.
std::string system_message(int error);

}  // namespace relidar::export_detail
