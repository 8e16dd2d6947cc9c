// SPDX-License-Identifier: Apache-2.0
// Reads Arrow IPC files. A file contains "ARROW1", messages, a footer, 4 bytes with the
// footer's length, and "ARROW1". A compressed buffer begins with its uncompressed length
// (8 bytes). The length -1 means that the buffer is not compressed.
#include "base/codecs/feather.hpp"

#include <cmath>
#include <utility>

#include <glm/gtc/packing.hpp>

#include "base/codecs/byte_reader.hpp"
#include "base/codecs/unpack.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {
namespace {

using codecs::ArrowCompression;
using codecs::ArrowField;
using codecs::ArrowValueKind;
using codecs::number_at;
using Batch = Feather::Batch;

constexpr std::string_view kArrowMagic = "ARROW1";
// Per byte of the file: rows of a table and bytes of text of a column.
constexpr std::size_t kMostRows = 64, kMostText = 1024;
constexpr std::size_t kMaxPaddingBytes = 64;  // Maximum number of padding bytes at the end of a buffer.

/// Returns the `n_bytes` bytes at an offset. Throws an error if the data ends before.
std::string_view checked_range(std::string_view bytes, std::int64_t offset, std::int64_t n_bytes,
                               const char* where) {
    if (offset < 0 || n_bytes < 0 || std::uint64_t(offset) > bytes.size() ||
        std::uint64_t(n_bytes) > bytes.size() - std::uint64_t(offset))
        fail("{} should be at byte {} with {} bytes, but the file has only {} bytes", where, offset, n_bytes,
             bytes.size());
    return bytes.substr(std::size_t(offset), std::size_t(n_bytes));
}

/// Returns the footer. Its length is stored before the magic at the end of the file.
std::string_view find_footer(std::string_view bytes) {
    constexpr std::size_t kHeaderBytes = 8, kTrailerBytes = 4 + kArrowMagic.size();
    if (bytes.size() < kHeaderBytes + kTrailerBytes || !bytes.starts_with(kArrowMagic))
        fail("the {} bytes of the file do not begin with ARROW1, expected a Feather V2 file", bytes.size());
    if (!bytes.ends_with(kArrowMagic))
        throw DataError("the file is truncated, because it does not end with ARROW1");
    const std::size_t footer_end = bytes.size() - kTrailerBytes;
    const std::int64_t footer_bytes = number_at<std::int32_t>(bytes, footer_end);
    return checked_range(bytes, std::int64_t(footer_end) - footer_bytes, footer_bytes, "a footer");
}

/// Reads the record batch (some rows of all columns) at a position of the file: a message
/// and a body with the buffers of the columns. The message begins with 0xFFFFFFFF and the
/// length of the flatbuffer that follows.
Batch read_batch(std::string_view bytes, const codecs::ArrowFileBlock& block) {
    constexpr std::int64_t kPrefixBytes = 8;
    const std::string_view message = checked_range(bytes, block.offset, block.metadata_bytes, "a message");
    if (std::int64_t(message.size()) < kPrefixBytes || number_at<std::uint32_t>(message, 0) != 0xFFFFFFFFu)
        fail("found no record batch at byte {}, expected a Feather file of Arrow 0.15 or later",
             block.offset);
    const auto flatbuffer_bytes = number_at<std::int32_t>(message, 4);
    const std::int64_t body_offset = block.offset + block.metadata_bytes;
    return {
        .layout = codecs::parse_batch(checked_range(message, kPrefixBytes, flatbuffer_bytes, "a message")),
        .body = checked_range(bytes, body_offset, block.body_bytes, "a record batch")};
}

/// Decompresses a buffer of a record batch. Its first 8 bytes are the uncompressed size;
/// -1 means that this buffer is not compressed. Throws an error if the result has fewer
/// than n_expected_bytes bytes, or more than n_expected_bytes plus padding.
std::string decompress(const Batch& batch, std::size_t buffer_index, std::size_t n_expected_bytes) {
    const codecs::ArrowBufferRange& buffer_range = batch.layout.buffers.at(buffer_index);
    std::string_view stored = checked_range(batch.body, buffer_range.offset, buffer_range.length, "a buffer");
    std::int64_t unpacked_bytes = -1;
    if (batch.layout.codec != ArrowCompression::none && !stored.empty()) {
        unpacked_bytes = number_at<std::int64_t>(stored, 0);
        stored.remove_prefix(sizeof unpacked_bytes);
    }
    const bool is_compressed = unpacked_bytes != -1;
    if (!is_compressed) unpacked_bytes = std::int64_t(stored.size());
    if (unpacked_bytes < std::int64_t(n_expected_bytes) ||
        unpacked_bytes > std::int64_t(n_expected_bytes + kMaxPaddingBytes))
        fail("found a buffer of {} bytes, expected {} bytes", unpacked_bytes, n_expected_bytes);
    if (!is_compressed) return std::string(stored.substr(0, n_expected_bytes));
    std::string bytes(std::size_t(unpacked_bytes), '\0');
    if (batch.layout.codec == ArrowCompression::lz4_frame) decompress_lz4(stored, bytes);
    else decompress_zstd(stored, bytes);
    return bytes;
}

/// Returns the number of rows of a column in a record batch. Throws an error if the
/// column has missing values, or if the batch lacks the node or a buffer of the column.
std::size_t rows_without_nulls(const Batch& batch, std::size_t node, std::size_t last_buffer_index) {
    if (node >= batch.layout.nodes.size() || last_buffer_index >= batch.layout.buffers.size())
        fail("a record batch has {} columns and {} buffers, which is fewer than the schema requires",
             batch.layout.nodes.size(), batch.layout.buffers.size());
    const codecs::ArrowFieldNode& field_node = batch.layout.nodes[node];
    if (field_node.length != batch.layout.length)
        fail("the column has {} rows in a record batch of {} rows, expected the same number",
             field_node.length, batch.layout.length);
    if (field_node.null_count != 0)
        fail("{} values are missing (null), expected none", field_node.null_count);
    return std::size_t(field_node.length);
}

/// Appends the values of a column in one batch. Buffer 0 of the column contains the
/// validity bits, buffer 1 the values.
template <class Stored, class T, class Convert>
void append_converted(std::vector<T>& values, const Batch& batch, const Feather::Column& column,
                      const Convert& convert_stored_value) {
    const std::size_t n = rows_without_nulls(batch, column.node, column.buffer + 1);
    const std::string bytes = decompress(batch, column.buffer + 1, n * sizeof(Stored));
    for (std::size_t i = 0; i < n; ++i)
        values.push_back(convert_stored_value(number_at<Stored>(bytes, i * sizeof(Stored))));
}

/// Appends the integers of a column that are stored as `Signed` or `Unsigned`.
template <class Signed, class Unsigned, class T>
void append_integers_as(std::vector<T>& values, const Batch& batch, const Feather::Column& column,
                        bool is_signed) {
    const auto convert = [](auto value) {
        if (!std::in_range<std::int64_t>(value)) fail("the integer {} has more than 63 bits", value);
        return T(value);
    };
    if (is_signed) append_converted<Signed>(values, batch, column, convert);
    else append_converted<Unsigned>(values, batch, column, convert);
}

/// Appends the integers of a column to `values`.
/// @param type  stored width and sign of the integers
template <class T>
void append_integers(std::vector<T>& values, const Batch& batch, const Feather::Column& column,
                     const ArrowField::Type& type) {
    if (type.bits == 8) append_integers_as<std::int8_t, std::uint8_t>(values, batch, column, type.is_signed);
    else if (type.bits == 16)
        append_integers_as<std::int16_t, std::uint16_t>(values, batch, column, type.is_signed);
    else if (type.bits == 32)
        append_integers_as<std::int32_t, std::uint32_t>(values, batch, column, type.is_signed);
    else append_integers_as<std::int64_t, std::uint64_t>(values, batch, column, type.is_signed);
}

void append_floats(std::vector<double>& values, const Batch& batch, const Feather::Column& column, int bits) {
    const auto as = [](auto value) { return double(value); };
    if (bits == 64) append_converted<double>(values, batch, column, as);
    else if (bits == 32) append_converted<float>(values, batch, column, as);
    else
        append_converted<std::uint16_t>(values, batch, column,
                                        [](std::uint16_t half) { return double(glm::unpackHalf1x16(half)); });
}

/// Appends the texts of a column in one batch. The column has three buffers: validity
/// bits, offsets, and the characters of all texts. Text i is between the offsets i and
/// i + 1.
/// @param node  index of the column in the batch
/// @param first_buffer  index of its validity bits in the batch
void append_texts(std::vector<std::string>& values, const Batch& batch, std::size_t node,
                  std::size_t first_buffer, std::size_t max_bytes) {
    const std::size_t offset_buffer = first_buffer + 1, character_buffer = first_buffer + 2;
    const std::size_t n = rows_without_nulls(batch, node, character_buffer);
    if (n == 0) return;  // Without rows, writers may omit the offsets.
    const std::string offsets = decompress(batch, offset_buffer, (n + 1) * sizeof(std::int32_t));
    const auto offset = [&](std::size_t index) {
        return number_at<std::int32_t>(offsets, index * sizeof(std::int32_t));
    };
    for (std::size_t i = 0; i < n; ++i)
        if (offset(i) < 0 || offset(i + 1) < offset(i))
            fail("text {} of the column has the bytes {} to {}, expected ascending numbers", i, offset(i),
                 offset(i + 1));
    if (std::size_t(offset(n)) > max_bytes)
        fail("found {} bytes of text, expected at most {}", offset(n), max_bytes);
    const std::string characters = decompress(batch, character_buffer, std::size_t(offset(n)));
    for (std::size_t i = 0; i < n; ++i)
        values.push_back(characters.substr(std::size_t(offset(i)), std::size_t(offset(i + 1) - offset(i))));
}

/// Replaces each index into a dictionary by its text. Limits repeated long texts.
std::vector<std::string> look_up_texts(const std::vector<std::string>& dictionary_texts,
                                       const std::vector<std::int64_t>& indices, std::size_t max_bytes) {
    std::vector<std::string> texts;
    std::size_t n_bytes = 0;
    for (const std::int64_t index : indices) {
        if (index < 0 || std::uint64_t(index) >= dictionary_texts.size())
            fail("a row refers to text {}, but the dictionary has only {} texts", index,
                 dictionary_texts.size());
        const std::string& text = dictionary_texts[std::size_t(index)];
        n_bytes += text.size();
        if (n_bytes > max_bytes)
            fail("found too much text in a column, expected at most {} bytes", max_bytes);
        texts.push_back(text);
    }
    return texts;
}

/// Reads the batches at the given positions of the file. Limits the sums of their sizes
/// and of their rows, because a damaged file could otherwise need too much memory.
/// @param n_free_bytes  number of file bytes that no batch has used yet
std::vector<Batch> read_batches(std::string_view file_bytes,
                                const std::vector<codecs::ArrowFileBlock>& blocks,
                                std::size_t& n_free_bytes) {
    std::vector<Batch> batches;
    std::size_t n_free_rows = kMostRows * file_bytes.size();
    for (const codecs::ArrowFileBlock& block : blocks) {
        const Batch& batch = batches.emplace_back(read_batch(file_bytes, block));
        const auto n_bytes = std::size_t(block.metadata_bytes + block.body_bytes);
        if (n_bytes > n_free_bytes) fail("the record batches have more bytes than the file");
        n_free_bytes -= n_bytes;
        const std::int64_t n_rows = batch.layout.length;
        if (n_rows < 0 || std::uint64_t(n_rows) > n_free_rows)
            fail("a record batch has {} rows, expected at most {} in a file of this size", n_rows,
                 n_free_rows);
        n_free_rows -= std::size_t(n_rows);
    }
    return batches;
}

}  // namespace

