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
// kCopied: not compressed. kOneStream: blocks are not divided by the bytes of an element.
enum Flag : std::uint8_t { kByteShuffle = 1, kCopied = 2, kBitShuffle = 4, kOneStream = 16 };
constexpr int kCodecShift = 5;
constexpr int kLz4Codec = 1;

/// Swaps rows and columns of a matrix of 8 x 8 bits. A byte is a row. Swaps single bits,
/// then blocks of 2 x 2 and 4 x 4 bits across the diagonal (Hacker's Delight, 7-3).
std::uint64_t transpose_bits(std::uint64_t x) {
    std::uint64_t t = (x ^ (x >> 7)) & 0x00AA00AA00AA00AAull;
    x ^= t ^ (t << 7);
    t = (x ^ (x >> 14)) & 0x0000CCCC0000CCCCull;
    x ^= t ^ (t << 14);
    t = (x ^ (x >> 28)) & 0x00000000F0F0F0F0ull;
    return x ^ t ^ (t << 28);
}

/// Undoes a bit shuffle of n elements, a multiple of 8. The block begins with bit 0 of
/// byte 0 of all elements, in n / 8 bytes, followed by their bit 1, and so on. So bit k
/// of byte b of all elements begins at byte (8 b + k) n / 8.
void undo_bit_shuffle(std::string_view block, std::size_t n, std::size_t element_bytes, char* out) {
    for (std::size_t i = 0; i < n; i += 8)
        for (std::size_t b = 0; b < element_bytes; ++b) {
            // Byte k of `bits` has bit k of byte b of eight elements. The transposition
            // exchanges bits and elements, so it then is byte b of element i + k.
            std::uint64_t bits = 0;
            for (std::size_t k = 8; k-- > 0;)
                bits = bits << 8 | std::uint8_t(block[(b * 8 + k) * (n / 8) + i / 8]);
            bits = transpose_bits(bits);
            for (std::size_t k = 0; k < 8; ++k) out[(i + k) * element_bytes + b] = char(bits >> (8 * k));
        }
}

/// Writes the elements of a block in their order. A byte shuffle stores the first byte of
/// all elements, then the second one, and so on; a bit shuffle does the same with bits.
/// The bytes after the last complete element are never shuffled. Blosc shuffles bits only
/// in groups of eight elements.
void undo_shuffle(std::string_view block, std::size_t element_bytes, unsigned flags, char* out) {
    const std::size_t n = block.size() / element_bytes;
    std::memcpy(out, block.data(), block.size());
    if ((flags & kByteShuffle) != 0) {
        for (std::size_t i = 0; i < n; ++i)
            for (std::size_t b = 0; b < element_bytes; ++b) out[i * element_bytes + b] = block[b * n + i];
    } else if ((flags & kBitShuffle) != 0 && n % 8 == 0) {
        undo_bit_shuffle(block, n, element_bytes, out);
    }
}

/// Appends the uncompressed bytes of a stream. A stream that LZ4 did not make smaller is
/// stored as it is.
void append_stream(codecs::ByteReader& reader, std::size_t n_bytes, std::string& block) {
    const std::string_view stream = reader.read_string();
    const std::size_t begin = block.size();
    if (stream.size() == n_bytes) {
        block += stream;
        return;
    }
    if (n_bytes > kMaxRatio * stream.size()) fail("blosc data are damaged: a stream is too short");
    block.resize(begin + n_bytes);
    const int n_unpacked =
        LZ4_decompress_safe(stream.data(), block.data() + begin, int(stream.size()), int(n_bytes));
    if (n_unpacked != int(n_bytes))
        fail("blosc data are damaged: a stream has {} bytes after decompression, expected {}", n_unpacked,
             n_bytes);
}

struct BloscHeader {
    unsigned flags = 0;  ///< bits of Flag, and the codec from bit kCodecShift on
    std::size_t element_bytes = 1;
    std::size_t n_bytes = 0;      ///< uncompressed size
    std::size_t block_bytes = 0;  ///< uncompressed size of a block; the last one may be shorter
    std::size_t chunk_bytes = 0;  ///< size of the chunk with its header
};

/// Reads the 16 bytes at the begin of a chunk.
BloscHeader read_blosc_header(codecs::ByteReader& reader) {
    reader.read_number<std::uint16_t>();  // versions of the format and of the codec
    BloscHeader header;
    header.flags = reader.read_number<std::uint8_t>();
    header.element_bytes = std::max<std::size_t>(1, reader.read_number<std::uint8_t>());
    header.n_bytes = reader.read_number<std::uint32_t>();
    header.block_bytes = reader.read_number<std::uint32_t>();
    header.chunk_bytes = reader.read_number<std::uint32_t>();
    return header;
}

