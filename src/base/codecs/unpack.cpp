// SPDX-License-Identifier: Apache-2.0
#include "base/codecs/unpack.hpp"

#include <memory>
#include <vector>

#include <lz4frame.h>
#include <zstd.h>

#include "base/fail.hpp"

namespace relidar {

void decompress_lz4(std::string_view compressed_bytes, std::span<char> uncompressed_bytes) {
    LZ4F_dctx* context = nullptr;
    if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION)))
        throw DataError("cannot initialise the lz4 decompression");
    std::size_t read = 0, written = 0, left = 0;
    do {  // `left` is 0 at the end of each frame
        std::size_t n_to = uncompressed_bytes.size() - written, n_from = compressed_bytes.size() - read;
        left = LZ4F_decompress(context, uncompressed_bytes.data() + written, &n_to,
                               compressed_bytes.data() + read, &n_from, nullptr);
        read += n_from;
        written += n_to;
        // Without progress, the input is truncated or the output is full.
        if (LZ4F_isError(left) || (n_to == 0 && n_from == 0)) break;
    } while (left != 0 || read < compressed_bytes.size());
    LZ4F_freeDecompressionContext(context);
    if (left != 0 || written != uncompressed_bytes.size())
        fail("lz4 data are damaged: they unpack to {} bytes, expected {}", written,
             uncompressed_bytes.size());
}

void decompress_zstd(std::string_view compressed_bytes, std::span<char> uncompressed_bytes) {
    const std::size_t n = ZSTD_decompress(uncompressed_bytes.data(), uncompressed_bytes.size(),
                                          compressed_bytes.data(), compressed_bytes.size());
    if (ZSTD_isError(n) || n != uncompressed_bytes.size())
        fail("zstd data are damaged, expected {} bytes after decompression", uncompressed_bytes.size());
}

bool stream_zstd(const std::function<std::string_view()>& read_block,
                 const std::function<void(std::string_view)>& write_block) {
    const std::unique_ptr<ZSTD_DCtx, std::size_t (*)(ZSTD_DCtx*)> context(ZSTD_createDCtx(), ZSTD_freeDCtx);
    if (!context) throw DataError("cannot initialise the zstd decompression");
    std::vector<char> block(ZSTD_DStreamOutSize());
    std::size_t left = 0;
    for (std::string_view bytes = read_block(); !bytes.empty(); bytes = read_block()) {
        ZSTD_inBuffer in{bytes.data(), bytes.size(), 0};
        ZSTD_outBuffer out{block.data(), block.size(), block.size()};
        // A full output block means that the decompressor may have more output.
        while (in.pos < in.size || out.pos == out.size) {
            out.pos = 0;
            left = ZSTD_decompressStream(context.get(), &out, &in);
            if (ZSTD_isError(left)) fail("zstd data are damaged: {}", ZSTD_getErrorName(left));
            write_block({block.data(), out.pos});
        }
    }
    // `left` is 0 at the end of a frame.
    return left == 0;
}

}  // namespace relidar
