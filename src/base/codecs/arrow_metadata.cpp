// SPDX-License-Identifier: Apache-2.0
// Reads the tables of a flatbuffer by field number. A table refers to a vtable. The
// vtable contains two sizes, followed by the offset of each field.
#include "base/codecs/arrow_metadata.hpp"

#include <cstring>

#include <flatbuffers/flatbuffers.h>

#include "base/fail.hpp"

namespace relidar::codecs {
namespace {

constexpr flatbuffers::uoffset_t kMostTables = 10000;
constexpr std::size_t kLongestName = 200;

// Values of the unions and enumerations in Arrow's format.
constexpr std::uint8_t kTypeInt = 2, kTypeFloat = 3, kTypeUtf8 = 5;
constexpr std::uint8_t kHeaderDictionary = 2, kHeaderRecords = 3;
constexpr std::int8_t kCodecLz4 = 0, kCodecZstd = 1;

// Field numbers in Arrow's tables Int, FloatingPoint, Field, DictionaryEncoding, Schema,
// Footer, Message, DictionaryBatch and RecordBatch.
constexpr int kIntBits = 0, kIntIsSigned = 1, kFloatPrecision = 0;
constexpr int kFieldName = 0, kFieldTypeCode = 2, kFieldType = 3, kFieldDictionary = 4;
constexpr int kEncodingId = 0, kEncodingIndexType = 1;
constexpr int kSchemaEndianness = 0, kSchemaFields = 1;
constexpr int kFooterSchema = 1, kFooterDictionaries = 2, kFooterBatches = 3;
constexpr int kMessageHeaderCode = 1, kMessageHeader = 2;
constexpr int kDictionaryBatchId = 0, kDictionaryBatchData = 1;
constexpr int kBatchLength = 0, kBatchNodes = 1, kBatchBuffers = 2, kBatchCompression = 3;

[[noreturn]] void fail_arrow(const char* description) {
    fail("the Arrow metadata of the file are malformed: the {} is invalid; expected an Arrow IPC file",
         description);
}

/// Copies a flatbuffer to aligned memory, because it may be unaligned in the file.
struct AlignedFlatbuffer {
    std::vector<std::uint64_t> words;
    flatbuffers::Verifier verifier;

    explicit AlignedFlatbuffer(std::string_view bytes)
        : words(bytes.size() / 8 + 1), verifier(data(), bytes.size(), {.max_tables = kMostTables}) {
        if (bytes.size() >= FLATBUFFERS_MAX_BUFFER_SIZE) fail_arrow("size of the metadata");
        std::memcpy(words.data(), bytes.data(), bytes.size());
    }
    const std::uint8_t* data() const { return reinterpret_cast<const std::uint8_t*>(words.data()); }
};

/// Reads the fields of a table by number. Checks each position before it reads.
class FlatbufferTable {
public:
    static FlatbufferTable root_table(AlignedFlatbuffer& flatbuffer) {
        const auto offset = flatbuffer.verifier.VerifyOffset(std::size_t(0));
        if (offset == 0) fail_arrow("root table");
        return {flatbuffer, flatbuffer.data() + offset};
    }

