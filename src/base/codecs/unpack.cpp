// SPDX-License-Identifier: Apache-2.0
#include "base/codecs/unpack.hpp"

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <memory>
#include <vector>

#include <lz4.h>
#include <lz4frame.h>
#include <zstd.h>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"

namespace relidar {
namespace {

constexpr std::size_t kBloscHeaderBytes = 16;
// LZ4 cannot compress data to less than this share of their size. The limit prevents a
// damaged header from using much memory.
constexpr std::uint64_t kMaxRatio = 255;
enum Flag : std::uint8_t { kByteShuffle = 1, kCopied = 2, kBitShuffle = 4, kOneStream = 16 };
constexpr int kCodecShift = 5;
constexpr int kLz4Codec = 1;

/// Swaps rows and columns of a matrix of 8 x 8 bits. A byte is a row.
std::uint64_t transpose_bits(std::uint64_t x) {
    std::uint64_t t = (x ^ (x >> 7)) & 0x00AA00AA00AA00AAull;
    x ^= t ^ (t << 7);
    t = (x ^ (x >> 14)) & 0x0000CCCC0000CCCCull;
    x ^= t ^ (t << 14);
    t = (x ^ (x >> 28)) & 0x00000000F0F0F0F0ull;
    return x ^ t ^ (t << 28);
}

/// Writes the elements of a block in their order. The bytes after the last complete
/// element are never shuffled.
void undo_shuffle(std::string_view block, std::size_t element_bytes, unsigned flags, char* out) {
    const std::size_t n = block.size() / element_bytes;
    std::memcpy(out, block.data(), block.size());
    if ((flags & kByteShuffle) != 0) {
        for (std::size_t i = 0; i < n; ++i)
            for (std::size_t b = 0; b < element_bytes; ++b) out[i * element_bytes + b] = block[b * n + i];
    } else if ((flags & kBitShuffle) != 0 && n % 8 == 0) {
        for (std::size_t i = 0; i < n; i += 8)
            for (std::size_t b = 0; b < element_bytes; ++b) {
                std::uint64_t bits = 0;  // byte k: bit k of this byte of eight elements
                for (std::size_t k = 8; k-- > 0;)
                    bits = bits << 8 | std::uint8_t(block[(b * 8 + k) * (n / 8) + i / 8]);
                bits = transpose_bits(bits);
                for (std::size_t k = 0; k < 8; ++k) out[(i + k) * element_bytes + b] = char(bits >> (8 * k));
            }
    }
}

/// Appends the uncompressed bytes of a stream. A stream that LZ4 did not make smaller is
/// stored as it is.
void append_stream(codecs::ByteReader& reader, std::size_t n_bytes, std::string& block) {
    const std::string_view stream = reader.read_string();
    const std::size_t at = block.size();
    if (stream.size() == n_bytes) {
        block += stream;
        return;
    }
    if (n_bytes > kMaxRatio * stream.size()) fail("blosc data are damaged: a stream is too short");
    block.resize(at + n_bytes);
    const int n = LZ4_decompress_safe(stream.data(), block.data() + at, int(stream.size()), int(n_bytes));
    if (n != int(n_bytes))
        fail("blosc data are damaged: a stream has {} bytes after decompression, expected {}", n, n_bytes);
}

}  // namespace

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

/// A chunk has a header of 16 bytes, the offsets of its blocks, and the blocks. A block
/// consists of one LZ4 stream, or of one stream for each byte of an element. A shuffle
/// stores the same byte, or the same bit, of all elements of a block together.
std::string decompress_blosc(std::string_view chunk) {
    codecs::ByteReader header(chunk);
    header.read_number<std::uint16_t>();  // versions of the format and of the codec
    const unsigned flags = header.read_number<std::uint8_t>();
    const std::size_t element_bytes = std::max<std::size_t>(1, header.read_number<std::uint8_t>());
    const std::size_t n_bytes = header.read_number<std::uint32_t>(),
                      block_bytes = header.read_number<std::uint32_t>(),
                      chunk_bytes = header.read_number<std::uint32_t>();
    if (chunk_bytes != chunk.size())
        fail("blosc data are truncated or damaged: found {} bytes, expected {}", chunk.size(), chunk_bytes);
    if ((flags & kCopied) != 0) {
        if (chunk.size() != kBloscHeaderBytes + n_bytes)
            fail("blosc data are damaged: found {} bytes, expected {}", chunk.size() - kBloscHeaderBytes,
                 n_bytes);
        return std::string(header.read_rest());
    }
    if (int(flags >> kCodecShift) != kLz4Codec)
        fail("blosc data have the codec {}, expected {} (LZ4)", flags >> kCodecShift, kLz4Codec);
    if (n_bytes > 0 && (block_bytes == 0 || block_bytes > n_bytes || n_bytes > kMaxRatio * chunk_bytes))
        fail("blosc data are damaged: {} bytes hold {} bytes in blocks of {}", chunk_bytes, n_bytes,
             block_bytes);
    std::string bytes(n_bytes, '\0'), block;
    for (std::size_t at = 0; at < n_bytes; at += block_bytes) {
        const std::size_t size = std::min(block_bytes, n_bytes - at),
                          start = header.read_number<std::uint32_t>();
        if (start > chunk.size()) fail("blosc data are damaged: a block begins at byte {}", start);
        codecs::ByteReader reader(chunk.substr(start));
        const bool is_split = (flags & kOneStream) == 0 && size == block_bytes && size % element_bytes == 0;
        const std::size_t n_streams = is_split ? element_bytes : 1;
        block.clear();
        for (std::size_t s = 0; s < n_streams; ++s) append_stream(reader, size / n_streams, block);
        undo_shuffle(block, element_bytes, flags, bytes.data() + at);
    }
    return bytes;
}

}  // namespace relidar
