// SPDX-License-Identifier: Apache-2.0
// Reads the tables of a flatbuffer by field number. A table refers to a vtable. The
// vtable contains two sizes, followed by the offset of each field.
#include "base/codecs/arrow_metadata.hpp"

#include <cstring>

#include <flatbuffers/flatbuffers.h>
#include <fmt/format.h>

#include <relidar/base/error.hpp>

namespace relidar::arrow {
namespace {

// Maximum number of tables in a file. The columns of a dataset need only tens of tables.
constexpr flatbuffers::uoffset_t kMostTables = 10000;
constexpr std::size_t kLongestName = 200;

// Values of the unions and enumerations in Arrow's format.
constexpr std::uint8_t kTypeInt = 2, kTypeFloat = 3, kTypeUtf8 = 5;
constexpr std::uint8_t kHeaderDictionary = 2, kHeaderRecords = 3;
constexpr std::int8_t kCodecLz4 = 0, kCodecZstd = 1;

[[noreturn]] void throw_malformed_arrow_error(const char* description) {
    throw DataError(fmt::format("the metadata are malformed ({}), expected an Arrow IPC file", description));
}

/// Aligned copy of a flatbuffer. The flatbuffer verifier rejects unaligned data.
struct Bytes {
    std::vector<std::uint64_t> words;
    flatbuffers::Verifier verifier;

    explicit Bytes(std::string_view bytes)
        : words(bytes.size() / 8 + 1), verifier(data(), bytes.size(), options()) {
        if (bytes.size() >= FLATBUFFERS_MAX_BUFFER_SIZE) throw_malformed_arrow_error("too long");
        std::memcpy(words.data(), bytes.data(), bytes.size());
    }
    const std::uint8_t* data() const { return reinterpret_cast<const std::uint8_t*>(words.data()); }

private:
    static flatbuffers::Verifier::Options options() {
        flatbuffers::Verifier::Options limits;
        limits.max_tables = kMostTables;
        return limits;
    }
};

/// Table in a flatbuffer. Each field is checked when it is read.
class Table {
public:
    static Table root(Bytes& bytes) {
        const auto offset = bytes.verifier.VerifyOffset(std::size_t(0));
        if (offset == 0) throw_malformed_arrow_error("root");
        return {bytes, bytes.data() + offset};
    }

    template <class T>
    T scalar(int field, T default_value) const {
        if (!table_->VerifyField<T>(bytes_->verifier, entry(field), sizeof(T)))
            throw_malformed_arrow_error("number");
        return table_->GetField<T>(entry(field), default_value);
    }
    std::optional<Table> table(int field) const {
        const std::uint8_t* at = pointer(field);
        return at ? std::optional<Table>(Table(*bytes_, at)) : std::nullopt;
    }
    Table read_required_table(int field, const char* description) const {
        const std::optional<Table> found = table(field);
        if (!found) throw_malformed_arrow_error(description);
        return *found;
    }
    std::string name(int field) const {
        const auto* text = reinterpret_cast<const flatbuffers::String*>(pointer(field));
        if (!text || !bytes_->verifier.VerifyString(text) || text->size() > kLongestName)
            throw_malformed_arrow_error("name");
        return text->str();
    }
    /// Returns the structs of a vector field. A vector consists of its length (4 bytes)
    /// and the structs, which may be unaligned.
    template <class Struct>
    std::vector<Struct> structs(int field) const {
        const std::uint8_t* vector = verify_vector(field, sizeof(Struct));
        std::vector<Struct> values(vector ? flatbuffers::ReadScalar<flatbuffers::uoffset_t>(vector) : 0);
        if (!values.empty())
            std::memcpy(values.data(), vector + sizeof(flatbuffers::uoffset_t),
                        values.size() * sizeof(Struct));
        return values;
    }
    std::vector<Table> tables(int field) const {
        const std::uint8_t* vector = verify_vector(field, sizeof(flatbuffers::uoffset_t));
        std::vector<Table> all;
        const std::size_t n = vector ? flatbuffers::ReadScalar<flatbuffers::uoffset_t>(vector) : 0;
        for (std::size_t i = 0; i < n; ++i) {
            const std::uint8_t* element = vector + (i + 1) * sizeof(flatbuffers::uoffset_t);
            const auto offset = bytes_->verifier.VerifyOffset(std::size_t(element - bytes_->data()));
            if (offset == 0) throw_malformed_arrow_error("table");
            all.push_back(Table(*bytes_, element + offset));
        }
        return all;
    }

private:
    Table(Bytes& bytes, const std::uint8_t* at)
        : bytes_(&bytes), table_(reinterpret_cast<const flatbuffers::Table*>(at)) {
        if (!table_->VerifyTableStart(bytes.verifier)) throw_malformed_arrow_error("table");
        // Ends the verifier's count of nested tables here, because this parser limits the
        // nesting depth itself.
        bytes.verifier.EndTable();
    }