    template <class T>
    T read_scalar(int field_number, T default_value) const {
        if (!table_->VerifyField<T>(bytes_->verifier, vtable_offset(field_number), sizeof(T)))
            fail_arrow("number");
        return table_->GetField<T>(vtable_offset(field_number), default_value);
    }
    std::optional<FlatbufferTable> find_table(int field_number) const {
        const std::uint8_t* at = field_pointer(field_number);
        return at ? std::optional<FlatbufferTable>(FlatbufferTable(*bytes_, at)) : std::nullopt;
    }
    FlatbufferTable read_table(int field_number, const char* where) const {
        const std::optional<FlatbufferTable> child_table = find_table(field_number);
        if (!child_table) fail_arrow(where);
        return *child_table;
    }
    std::string read_name_field(int field_number) const {
        const auto* text = reinterpret_cast<const flatbuffers::String*>(field_pointer(field_number));
        if (!text || !bytes_->verifier.VerifyString(text) || text->size() > kLongestName) fail_arrow("name");
        return text->str();
    }
    /// A vector of structs: its length (4 bytes), then the structs, maybe unaligned.
    template <class Struct>
    std::vector<Struct> read_structs(int field_number) const {
        const std::uint8_t* vector = verified_vector(field_number, sizeof(Struct));
        std::vector<Struct> values(vector ? flatbuffers::ReadScalar<flatbuffers::uoffset_t>(vector) : 0);
        if (!values.empty())
            std::memcpy(values.data(), vector + sizeof(flatbuffers::uoffset_t),
                        values.size() * sizeof(Struct));
        return values;
    }
    std::vector<FlatbufferTable> read_tables(int field_number) const {
        // A vector is its length, followed by one offset per table. Each offset counts
        // from its own position.
        const std::uint8_t* vector = verified_vector(field_number, sizeof(flatbuffers::uoffset_t));
        std::vector<FlatbufferTable> all;
        const std::size_t n = vector ? flatbuffers::ReadScalar<flatbuffers::uoffset_t>(vector) : 0;
        for (std::size_t i = 0; i < n; ++i) {
            const std::uint8_t* element = vector + (i + 1) * sizeof(flatbuffers::uoffset_t);
            const auto offset = bytes_->verifier.VerifyOffset(std::size_t(element - bytes_->data()));
            if (offset == 0) fail_arrow("table");
            all.push_back(FlatbufferTable(*bytes_, element + offset));
        }
        return all;
    }

private:
    FlatbufferTable(AlignedFlatbuffer& bytes, const std::uint8_t* at)
        : bytes_(&bytes), table_(reinterpret_cast<const flatbuffers::Table*>(at)) {
        if (!table_->VerifyTableStart(bytes.verifier)) fail_arrow("table");
        // VerifyTableStart() has increased the depth. This parser reads a fixed depth.
        bytes.verifier.EndTable();
    }

    static flatbuffers::voffset_t vtable_offset(int field_number) {
        return flatbuffers::voffset_t(4 + 2 * field_number);
    }

    const std::uint8_t* field_pointer(int field_number) const {
        if (!table_->VerifyOffset(bytes_->verifier, vtable_offset(field_number))) fail_arrow("offset");
        return table_->GetPointer<const std::uint8_t*>(vtable_offset(field_number));
    }
    const std::uint8_t* verified_vector(int field_number, std::size_t element_size_bytes) const {
        const std::uint8_t* vector = field_pointer(field_number);
        if (vector && !bytes_->verifier.VerifyVectorOrString(vector, element_size_bytes))
            fail_arrow("vector");
        return vector;
    }