/// Finds the columns and batches of a file. Columns are decompressed when they are read.
Feather::Feather(std::string where, std::string bytes) : name_(std::move(where)), bytes_(std::move(bytes)) {
    try {
        const codecs::Footer footer = codecs::parse_footer(find_footer(bytes_));
        // A batch lists one node per column, and the buffers of all columns in order.
        std::size_t first_buffer = 0;
        for (const ArrowField& field : footer.fields) {
            columns_.push_back({.field = field, .node = columns_.size(), .buffer = first_buffer});
            first_buffer += field.buffer_count();
        }
        std::size_t n_free_bytes = bytes_.size();
        dictionaries_ = read_batches(bytes_, footer.dictionaries, n_free_bytes);
        batches_ = read_batches(bytes_, footer.batches, n_free_bytes);
        for (const Batch& batch : batches_) rows_ += std::size_t(batch.layout.length);
    } catch (const DataError& error) {
        throw DataError(name_ + ": " + error.what());
    }
}

const Feather::Column& Feather::find_column(const std::string& column_name) const {
    std::string names;
    for (const Column& column : columns_) {
        if (column.field.name == column_name) return column;
        names += (names.empty() ? "" : ", ") + column.field.name;
    }
    fail("the file has no such column, expected one of '{}'", quote(names));
}