    static flatbuffers::voffset_t entry(int field) { return flatbuffers::voffset_t(4 + 2 * field); }

    const std::uint8_t* pointer(int field) const {
        if (!table_->VerifyOffset(bytes_->verifier, entry(field))) throw_malformed_arrow_error("offset");
        return table_->GetPointer<const std::uint8_t*>(entry(field));
    }
    const std::uint8_t* verify_vector(int field, std::size_t element_bytes) const {
        const std::uint8_t* vector = pointer(field);
        if (vector && !bytes_->verifier.VerifyVectorOrString(vector, element_bytes))
            throw_malformed_arrow_error("vector");
        return vector;
    }

    Bytes* bytes_;
    const flatbuffers::Table* table_;
};

Field::Type parse_integer_type(const Table& table) {
    const auto bits = table.scalar<std::int32_t>(0, 0);
    if (bits != 8 && bits != 16 && bits != 32 && bits != 64) throw_malformed_arrow_error("width of integers");
    return {Kind::integer, bits, table.scalar<std::uint8_t>(1, 0) != 0};
}

Field::Type parse_float_type(const Table& table) {
    const auto precision = table.scalar<std::int16_t>(0, 0);
    if (precision < 0 || precision > 2) throw_malformed_arrow_error("precision");
    return {Kind::floating, 16 << precision, true};
}

Field parse_field(const Table& table) {
    Field field;
    field.name = table.name(0);
    const auto type = table.scalar<std::uint8_t>(2, 0);
    if (type == kTypeInt) field.type = parse_integer_type(table.read_required_table(3, "type"));
    else if (type == kTypeFloat) field.type = parse_float_type(table.read_required_table(3, "type"));
    else if (type != kTypeUtf8)
        throw DataError(fmt::format(
            "column '{}' has the Arrow type {}, expected integers, floating point numbers or utf8 "
            "text",
            field.name, type));
    if (const std::optional<Table> encoding = table.table(4)) {
        const std::optional<Table> index = encoding->table(1);
        field.dictionary = {encoding->scalar<std::int64_t>(0, 0),
                            index ? parse_integer_type(*index) : Field::Type{Kind::integer, 32, true}};
    }
    return field;
}

/// Returns the compression codec of the buffers of a record batch.
Codec parse_codec(const Table& batch) {
    const std::optional<Table> compression = batch.table(3);
    if (!compression) return Codec::none;
    const auto codec = compression->scalar<std::int8_t>(0, kCodecLz4);
    if (codec != kCodecLz4 && codec != kCodecZstd)
        throw DataError(
            fmt::format("the data are compressed with codec {}, expected lz4 frames or zstd", codec));
    return codec == kCodecLz4 ? Codec::lz4_frame : Codec::zstd;
}

}  // namespace

Footer parse_footer(std::string_view bytes) {
    Bytes copy(bytes);
    const Table footer = Table::root(copy), schema = footer.read_required_table(1, "schema");
    if (schema.scalar<std::int16_t>(0, 0) != 0)
        throw DataError("the numbers are big-endian, expected little-endian");
    Footer parsed;
    for (const Table& field : schema.tables(1)) parsed.fields.push_back(parse_field(field));
    parsed.dictionaries = footer.structs<Block>(2);
    parsed.batches = footer.structs<Block>(3);
    return parsed;
}

RecordBatch parse_batch(std::string_view bytes) {
    Bytes copy(bytes);
    const Table message = Table::root(copy);
    const auto type = message.scalar<std::uint8_t>(1, 0);
    if (type != kHeaderDictionary && type != kHeaderRecords) throw_malformed_arrow_error("kind of message");
    const Table header = message.read_required_table(2, "header");
    RecordBatch batch;
    if (type == kHeaderDictionary) batch.dictionary = header.scalar<std::int64_t>(0, 0);
    const Table records = type == kHeaderDictionary ? header.read_required_table(1, "dictionary") : header;
    batch.length = records.scalar<std::int64_t>(0, 0);
    batch.nodes = records.structs<Node>(1);
    batch.buffers = records.structs<Buffer>(2);
    batch.codec = parse_codec(records);
    return batch;
}

}  // namespace relidar::arrow