    AlignedFlatbuffer* bytes_;
    const flatbuffers::Table* table_;
};

ArrowField::Type parse_int_type(const FlatbufferTable& type_table) {
    const auto bits = type_table.read_scalar<std::int32_t>(kIntBits, 0);
    if (bits != 8 && bits != 16 && bits != 32 && bits != 64) fail_arrow("width of integers");
    return {ArrowValueKind::integer, bits, type_table.read_scalar<std::uint8_t>(kIntIsSigned, 0) != 0};
}

ArrowField::Type parse_float_type(const FlatbufferTable& type_table) {
    const auto precision = type_table.read_scalar<std::int16_t>(kFloatPrecision, 0);
    if (precision < 0 || precision > 2) fail_arrow("precision");
    // 0, 1 and 2 are half, single and double precision: 16, 32 and 64 bits.
    return {ArrowValueKind::floating, 16 << precision, true};
}

/// Parses the description of a column: its name, the type of its values, and, if its rows
/// are indices into a dictionary, the dictionary and the type of these indices.
ArrowField parse_field(const FlatbufferTable& field_table) {
    ArrowField field;
    field.name = field_table.read_name_field(kFieldName);
    const auto type = field_table.read_scalar<std::uint8_t>(kFieldTypeCode, 0);
    if (type == kTypeInt) field.type = parse_int_type(field_table.read_table(kFieldType, "type"));
    else if (type == kTypeFloat) field.type = parse_float_type(field_table.read_table(kFieldType, "type"));
    else if (type != kTypeUtf8)
        fail("column '{}' has the Arrow type {}, expected integers, floating point numbers or utf8 text",
             field.name, type);
    if (const std::optional<FlatbufferTable> encoding = field_table.find_table(kFieldDictionary)) {
        // Without an index type, the indices are signed 32-bit integers.
        ArrowField::Type index_type{.kind = ArrowValueKind::integer, .bits = 32, .is_signed = true};
        if (const std::optional<FlatbufferTable> stored_type = encoding->find_table(kEncodingIndexType))
            index_type = parse_int_type(*stored_type);
        field.dictionary = {.id = encoding->read_scalar<std::int64_t>(kEncodingId, 0), .index = index_type};
    }
    return field;
}

ArrowCompression parse_codec(const FlatbufferTable& batch_table) {
    const std::optional<FlatbufferTable> compression = batch_table.find_table(kBatchCompression);
    if (!compression) return ArrowCompression::none;
    const auto codec = compression->read_scalar<std::int8_t>(0, kCodecLz4);
    if (codec != kCodecLz4 && codec != kCodecZstd)
        fail("the data are compressed with codec {}, expected lz4 frames or zstd", codec);
    return codec == kCodecLz4 ? ArrowCompression::lz4_frame : ArrowCompression::zstd;
}

}  // namespace

/// Parses the footer of an Arrow file: the columns of the table, and the file positions
/// of the batches with dictionaries and with rows.
Footer parse_footer(std::string_view footer_bytes) {
    AlignedFlatbuffer aligned_copy(footer_bytes);
    const FlatbufferTable footer = FlatbufferTable::root_table(aligned_copy);
    const FlatbufferTable schema = footer.read_table(kFooterSchema, "schema");
    if (schema.read_scalar<std::int16_t>(kSchemaEndianness, 0) != 0)
        throw DataError("the numbers are big-endian, expected little-endian");
    Footer parsed;
    for (const FlatbufferTable& field : schema.read_tables(kSchemaFields))
        parsed.fields.push_back(parse_field(field));
    parsed.dictionaries = footer.read_structs<ArrowFileBlock>(kFooterDictionaries);
    parsed.batches = footer.read_structs<ArrowFileBlock>(kFooterBatches);
    return parsed;
}

/// Parses the message before the data of a batch: its number of rows, the numbers of
/// missing values of its columns (nodes), and the positions of their buffers in the data.
/// The rows of a dictionary batch are the values of a dictionary; its message contains
/// the message of a record batch.
RecordBatch parse_batch(std::string_view message_bytes) {
    AlignedFlatbuffer aligned_copy(message_bytes);
    const FlatbufferTable message = FlatbufferTable::root_table(aligned_copy);
    const auto kind = message.read_scalar<std::uint8_t>(kMessageHeaderCode, 0);
    if (kind != kHeaderDictionary && kind != kHeaderRecords) fail_arrow("kind of message");
    FlatbufferTable records = message.read_table(kMessageHeader, "header");
    RecordBatch batch;
    if (kind == kHeaderDictionary) {
        batch.dictionary = records.read_scalar<std::int64_t>(kDictionaryBatchId, 0);
        records = records.read_table(kDictionaryBatchData, "dictionary");
    }
    batch.length = records.read_scalar<std::int64_t>(kBatchLength, 0);
    batch.nodes = records.read_structs<ArrowFieldNode>(kBatchNodes);
    batch.buffers = records.read_structs<ArrowBufferRange>(kBatchBuffers);
    batch.codec = parse_codec(records);
    return batch;
}

}  // namespace relidar::codecs
