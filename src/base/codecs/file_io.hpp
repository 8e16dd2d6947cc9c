// SPDX-License-Identifier: Apache-2.0
// Writes the bytes of files with C streams, because C++ streams do not report the cause
// of an error (errno). Error messages contain only the failed operation;
// write_atomically() adds the path.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <string>
#include <string_view>
#include <utility>

namespace relidar::codecs {

static_assert(std::endian::native == std::endian::little, "every format written here is little-endian");

/// Call close() at the end, because the destructor discards buffered data.
class OutputFile {
public:
    explicit OutputFile(const std::filesystem::path& path);
    ~OutputFile();
    OutputFile(const OutputFile&) = delete;
    OutputFile& operator=(const OutputFile&) = delete;

    void write(const void* data, std::size_t n_bytes);
    void write(std::string_view bytes) { write(bytes.data(), bytes.size()); }
    void close();

private:
    std::FILE* file_ = nullptr;
};

void write_file(const std::filesystem::path& path, std::string_view bytes);

std::string metadata_line(const std::pair<std::string, std::string>& key_and_value);

std::string errno_text(int error_number);

}  // namespace relidar::codecs
