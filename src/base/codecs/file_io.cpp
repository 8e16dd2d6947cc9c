// SPDX-License-Identifier: Apache-2.0
// Uses C streams, because C++ streams do not report the cause of an error (errno).
#include "file_io.hpp"
#include "base/fail.hpp"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <memory>
#include <system_error>

#include <relidar/base/files.hpp>

namespace relidar::codecs {

std::string metadata_line(const std::pair<std::string, std::string>& key_and_value) {
    std::string line = key_and_value.first + " " + key_and_value.second;
    std::replace_if(
        line.begin(), line.end(), [](unsigned char character) { return std::iscntrl(character) != 0; }, ' ');
    return line;
}

std::string errno_text(int error_number) { return std::generic_category().message(error_number); }

OutputFile::OutputFile(const std::filesystem::path& path) : file_(std::fopen(path.c_str(), "wb")) {
    if (!file_) throw DataError("cannot create a temporary file in the same folder: " + errno_text(errno));
}

OutputFile::~OutputFile() {
    if (file_) std::fclose(file_);
}

void OutputFile::write(const void* data, std::size_t n_bytes) {
    if (n_bytes > 0 && std::fwrite(data, 1, n_bytes, file_) != n_bytes)
        fail("cannot write {} bytes: {}", n_bytes, errno_text(errno));
}

void OutputFile::close() {
    const bool flushed = std::fflush(file_) == 0;
    const int flush_error = errno;
    const bool closed = std::fclose(std::exchange(file_, nullptr)) == 0;
    if (!flushed || !closed)
        throw DataError("cannot write the last bytes: " + errno_text(flushed ? errno : flush_error));
}

void write_file(const std::filesystem::path& path, std::string_view bytes) {
    write_atomically(path, [&](const std::filesystem::path& temporary) {
        OutputFile file(temporary);
        file.write(bytes);
        file.close();
    });
}

std::vector<std::byte> read_file(const std::filesystem::path& path) {
    const auto refuse = [&](const std::string& why) { fail("cannot read '{}': {}", path.string(), why); };
    std::error_code error;
    const auto status = std::filesystem::status(path, error);
    if (!std::filesystem::exists(status)) refuse(errno_text(error ? error.value() : ENOENT));
    if (!std::filesystem::is_regular_file(status)) refuse("the path is not a regular file");
    const auto size = std::filesystem::file_size(path, error);
    if (error) refuse(error.message());

    std::FILE* file = std::fopen(path.c_str(), "rb");
    if (!file) refuse(errno_text(errno));
    const std::unique_ptr<std::FILE, int (*)(std::FILE*)> guard(file, std::fclose);
    std::vector<std::byte> bytes(size);
    if (size > 0 && std::fread(bytes.data(), 1, size, file) != size)
        refuse(std::ferror(file) ? errno_text(errno) : "the file became shorter while it was being read");
    return bytes;
}

}  // namespace relidar::codecs
