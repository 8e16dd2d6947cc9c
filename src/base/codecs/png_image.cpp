// SPDX-License-Identifier: Apache-2.0
// Writes 8-bit RGB images as PNG files. Uses the simplified interface of libpng, because
// it reports failures by return values instead of longjmp.
#include <relidar/base/files.hpp>
#include <relidar/base/images.hpp>

#include <algorithm>

#include <png.h>
#include <zlib.h>

#include "base/fail.hpp"
#include "file_io.hpp"

namespace relidar {

namespace {

void append_be32(std::string& bytes, std::uint32_t value) {
    for (int shift = 24; shift >= 0; shift -= 8) bytes += static_cast<char>(value >> shift);
}

/// Returns a PNG text chunk (iTXt) with a name and an uncompressed UTF-8 text. We write
/// this chunk ourselves, because the simplified interface of libpng cannot write text.
std::string make_text_chunk(const std::string& keyword, const std::string& text) {
    // The zero bytes: end of the name, not compressed, method 0, no language, no
    // translation.
    const std::string body = "iTXt" + keyword + std::string(5, '\0') + text;
    std::string chunk;
    append_be32(chunk, static_cast<std::uint32_t>(body.size() - 4));
    chunk += body;
    append_be32(chunk, static_cast<std::uint32_t>(crc32(0, reinterpret_cast<const Bytef*>(body.data()),
                                                        static_cast<uInt>(body.size()))));
    return chunk;
}

// Size of the PNG signature (8) and the IHDR chunk (25).
constexpr std::ptrdiff_t kAfterHeader = 8 + 25;

}  // namespace

std::vector<std::uint8_t> encode_png(const Image& image, const FileMetadata& metadata) {
    const std::size_t n = std::size_t(std::max(image.rows, 0)) * std::size_t(std::max(image.columns, 0)) * 3;
    if (n == 0 || image.rgb.size() != n)
        fail("cannot encode a PNG image of {} x {} pixels: found {} bytes, expected {}", image.rows,
             image.columns, image.rgb.size(), n);
    png_image description{};
    description.version = PNG_IMAGE_VERSION;
    description.width = png_uint_32(image.columns);
    description.height = png_uint_32(image.rows);
    description.format = PNG_FORMAT_RGB;
    png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(description);
    std::vector<std::uint8_t> bytes(size);
    const int done =
        png_image_write_to_memory(&description, bytes.data(), &size, 0, image.rgb.data(), 0, nullptr);
    const std::string message = description.message;
    png_image_free(&description);
    if (!done) throw DataError("cannot encode a PNG image: " + message);
    bytes.resize(size);
    std::string chunks;
    for (const auto& [name, text] : metadata) chunks += make_text_chunk(name, text);
    bytes.insert(bytes.begin() + kAfterHeader, chunks.begin(), chunks.end());
    return bytes;
}

void write_png(const std::filesystem::path& path, const Image& image, const FileMetadata& metadata) {
    const std::vector<std::uint8_t> bytes = encode_png(image, metadata);
    codecs::write_file(path, {reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

}  // namespace relidar