/// Checks the sizes in a header before memory is allocated.
/// @param chunk_bytes  actual size of the chunk
void check_blosc_sizes(const BloscHeader& header, std::size_t chunk_bytes) {
    if (header.chunk_bytes != chunk_bytes)
        fail("blosc data are truncated or damaged: found {} bytes, expected {}", chunk_bytes,
             header.chunk_bytes);
    if ((header.flags & kCopied) != 0) {  // The header is followed by the plain bytes.
        if (chunk_bytes != kBloscHeaderBytes + header.n_bytes)
            fail("blosc data are damaged: found {} bytes, expected {}", chunk_bytes - kBloscHeaderBytes,
                 header.n_bytes);
        return;
    }
    if (int(header.flags >> kCodecShift) != kLz4Codec)
        fail("blosc data have the codec {}, expected {} (LZ4)", header.flags >> kCodecShift, kLz4Codec);
    const bool is_possible = header.block_bytes > 0 && header.block_bytes <= header.n_bytes &&
                             header.n_bytes <= kMaxRatio * chunk_bytes;
    if (header.n_bytes > 0 && !is_possible)
        fail("blosc data are damaged: {} bytes hold {} bytes in blocks of {}", chunk_bytes, header.n_bytes,
             header.block_bytes);
}

}  // namespace

void decompress_lz4(std::string_view compressed_bytes, std::span<char> uncompressed_bytes) {
    LZ4F_dctx* context = nullptr;
    if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION)))
        throw DataError("cannot initialise the lz4 decompression");
    // LZ4F_decompress() returns 0 at the end of each frame, otherwise a hint or an error.
    std::size_t read = 0, written = 0, status = 0;
    do {
        // Before the call the sizes of the buffers, after it the number of used bytes.
        std::size_t n_out = uncompressed_bytes.size() - written, n_in = compressed_bytes.size() - read;
        status = LZ4F_decompress(context, uncompressed_bytes.data() + written, &n_out,
                                 compressed_bytes.data() + read, &n_in, nullptr);
        read += n_in;
        written += n_out;
        // Without progress, the input is truncated or the output is full.
        if (LZ4F_isError(status) || (n_out == 0 && n_in == 0)) break;
    } while (status != 0 || read < compressed_bytes.size());
    LZ4F_freeDecompressionContext(context);
    if (status != 0 || written != uncompressed_bytes.size())
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
    std::size_t status = 0;  // 0 at the end of a frame, otherwise a hint or an error
    for (std::string_view bytes = read_block(); !bytes.empty(); bytes = read_block()) {
        ZSTD_inBuffer in{bytes.data(), bytes.size(), 0};
        ZSTD_outBuffer out{block.data(), block.size(), block.size()};
        // A full output block means that the decompressor may have more output.
        while (in.pos < in.size || out.pos == out.size) {
            out.pos = 0;
            status = ZSTD_decompressStream(context.get(), &out, &in);
            if (ZSTD_isError(status)) fail("zstd data are damaged: {}", ZSTD_getErrorName(status));
            write_block({block.data(), out.pos});
        }
    }
    return status == 0;
}

/// Decompresses a chunk block by block. The chunk has a header, the offsets of its
/// blocks, and the blocks. A block consists of one LZ4 stream, or of one stream for each
/// byte of an element.
std::string decompress_blosc(std::string_view chunk) {
    codecs::ByteReader reader(chunk);
    const BloscHeader header = read_blosc_header(reader);
    check_blosc_sizes(header, chunk.size());
    if ((header.flags & kCopied) != 0) return std::string(reader.read_rest());

    std::string bytes(header.n_bytes, '\0'), block;
    for (std::size_t begin = 0; begin < header.n_bytes; begin += header.block_bytes) {
        const std::size_t size = std::min(header.block_bytes, header.n_bytes - begin);
        const std::size_t stored_at = reader.read_number<std::uint32_t>();
        if (stored_at > chunk.size()) fail("blosc data are damaged: a block begins at byte {}", stored_at);
        codecs::ByteReader streams(chunk.substr(stored_at));
        // A divided block has one stream per byte of an element. A shorter block at the
        // end is never divided.
        const bool is_divided = (header.flags & kOneStream) == 0 && size == header.block_bytes &&
                                size % header.element_bytes == 0;
        const std::size_t n_streams = is_divided ? header.element_bytes : 1;
        block.clear();
        for (std::size_t s = 0; s < n_streams; ++s) append_stream(streams, size / n_streams, block);
        undo_shuffle(block, header.element_bytes, header.flags, bytes.data() + begin);
    }
    return bytes;
}

}  // namespace relidar
