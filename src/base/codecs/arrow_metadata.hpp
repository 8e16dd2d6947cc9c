// SPDX-License-Identifier: Apache-2.0
// Parses the metadata of Arrow IPC files: the footer at the end of the file, and the
// message before each record batch. Both are flatbuffers. Field numbers come from Arrow's
// public format (File.fbs, Schema.fbs, Message.fbs). Each position is checked against the
// size of the buffer before it is read.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::codecs {

enum class ArrowValueKind { integer, floating, text };
enum class ArrowCompression { none, lz4_frame, zstd };

/// For a dictionary-encoded column, also the type of its indices.
struct ArrowField {
    struct Type {
        ArrowValueKind kind = ArrowValueKind::text;
        int bits = 0;            ///< Size of a number in bits: 8, 16, 32 or 64. 0 for text.
        bool is_signed = false;  ///< True for signed integers.
    };
    std::string name;
    Type type;
    struct Dictionary {
        std::int64_t id = 0;
        Type index;
    };
    std::optional<Dictionary> dictionary;

    /// Returns the number of buffers that a record batch stores for this column. Numbers:
    /// validity and values. Text: validity, offsets and characters.
    std::size_t buffer_count() const { return type.kind == ArrowValueKind::text && !dictionary ? 3 : 2; }
};

struct ArrowFileBlock {
    std::int64_t offset;
    std::int32_t metadata_bytes;
    std::int32_t padding;
    std::int64_t body_bytes;
};

struct ArrowFieldNode {
    std::int64_t length;
    std::int64_t null_count;
};

struct ArrowBufferRange {
    std::int64_t offset;
    std::int64_t length;
};

struct Footer {
    std::vector<ArrowField> fields;
    std::vector<ArrowFileBlock> dictionaries, batches;
};

struct RecordBatch {
    /// nullopt if the batch contains rows of the table.
    std::optional<std::int64_t> dictionary;
    std::int64_t length = 0;
    std::vector<ArrowFieldNode> nodes;
    std::vector<ArrowBufferRange> buffers;
    ArrowCompression codec = ArrowCompression::none;
};

Footer parse_footer(std::string_view footer_bytes);
RecordBatch parse_batch(std::string_view message_bytes);

}  // namespace relidar::codecs
