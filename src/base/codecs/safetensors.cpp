// SPDX-License-Identifier: Apache-2.0
// Reads and writes safetensors files. A file consists of the header size (u64), a JSON
// header and the data without gaps. The header contains type, shape and byte range of
// each array, and string metadata. The reader checks that the ranges cover the data
// exactly, so it rejects truncated files. The caller must check whether values are
// finite.
#include <relidar/base/files.hpp>

#include <algorithm>
#include <iterator>
#include <span>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/json_field.hpp"
#include "file_io.hpp"
#include "named_array.hpp"

namespace relidar {
namespace {

using Json = nlohmann::json;

// Bytes. The format allows 100 MB, but a parsed header needs 24 times as much memory.
constexpr std::size_t kMaxHeader = 4u << 20;
constexpr const char* kMetadataKey = "__metadata__";

struct TypeName {
    std::string_view safetensors, numpy;
};
constexpr TypeName kTypeNames[] = {{"BOOL", "b1"}, {"U8", "u1"},  {"I8", "i1"},  {"U16", "u2"},
                                   {"I16", "i2"},  {"F16", "f2"}, {"U32", "u4"}, {"I32", "i4"},
                                   {"F32", "f4"},  {"U64", "u8"}, {"I64", "i8"}, {"F64", "f8"}};

/// @param from  the member of TypeName that contains `type`
const TypeName& find_type(const std::string& type, std::string_view TypeName::*from) {
    const auto* row = std::ranges::find(kTypeNames, type, from);
    if (row == std::end(kTypeNames)) fail("the type '{}' is not supported by safetensors", quote(type));
    return *row;
}

/// Returns the JSON header of a file. It has the type, shape and byte range of each
/// array; the data of the arrays follow in the same order.
std::string make_header(const std::vector<NamedArray>& arrays,
                        const std::map<std::string, std::string>& metadata) {
    nlohmann::ordered_json header = nlohmann::ordered_json::object();
    if (!metadata.empty()) header[kMetadataKey] = metadata;
    std::size_t offset = 0;
    for (const NamedArray& array : arrays) {
        codecs::check_array(array);
        if (array.name == kMetadataKey || header.contains(array.name))
            fail("array name '{}' is reserved or used twice", array.name);
        const std::size_t end_offset = offset + array.bytes.size();
        header[array.name] = {{"dtype", find_type(array.dtype, &TypeName::numpy).safetensors},
                              {"shape", array.shape},
                              {"data_offsets", {offset, end_offset}}};
        offset = end_offset;
    }
    std::string text = header.dump();
    // Pads the header, so that the data starts at a multiple of 8 bytes.
    text.resize((text.size() + 7) / 8 * 8, ' ');
    if (text.size() > kMaxHeader)
        fail("the header would exceed its limit of 4 MiB; write fewer arrays, or shorter names");
    return text;
}

/// `names` has the order of the header. Sorting by data position could not restore it,
/// because empty arrays have the same position as their successor.
struct SafetensorsHeader {
    Json json;
    std::vector<std::string> names;
    std::string_view data;  ///< bytes after the header
};

/// Parses the header: its size (8 bytes) and a JSON object with one entry for each array.
/// The callback of the JSON parser records the order of the names and detects names that
/// occur twice, which the parsed object cannot show.
SafetensorsHeader parse_header(std::string_view bytes) {
    SafetensorsHeader header;
    codecs::ByteReader reader(bytes);
    const auto size = reader.read_number<std::uint64_t>();
    if (size > kMaxHeader)
        fail("the size of the header is {} bytes, expected at most {} bytes", size, kMaxHeader);
    const auto record_name = [&](int depth, Json::parse_event_t event, const Json& parsed) {
        const bool is_array_name = event == Json::parse_event_t::key && depth == 1;
        if (is_array_name) header.names.push_back(parsed.get<std::string>());
        return true;  // Keeps the value.
    };
    constexpr bool kThrowErrors = false;
    header.json = Json::parse(reader.read_bytes(size), record_name, kThrowErrors);
    header.data = reader.read_rest();
    if (!header.json.is_object()) fail("the header of the file is not valid JSON, expected a JSON object");
    if (header.json.size() != header.names.size())
        fail("the header contains an array twice, expected each array once");
    return header;
}

struct ArrayEntry {
    NamedArray array;
    std::size_t begin, end;  ///< position of the values in the data
};

/// Parses the header entry of an array: its type, its shape, and where its values begin
/// and end in the data. Does not read the values.
/// @param n_data_bytes number of data bytes in the file
ArrayEntry parse_array(const std::string& name, const Json& json, std::size_t n_data_bytes) {
    const std::string where = fmt::format("array '{}'", quote(name));
    const JsonField entry(json, where, "");
    const std::vector<std::size_t> offsets = entry.at("data_offsets").sizes();
    if (offsets.size() != 2 || offsets[0] > offsets[1] || offsets[1] > n_data_bytes)
        fail("{}: data_offsets [{}] are outside the {} bytes of data", where, fmt::join(offsets, ", "),
             n_data_bytes);
    const std::size_t begin = offsets[0], end = offsets[1];
    const std::string_view type = find_type(entry.at("dtype").text(), &TypeName::safetensors).numpy;
    NamedArray array{name, std::string(type), entry.at("shape").sizes(), {}};
    if (codecs::array_bytes(array.shape, codecs::element_bytes(type)) != end - begin)
        fail("{} has {} bytes, which do not fit its shape", where, end - begin);
    return {std::move(array), begin, end};
}

std::map<std::string, std::string> parse_metadata(const Json& metadata_json) {
    const std::string where = kMetadataKey;
    std::map<std::string, std::string> result;
    for (const auto& [key, value] : metadata_json.items())
        result[key] = JsonField(value, where, quote(key)).text();
    return result;
}

/// Reads all arrays in the order of their data. The ranges must cover the data without
/// gaps, because then a truncated or exchanged file is detected.
std::vector<NamedArray> parse_file(std::string_view bytes, std::map<std::string, std::string>* metadata) {
    const SafetensorsHeader header = parse_header(bytes);
    std::vector<ArrayEntry> entries;
    std::map<std::string, std::string> file_metadata;
    for (const std::string& name : header.names) {
        const Json& entry = header.json.at(name);
        if (name == kMetadataKey) file_metadata = parse_metadata(entry);
        else entries.push_back(parse_array(name, entry, header.data.size()));
    }
    std::ranges::stable_sort(entries, {},
                             [](const ArrayEntry& entry) { return std::pair(entry.begin, entry.end); });
    std::size_t previous_end = 0;
    std::vector<NamedArray> arrays;
    for (auto& [array, begin, end] : entries) {
        if (begin != previous_end)
            fail("array '{}' starts at byte {} of the data, expected byte {}, where the previous array ends",
                 quote(array.name), begin, previous_end);
        const auto values = std::as_bytes(std::span(header.data.substr(begin, end - begin)));
        array.bytes.assign(values.begin(), values.end());
        previous_end = end;
        arrays.push_back(std::move(array));
    }
    if (previous_end != header.data.size())
        fail("the file has {} bytes of data, but its header describes {} bytes", header.data.size(),
             previous_end);
    if (metadata) *metadata = std::move(file_metadata);
    return arrays;
}

}  // namespace

void write_safetensors(const std::filesystem::path& path, const std::vector<NamedArray>& arrays,
                       const std::map<std::string, std::string>& metadata) {
    write_atomically(path, [&](const std::filesystem::path& temporary) {
        const std::string header = make_header(arrays, metadata);
        const std::uint64_t header_bytes = header.size();
        codecs::OutputFile file(temporary);
        file.write(&header_bytes, sizeof header_bytes);
        file.write(header);
        for (const NamedArray& array : arrays) file.write(array.bytes.data(), array.bytes.size());
        file.close();
    });
}

std::vector<NamedArray> read_safetensors(const std::filesystem::path& path,
                                         std::map<std::string, std::string>* metadata) {
    const std::string file = read_file(path);
    try {
        return parse_file(file, metadata);
    } catch (const std::exception& error) {
        fail("cannot read safetensors '{}': {}", path.string(), error.what());
    }
}

}  // namespace relidar
