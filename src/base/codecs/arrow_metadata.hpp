// SPDX-License-Identifier: Apache-2.0
// What an Arrow IPC file says of itself: the footer at its end and the message before
// each record batch, both flatbuffers. Field numbers are those of Arrow's public format
// (File.fbs, Schema.fbs, Message.fbs). Nothing is read that was not verified to lie in
// the buffer.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::arrow {

enum class Kind { integer, floating, text };
enum class Codec { none, lz4_frame, zstd };

/// A column: its values, or where it is encoded by a dictionary, those of the dictionary
/// and the type of the indices.
struct Field {
    struct Type {
        Kind kind = Kind::text;
        int bits = 0;            ///< 8, 16, 32 or 64; 0 of text
        bool is_signed = false;  ///< of an integer
    };
    std::string name;
    Type type;
    struct Dictionary {
        std::int64_t id = 0;
        Type index;
    };
    std::optional<Dictionary> dictionary;

    /// Buffers of this column in a record batch: validity, values; of text validity,
    /// offsets, characters.
    std::size_t count_buffers() const { return type.kind == Kind::text && !dictionary ? 3 : 2; }
};

/// Where a record batch lies in the file: the message, then the body.
struct Block {
    std::int64_t offset;
    std::int32_t metadata_bytes;  ///< of the message, with the 8 bytes before it
    std::int32_t padding;
    std::int64_t body_bytes;
};

/// Rows of a column in a record batch.
struct Node {
    std::int64_t length;
    std::int64_t null_count;
};

/// Part of the body of a record batch.
struct Buffer {
    std::int64_t offset;
    std::int64_t length;
};

struct Footer {
    std::vector<Field> fields;
    std::vector<Block> dictionaries, batches;
};

struct RecordBatch {
    /// whose values it holds; nothing where it holds rows of the table
    std::optional<std::int64_t> dictionary;
    std::int64_t length = 0;
    std::vector<Node> nodes;
    std::vector<Buffer> buffers;
    Codec codec = Codec::none;
};

/// @param bytes  of the flatbuffer @throws DataError without the file's name: what is
/// wrong
Footer parse_footer(std::string_view bytes);
/// @param bytes  of the message's flatbuffer @throws as parse_footer
RecordBatch parse_batch(std::string_view bytes);

}  // namespace relidar::arrow
