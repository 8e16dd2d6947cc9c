// SPDX-License-Identifier: Apache-2.0
// An .itar archive is a tar archive. A compressed index of its members follows the tar
// archive, and the last 512 bytes say where this index is. The reader lists the members
// from their tar headers instead, and uses the last bytes only to detect a cut file.
#include "base/codecs/zarr.hpp"

#include <algorithm>
#include <fstream>
#include <optional>
#include <set>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/codecs/byte_reader.hpp"
#include "base/codecs/unpack.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/number_text.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

// A tar archive consists of blocks: the header of a member, then its content.
constexpr std::uint64_t kTarBlock = 512;
constexpr std::string_view kIndexMagic = "itar";
constexpr std::uint64_t kMaxPathBytes = 1 << 16;  // limit of a name in an extended tar header

std::string read_bytes(std::ifstream& in, std::uint64_t at, std::uint64_t n_bytes) {
    std::string bytes(n_bytes, '\0');
    in.seekg(std::streamoff(at));
    in.read(bytes.data(), std::streamsize(n_bytes));
    return in ? bytes : std::string();
}

/// Returns the text of a field of a tar header, which zeros fill up.
std::string_view until_zero(std::string_view field) { return field.substr(0, field.find('\0')); }

/// Parses a number of a tar header: octal digits, with blanks around them.
std::optional<std::uint64_t> parse_octal(std::string_view text) {
    return parse_integer<std::uint64_t>(trim(until_zero(text)), 8);
}

/// Returns the value of "path" in an extended header, which has lines "LENGTH KEY=VALUE".
std::string extended_path(const std::string& records) {
    const std::size_t key = records.find(" path=");
    if (key == std::string::npos) return "";
    const std::size_t begin = key + 6;
    return records.substr(begin, records.find('\n', begin) - begin);
}

struct TarHeader {
    std::string name;
    bool is_extended = false;              ///< describes the next member, for example its long name
    std::optional<std::uint64_t> n_bytes;  ///< size of the content; nullopt if the header is damaged
};

/// Parses the header of a member, in the format ustar (POSIX.1-1988).
TarHeader parse_tar_header(std::string_view header) {
    TarHeader member;
    member.name = until_zero(header.substr(0, 100));
    member.is_extended = header[156] == 'x';
    if (header.substr(257, 5) == "ustar") member.n_bytes = parse_octal(header.substr(124, 12));
    return member;
}

/// Returns where the tar archive ends and the index begins. The last block of the file
/// contains "itar", the kind of the index, and this position.
std::uint64_t find_tar_end(std::ifstream& in, std::uint64_t file_bytes, const std::string& file_name) {
    const std::string last_block =
        file_bytes < kTarBlock ? "" : read_bytes(in, file_bytes - kTarBlock, kTarBlock);
    if (!last_block.starts_with(kIndexMagic))
        fail("{} ({} bytes) is truncated or no archive of NCore: its last block is not that of an index",
             file_name, file_bytes);
    codecs::ByteReader reader(std::string_view(last_block).substr(kIndexMagic.size()));
    reader.read_number<std::uint32_t>();  // kind of the index
    return std::min(reader.read_number<std::uint64_t>(), file_bytes);
}

}  // namespace

ZarrStore::ZarrStore(fs::path path) : path_(std::move(path)) {
    if (!does_path_exist(path_)) fail("{}: no such file or folder", name());
    is_archive_ = !fs::is_directory(path_);
    if (is_archive_) list_members();
    if (has_key("zarr.json") && !has_key(".zgroup"))
        fail("{}: found a store of zarr 3 (zarr.json), expected zarr 2 (.zgroup and .zattrs)", name());
}

/// Lists the names and positions of all members of the archive from their tar headers.
void ZarrStore::list_members() {
    std::ifstream in(path_, std::ios::binary | std::ios::ate);
    const std::streamoff end = in ? std::streamoff(in.tellg()) : -1;
    if (end < 0) fail("cannot read {}", name());
    const auto file_bytes = std::uint64_t(end);
    const std::uint64_t tar_end = find_tar_end(in, file_bytes, name());

    // A name of more than 100 characters is in an extended header before the member.
    std::string long_name;
    for (std::uint64_t position = 0; position + kTarBlock <= tar_end;) {
        const std::string header = read_bytes(in, position, kTarBlock);
        // Zero blocks end a tar archive.
        if (header.find_first_not_of('\0') == std::string::npos) break;
        const TarHeader member = parse_tar_header(header);
        position += kTarBlock;
        if (!member.n_bytes || *member.n_bytes > file_bytes - position)
            fail("{}: the tar header at byte {} is damaged", name(), position - kTarBlock);
        if (member.is_extended) {
            long_name = extended_path(read_bytes(in, position, std::min(*member.n_bytes, kMaxPathBytes)));
        } else {
            const std::string key = long_name.empty() ? member.name : long_name;
            members_[key] = {.begin = position, .size = *member.n_bytes};
            long_name.clear();
        }
        position += (*member.n_bytes + kTarBlock - 1) / kTarBlock * kTarBlock;
    }
}

bool ZarrStore::has_key(const std::string& key) const {
    return is_archive_ ? members_.contains(key) : does_path_exist(path_ / key);
}

