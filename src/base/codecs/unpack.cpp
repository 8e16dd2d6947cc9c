// SPDX-License-Identifier: Apache-2.0
#include "base/codecs/unpack.hpp"

#include <fmt/format.h>
#include <lz4frame.h>
#include <zstd.h>

#include <relidar/base/error.hpp>

namespace relidar {

void unpack_lz4(std::string_view source, std::span<char> target) {
    LZ4F_dctx* context = nullptr;
    if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION)))
        throw DataError("cannot initialise the lz4 decompression");
    std::size_t read = 0, written = 0, left = 1;
    while (left != 0) {
        std::size_t n_to = target.size() - written, n_from = source.size() - read;
        left =
            LZ4F_decompress(context, target.data() + written, &n_to, source.data() + read, &n_from, nullptr);
        read += n_from, written += n_to;
        if (LZ4F_isError(left) || (n_to == 0 && n_from == 0)) break;
    }
    LZ4F_freeDecompressionContext(context);
    if (left != 0 || written != target.size())
        throw DataError(fmt::format("an lz4 frame is damaged: it unpacks to {} bytes, expected {}", written,
                                    target.size()));
}

void unpack_zstd(std::string_view source, std::span<char> target) {
    const std::size_t n = ZSTD_decompress(target.data(), target.size(), source.data(), source.size());
    if (ZSTD_isError(n) || n != target.size())
        throw DataError(
            fmt::format("zstd data are damaged, expected {} bytes after decompression", target.size()));
}

}  // namespace relidar
