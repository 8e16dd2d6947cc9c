// SPDX-License-Identifier: Apache-2.0
#include "base/codecs/unpack.hpp"

#include <fmt/format.h>
#include <lz4frame.h>
#include <zstd.h>

#include <relidar/base/error.hpp>

namespace relidar {

void decompress_lz4(std::string_view compressed_bytes, std::span<char> uncompressed_bytes) {
    LZ4F_dctx* context = nullptr;
    if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION)))
        throw DataError("cannot initialise the lz4 decompression");
    std::size_t read = 0, written = 0, left = 1;
    while (left != 0) {
        std::size_t n_to = uncompressed_bytes.size() - written, n_from = compressed_bytes.size() - read;
        left = LZ4F_decompress(context, uncompressed_bytes.data() + written, &n_to,
                               compressed_bytes.data() + read, &n_from, nullptr);
        read += n_from;
        written += n_to;
        if (LZ4F_isError(left) || (n_to == 0 && n_from == 0)) break;
    }
    LZ4F_freeDecompressionContext(context);
    if (left != 0 || written != uncompressed_bytes.size())
        throw DataError(fmt::format("an lz4 frame is damaged: it unpacks to {} bytes, expected {}", written,
                                    uncompressed_bytes.size()));
}

void decompress_zstd(std::string_view compressed_bytes, std::span<char> uncompressed_bytes) {
    const std::size_t n = ZSTD_decompress(uncompressed_bytes.data(), uncompressed_bytes.size(),
                                          compressed_bytes.data(), compressed_bytes.size());
    if (ZSTD_isError(n) || n != uncompressed_bytes.size())
        throw DataError(fmt::format("zstd data are damaged, expected {} bytes after decompression",
                                    uncompressed_bytes.size()));
}

}  // namespace relidar