std::string ZarrStore::read_value(const std::string& key) const {
    if (!has_key(key)) fail("{}: '{}' is missing", name(), quote(key));
    if (!is_archive_) return read_file(path_ / key);
    const ByteRange& range = members_.at(key);
    std::ifstream in(path_, std::ios::binary);
    std::string bytes = read_bytes(in, range.begin, range.size);
    if (bytes.size() != range.size) fail("cannot read {}: '{}'", name(), quote(key));
    return bytes;
}

std::vector<std::string> ZarrStore::list_children(const std::string& group) const {
    std::set<std::string> names;
    if (!is_archive_ && does_path_exist(path_ / group)) {
        for (const fs::path& entry : list_folder(path_ / group))
            if (fs::is_directory(entry)) names.insert(entry.filename().string());
    }
    // In an archive, each key is the path of a file. Keys are sorted, so those with the
    // same prefix follow each other.
    const std::string prefix = group.empty() ? "" : group + "/";
    for (auto member = members_.lower_bound(prefix); member != members_.end(); ++member) {
        const std::string& key = member->first;
        if (!key.starts_with(prefix)) break;
        const std::size_t slash = key.find('/', prefix.size());
        if (slash != std::string::npos) names.insert(key.substr(prefix.size(), slash - prefix.size()));
    }
    return {names.begin(), names.end()};
}

ZarrJson read_zarr_attributes(const ZarrStore& store, const std::string& path) {
    const std::string key = path + (path.empty() ? "" : "/") + ".zattrs";
    ZarrJson attributes{fmt::format("{}: {}", store.name(), key), nlohmann::json::object()};
    if (store.has_key(key)) attributes.json = parse_json(store.read_value(key), attributes.where);
    return attributes;
}

namespace {

struct ZarrChunks {
    std::size_t n_lines = 0;  ///< entries of the first dimension in a chunk
    bool is_compressed = false;
};

/// Checks the description of an array, and returns how its values are divided.
/// @param where  file and array, for messages
ZarrChunks parse_zarr_array(const nlohmann::json& json, const std::string& where, const std::string& type,
                            const std::vector<std::size_t>& shape) {
    const JsonField head(json, where, "");
    if (head.at("zarr_format").integer_in(0, 99) != 2) fail("{}: expected version 2 of zarr", where);
    if (const std::string found = head.at("dtype").short_text(99); found != type)
        fail("{}: the type is '{}', expected '{}'", where, quote(found), type);
    if (const auto found = head.at("shape").sizes(); found != shape)
        fail("{}: the shape is {}, expected {}", where, found, shape);
    if (head.at("order").short_text(9) != "C" || !json.value("filters", nlohmann::json()).is_null())
        fail("{}: expected the order C and no filters", where);
    const bool is_compressed = !json.value("compressor", nlohmann::json()).is_null();
    if (is_compressed && head.at("compressor").at("id").short_text(99) != "blosc")
        fail("{}: the codec is '{}', expected blosc", where,
             quote(head.at("compressor").at("id").short_text(99)));
    const std::vector<std::size_t> chunk_shape = head.at("chunks").sizes();
    if (chunk_shape.size() != shape.size() || shape.empty() || (shape[0] > 0 && chunk_shape[0] == 0) ||
        !std::equal(shape.begin() + 1, shape.end(), chunk_shape.begin() + 1))
        fail("{}: the shape of a chunk is {}, expected {} except for the first number", where, chunk_shape,
             shape);
    return {chunk_shape[0], is_compressed};
}

}  // namespace

std::string read_zarr_bytes(const ZarrStore& store, const std::string& path, const std::string& type,
                            const std::vector<std::size_t>& shape) {
    const std::string where = fmt::format("{}: {}", store.name(), path);
    const nlohmann::json json = parse_json(store.read_value(path + "/.zarray"), where);
    const ZarrChunks chunks = parse_zarr_array(json, where, type, shape);
    // Bytes of an entry of the first dimension. The type ends with the bytes of a number.
    std::size_t line_bytes = std::size_t(type.back() - '0');
    for (std::size_t d = 1; d < shape.size(); ++d) line_bytes *= shape[d];

    std::string bytes;
    for (std::size_t line = 0; line < shape[0]; line += chunks.n_lines) {
        // A chunk is named by its index in each dimension, for example "3.0.0".
        std::string name = fmt::format("{}/{}", path, line / chunks.n_lines);
        for (std::size_t d = 1; d < shape.size(); ++d) name += ".0";
        std::string chunk = store.read_value(name);
        try {
            if (chunks.is_compressed) chunk = decompress_blosc(chunk);
        } catch (const DataError& error) {
            fail("{}: {}: {}", store.name(), name, error.what());
        }
        if (chunk.size() != chunks.n_lines * line_bytes)
            fail("{}: {}: the chunk has {} bytes, expected {}", store.name(), name, chunk.size(),
                 chunks.n_lines * line_bytes);
        // The last chunk can be longer than the array.
        bytes.append(chunk, 0, std::min(chunks.n_lines, shape[0] - line) * line_bytes);
    }
    return bytes;
}

}  // namespace relidar
