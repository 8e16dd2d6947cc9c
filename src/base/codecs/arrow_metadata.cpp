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
    /// A vector of structs: its length (4 bytes), then the structs, which may be
    /// unaligned.
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
        // VerifyTableStart() has increased the depth. This parser reads a fixed number of
        // levels.
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
    const auto bits = type_table.read_scalar<std::int32_t>(0, 0);
    if (bits != 8 && bits != 16 && bits != 32 && bits != 64) fail_arrow("width of integers");
    return {ArrowValueKind::integer, bits, type_table.read_scalar<std::uint8_t>(1, 0) != 0};
}

ArrowField::Type parse_float_type(const FlatbufferTable& type_table) {
    const auto precision = type_table.read_scalar<std::int16_t>(0, 0);
    if (precision < 0 || precision > 2) fail_arrow("precision");
    return {ArrowValueKind::floating, 16 << precision, true};
}

/// Field numbers: Field {0 name, 2 type_type, 3 type, 4 dictionary}, DictionaryEncoding
/// {0 id, 1 indexType}.
ArrowField parse_field(const FlatbufferTable& field_table) {
    ArrowField field;
    field.name = field_table.read_name_field(0);
    const auto type = field_table.read_scalar<std::uint8_t>(2, 0);
    if (type == kTypeInt) field.type = parse_int_type(field_table.read_table(3, "type"));
    else if (type == kTypeFloat) field.type = parse_float_type(field_table.read_table(3, "type"));
    else if (type != kTypeUtf8)
        fail("column '{}' has the Arrow type {}, expected integers, floating point numbers or utf8 text",
             field.name, type);
    if (const std::optional<FlatbufferTable> encoding = field_table.find_table(4)) {
        const std::optional<FlatbufferTable> index = encoding->find_table(1);
        field.dictionary = {
            encoding->read_scalar<std::int64_t>(0, 0),
            // Without an index type, the indices are signed 32-bit integers.
            index ? parse_int_type(*index) : ArrowField::Type{ArrowValueKind::integer, 32, true}};
    }
    return field;
}

ArrowCompression parse_codec(const FlatbufferTable& batch_table) {
    const std::optional<FlatbufferTable> compression = batch_table.find_table(3);
    if (!compression) return ArrowCompression::none;
    const auto codec = compression->read_scalar<std::int8_t>(0, kCodecLz4);
    if (codec != kCodecLz4 && codec != kCodecZstd)
        fail("the data are compressed with codec {}, expected lz4 frames or zstd", codec);
    return codec == kCodecLz4 ? ArrowCompression::lz4_frame : ArrowCompression::zstd;
}

}  // namespace

/// Field numbers: Schema {0 endianness, 1 fields}, Footer {1 schema, 2 dictionaries, 3
/// recordBatches}.
Footer parse_footer(std::string_view footer_bytes) {
    AlignedFlatbuffer copy(footer_bytes);
    const FlatbufferTable footer = FlatbufferTable::root_table(copy), schema = footer.read_table(1, "schema");
    if (schema.read_scalar<std::int16_t>(0, 0) != 0)
        throw DataError("the numbers are big-endian, expected little-endian");
    Footer parsed;
    for (const FlatbufferTable& field : schema.read_tables(1)) parsed.fields.push_back(parse_field(field));
    parsed.dictionaries = footer.read_structs<ArrowFileBlock>(2);
    parsed.batches = footer.read_structs<ArrowFileBlock>(3);
    return parsed;
}

/// Field numbers: Message {1 header_type, 2 header}, DictionaryBatch {0 id, 1 data},
/// RecordBatch {0 length, 1 nodes, 2 buffers}.
RecordBatch parse_batch(std::string_view message_bytes) {
    AlignedFlatbuffer copy(message_bytes);
    const FlatbufferTable message = FlatbufferTable::root_table(copy);
    const auto type = message.read_scalar<std::uint8_t>(1, 0);
    if (type != kHeaderDictionary && type != kHeaderRecords) fail_arrow("kind of message");
    const FlatbufferTable header = message.read_table(2, "header");
    RecordBatch batch;
    if (type == kHeaderDictionary) batch.dictionary = header.read_scalar<std::int64_t>(0, 0);
    const FlatbufferTable records = type == kHeaderDictionary ? header.read_table(1, "dictionary") : header;
    batch.length = records.read_scalar<std::int64_t>(0, 0);
    batch.nodes = records.read_structs<ArrowFieldNode>(1);
    batch.buffers = records.read_structs<ArrowBufferRange>(2);
    batch.codec = parse_codec(records);
    return batch;
}

}  // namespace relidar::codecs
