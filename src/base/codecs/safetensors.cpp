// SPDX-License-Identifier: Apache-2.0
// Reads and writes safetensors files. A file consists of the header size (u64), a JSON
// header and the data without gaps. The header contains type, shape and byte range of
// each array, and string metadata. The reader checks that the ranges cover the data
// exactly, so it rejects truncated files. The caller must check whether values are
// finite.
#include <relidar/base/files.hpp>

#include <algorithm>
#include <array>
#include <cstring>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"

#include "file_io.hpp"
#include "named_array.hpp"

namespace relidar {
namespace {

using Json = nlohmann::json;
using codecs::array_bytes;
using codecs::element_bytes;

// Bytes. The format allows 100 MB, but a parsed header needs 24 times as much memory.
constexpr std::size_t kMaxHeader = 4u << 20;
constexpr std::size_t kMaxName = 200, kMaxDimensions = 16;
constexpr const char* kMetadataKey = "__metadata__";

constexpr std::array<std::pair<std::string_view, std::string_view>, 12> kTypeNames{{
    {"BOOL", "b1"},
    {"U8", "u1"},
    {"I8", "i1"},
    {"U16", "u2"},
    {"I16", "i2"},
    {"F16", "f2"},
    {"U32", "u4"},
    {"I32", "i4"},
    {"F32", "f4"},
    {"U64", "u8"},
    {"I64", "i8"},
    {"F64", "f8"},
}};

std::string to_safetensors(const std::string& numpy_type) {
    const auto it = std::find_if(kTypeNames.begin(), kTypeNames.end(),
                                 [&](const auto& type) { return type.second == numpy_type; });
    if (it == kTypeNames.end()) fail("the type '{}' is not supported by safetensors", numpy_type);
    return std::string(it->first);
}

std::string to_numpy(const std::string& where, const std::string& safetensors_type) {
    const auto it = std::find_if(kTypeNames.begin(), kTypeNames.end(),
                                 [&](const auto& known) { return known.first == safetensors_type; });
    if (it == kTypeNames.end())
        fail("array '{}' has the type '{}', which is not supported", where, quote(safetensors_type));
    return std::string(it->second);
}

/// Returns the JSON header of a file, which lists the arrays in the order of `arrays`.
std::string make_header(const std::vector<NamedArray>& arrays,
                        const std::map<std::string, std::string>& metadata) {
    nlohmann::ordered_json header = nlohmann::ordered_json::object();
    if (!metadata.empty()) header[kMetadataKey] = metadata;
    std::size_t offset = 0;
    for (const NamedArray& array : arrays) {
        codecs::check_array(array);
        if (array.name == kMetadataKey || header.contains(array.name))
            fail("array name '{}' is reserved or used twice", array.name);
        const std::size_t end = offset + array.bytes.size();
        header[array.name] = {
            {"dtype", to_safetensors(array.dtype)}, {"shape", array.shape}, {"data_offsets", {offset, end}}};
        offset = end;
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
    std::size_t data_start = 0;
};

/// Parses and checks the header. The callback of the JSON parser records the order of the
/// names and detects names that occur twice, which the parsed object cannot show.
SafetensorsHeader parse_header(const std::vector<std::byte>& bytes) {
    SafetensorsHeader header;
    std::uint64_t size = 0;
    if (bytes.size() < sizeof size) fail("the file has {} bytes, expected at least 8 bytes", bytes.size());
    std::memcpy(&size, bytes.data(), sizeof size);
    if (size > kMaxHeader)
        fail("the size of the header is {} bytes, expected at most {} bytes", size, kMaxHeader);
    if (size > bytes.size() - sizeof size)
        fail("the header should have {} bytes, but the file ends after {} bytes of the header", size,
             bytes.size() - sizeof size);
    header.data_start = sizeof size + size;
    const char* text = reinterpret_cast<const char*>(bytes.data()) + sizeof size;
    header.json = Json::parse(
        text, text + size,
        [&](int depth, Json::parse_event_t event, const Json& parsed) {
            if (event == Json::parse_event_t::key && depth == 1)
                header.names.push_back(parsed.get<std::string>());
            return true;
        },
        false);
    if (header.json.is_discarded()) throw DataError("the header of the file is not valid JSON");
    if (!header.json.is_object()) throw DataError("the header of the file is not a JSON object");
    if (header.json.size() != header.names.size())
        throw DataError("the header contains an array twice, expected each array once");
    for (const std::string& name : header.names) {
        if (name.size() > kMaxName)
            fail("the name of array '{}' has {} bytes, expected at most {}", quote(name), name.size(),
                 kMaxName);
    }
    return header;
}

std::vector<std::size_t> parse_integers(const std::string& where, const Json& json, const char* member) {
    if (!json.is_object() || !json.contains(member) || !json[member].is_array())
        fail("array '{}': the header has no list of integers '{}'", where, member);
    if (json[member].size() > kMaxDimensions)
        fail("array '{}': '{}' contains {} numbers, expected at most {}", where, member, json[member].size(),
             kMaxDimensions);
    std::vector<std::size_t> result;
    for (const Json& value : json[member]) {
        if (!value.is_number_unsigned())
            fail("array '{}': '{}' contains a {}, expected integers of at least 0", where, member,
                 value.type_name());
        result.push_back(value.get<std::size_t>());
    }
    return result;
}

struct DataByteRange {
    std::size_t begin = 0, end = 0;
};

/// Parses the header entry of an array. Returns its name, type and shape, and the byte
/// range of its data.
/// @param n_bytes number of data bytes in the file
std::pair<NamedArray, DataByteRange> parse_array(const std::string& name, const Json& json,
                                                 std::size_t n_bytes) {
    if (!json.is_object() || !json.contains("dtype") || !json["dtype"].is_string())
        fail("array '{}': the header has no dtype, expected a data type such as 'F32'", name);
    NamedArray array{
        name, to_numpy(name, json["dtype"].get<std::string>()), parse_integers(name, json, "shape"), {}};
    const std::vector<std::size_t> offsets = parse_integers(name, json, "data_offsets");
    if (offsets.size() != 2 || offsets[0] > offsets[1] || offsets[1] > n_bytes)
        fail("array '{}': data_offsets [{}] are outside the {} bytes of data", name, fmt::join(offsets, ", "),
             n_bytes);
    const auto expected = array_bytes(array.shape, element_bytes(array.dtype));
    if (!expected || *expected != offsets[1] - offsets[0])
        fail("array '{}' has {} bytes, which do not fit its shape", name, offsets[1] - offsets[0]);
    return {std::move(array), DataByteRange{offsets[0], offsets[1]}};
}

std::map<std::string, std::string> parse_metadata(const Json& metadata_json) {
    std::map<std::string, std::string> result;
    if (!metadata_json.is_object()) throw DataError("the header key __metadata__ is not a JSON object");
    for (const auto& [key, value] : metadata_json.items()) {
        if (!value.is_string()) fail("the value of '{}' in __metadata__ is not a text", quote(key));
        result[key] = value.get<std::string>();
    }
    return result;
}

/// Reads all arrays in the order of their data. The ranges must cover the data without
/// gaps.
std::vector<NamedArray> parse_file(const std::vector<std::byte>& bytes,
                                   std::map<std::string, std::string>* metadata) {
    const SafetensorsHeader header = parse_header(bytes);
    const std::size_t n_data = bytes.size() - header.data_start;
    std::vector<std::pair<NamedArray, DataByteRange>> entries;
    std::map<std::string, std::string> file_metadata;
    for (const std::string& name : header.names) {
        const Json& entry = header.json.at(name);
        if (name == kMetadataKey) file_metadata = parse_metadata(entry);
        else entries.push_back(parse_array(name, entry, n_data));
    }
    std::stable_sort(entries.begin(), entries.end(), [](const auto& first, const auto& second) {
        return std::pair(first.second.begin, first.second.end) <
               std::pair(second.second.begin, second.second.end);
    });
    std::size_t covered = 0;
    std::vector<NamedArray> arrays;
    for (auto& [array, range] : entries) {
        if (range.begin != covered)
            fail("array '{}' starts at byte {} of the data, expected byte {}, where the previous array ends",
                 array.name, range.begin, covered);
        const auto data = bytes.begin() + std::ptrdiff_t(header.data_start);
        array.bytes.assign(data + std::ptrdiff_t(range.begin), data + std::ptrdiff_t(range.end));
        covered = range.end;
        arrays.push_back(std::move(array));
    }
    if (covered != n_data)
        fail("the file has {} bytes of data, but its header describes {} bytes", n_data, covered);
    if (metadata) *metadata = std::move(file_metadata);
    return arrays;
}

}  // namespace

void write_safetensors(const std::filesystem::path& path, const std::vector<NamedArray>& arrays,
                       const std::map<std::string, std::string>& metadata) {
    write_atomically(path, [&](const std::filesystem::path& temporary) {
        const std::string header = make_header(arrays, metadata);
        const std::uint64_t size = header.size();
        codecs::OutputFile file(temporary);
        file.write(&size, sizeof size);
        file.write(header);
        for (const NamedArray& array : arrays) file.write(array.bytes.data(), array.bytes.size());
        file.close();
    });
}

std::vector<NamedArray> read_safetensors(const std::filesystem::path& path,
                                         std::map<std::string, std::string>* metadata) {
    const std::vector<std::byte> file = codecs::read_file(path);
    try {
        return parse_file(file, metadata);
    } catch (const std::exception& error) {
        fail("cannot read safetensors '{}': {}", path.string(), error.what());
    }
}

}  // namespace relidar