template <class Task>
auto Feather::with_location(const std::string& column_name, const Task& task) const {
    try {
        return task(find_column(column_name));
    } catch (const DataError& error) {
        fail("{}, column '{}': {}", name_, column_name, error.what());
    }
}

std::vector<double> Feather::read_numbers(const std::string& column_name) const {
    return with_location(column_name, [&](const Column& column) {
        const ArrowField::Type& type = column.field.type;
        if (type.kind == ArrowValueKind::text || column.field.dictionary)
            throw DataError("found text, expected numbers");
        std::vector<double> values;
        for (const Batch& batch : batches_) {
            if (type.kind == ArrowValueKind::integer) append_integers(values, batch, column, type);
            else append_floats(values, batch, column, type.bits);
        }
        for (std::size_t i = 0; i < values.size(); ++i)
            if (!std::isfinite(values[i])) fail("row {} is {}, expected a finite number", i, values[i]);
        return values;
    });
}

std::vector<std::int64_t> Feather::read_integers(const std::string& column_name) const {
    return with_location(column_name, [&](const Column& column) {
        if (column.field.type.kind != ArrowValueKind::integer || column.field.dictionary)
            throw DataError("found values that are not integers, expected integers");
        std::vector<std::int64_t> values;
        for (const Batch& batch : batches_) append_integers(values, batch, column, column.field.type);
        return values;
    });
}

/// Reads a column of texts. Its rows are either texts, or indices into a dictionary of
/// texts, which separate batches contain.
std::vector<std::string> Feather::read_texts(const std::string& column_name) const {
    return with_location(column_name, [&](const Column& column) {
        if (column.field.type.kind != ArrowValueKind::text) throw DataError("found numbers, expected text");
        const std::size_t max_bytes = kMostText * bytes_.size();  // stops a damaged file
        std::vector<std::string> texts;
        if (!column.field.dictionary) {
            for (const Batch& batch : batches_)
                append_texts(texts, batch, column.node, column.buffer, max_bytes);
            return texts;
        }
        // A dictionary batch has a single column, so its node and its first buffer are 0.
        for (const Batch& batch : dictionaries_)
            if (batch.layout.dictionary == column.field.dictionary->id)
                append_texts(texts, batch, 0, 0, max_bytes);
        std::vector<std::int64_t> indices;
        for (const Batch& batch : batches_)
            append_integers(indices, batch, column, column.field.dictionary->index);
        return look_up_texts(texts, indices, max_bytes);
    });
}

}  // namespace relidar
