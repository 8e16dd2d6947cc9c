// SPDX-License-Identifier: Apache-2.0
// An .itar archive is a tar archive. A compressed index of its members follows the tar
// archive, and the last 512 bytes say where this index is. The reader lists the members
// from their tar headers instead, and uses the last bytes only to detect a cut file.
#include "base/codecs/zarr.hpp"

#include <algorithm>
#include <charconv>
#include <fstream>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/codecs/blosc.hpp"
#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kTarBlock = 512;
constexpr std::string_view kIndexMagic = "itar";
constexpr std::uint64_t kMaxPathBytes = 1 << 16;  // limit of a name in an extended tar header

std::string read_bytes(std::ifstream& in, std::uint64_t at, std::uint64_t n_bytes) {
    std::string bytes(n_bytes, '\0');
    in.seekg(std::streamoff(at));
    in.read(bytes.data(), std::streamsize(n_bytes));
    return in ? bytes : std::string();
}

std::string_view until_zero(std::string_view text) { return text.substr(0, text.find('\0')); }

/// Parses a number of a tar header: octal digits after blanks.
std::optional<std::uint64_t> parse_octal(std::string_view text) {
    text = trim(until_zero(text));
    std::uint64_t value = 0;
    const auto [end, failed] = std::from_chars(text.data(), text.data() + text.size(), value, 8);
    if (failed != std::errc() || end != text.data() + text.size()) return std::nullopt;
    return value;
}

/// Checks the sum of all bytes of a tar header, in which the checksum itself counts as
/// blanks.
bool is_tar_header(std::string_view header) {
    std::uint64_t sum = 0;
    for (std::size_t i = 0; i < header.size(); ++i)
        sum += i >= 148 && i < 156 ? std::uint64_t(' ') : std::uint64_t(std::uint8_t(header[i]));
    return parse_octal(header.substr(148, 8)) == sum;
}

/// Returns the value of "path" in an extended header, which has lines "LENGTH KEY=VALUE".
std::string extended_path(const std::string& records) {
    const std::size_t key = records.find(" path=");
    if (key == std::string::npos) return "";
    const std::size_t begin = key + 6;
    return records.substr(begin, records.find('\n', begin) - begin);
}

std::size_t size_product(const std::vector<std::size_t>& shape, const std::string& where) {
    std::size_t product = 1;
    for (const std::size_t n : shape) {
        if (n > 0 && product > (std::size_t(1) << 36) / n) fail("{}: the shape is too large", where);
        product *= n;
    }
    return product;
}

std::vector<std::size_t> read_shape(const JsonField& field) {
    std::vector<std::size_t> shape;
    for (std::size_t i = 0; i < field.size(); ++i)
        shape.push_back(std::size_t(field.at(i).integer_in(0, std::int64_t(1) << 32)));
    return shape;
}

/// Copies a chunk to its place in the array, line by line. A line is the last dimension.
void copy_chunk(const std::string& chunk, const std::vector<std::size_t>& chunk_shape,
                const std::vector<std::size_t>& chunk_index, const std::vector<std::size_t>& shape,
                std::size_t element_bytes, std::string& bytes) {
    const std::size_t n_dims = shape.size(), last = n_dims - 1;
    const std::size_t first_column = chunk_index[last] * chunk_shape[last],
                      n_columns = std::min(chunk_shape[last], shape[last] - first_column);
    const std::size_t n_lines = chunk.size() / element_bytes / chunk_shape[last];
    for (std::size_t line = 0; line < n_lines; ++line) {
        std::size_t rest = line, at = 0, stride = shape[last];
        bool is_inside = true;
        for (std::size_t d = last; d-- > 0;) {
            const std::size_t i = chunk_index[d] * chunk_shape[d] + rest % chunk_shape[d];
            rest /= chunk_shape[d];
            is_inside = is_inside && i < shape[d];
            at += i * stride;
            stride *= shape[d];
        }
        if (!is_inside) continue;
        const std::size_t begin = (at + first_column) * element_bytes;
        // Grows with the chunks, so that a damaged shape does not use much memory.
        bytes.resize(std::max(bytes.size(), begin + n_columns * element_bytes));
        chunk.copy(bytes.data() + begin, n_columns * element_bytes, line * chunk_shape[last] * element_bytes);
    }
}

}  // namespace

ZarrStore::ZarrStore(fs::path path) : path_(std::move(path)) {
    if (!does_path_exist(path_)) fail("{}: no such file or folder", name());
    is_archive_ = !fs::is_directory(path_);
    if (is_archive_) list_members();
}

void ZarrStore::list_members() {
    std::ifstream in(path_, std::ios::binary | std::ios::ate);
    const std::streamoff end = in ? std::streamoff(in.tellg()) : -1;
    if (end < 0) fail("cannot read {}", name());
    const auto size = std::uint64_t(end);
    const std::string tail = size < kTarBlock ? "" : read_bytes(in, size - kTarBlock, kTarBlock);
    if (!tail.starts_with(kIndexMagic))
        fail("{} ({} bytes) is truncated or no archive of NCore: its last block is not that of an index",
             name(), size);
    codecs::ByteReader index(std::string_view(tail).substr(kIndexMagic.size()));
    index.read_number<std::uint32_t>();  // kind of the index
    const auto tar_end = index.read_number<std::uint64_t>();
    std::string long_name;
    for (std::uint64_t at = 0; at + kTarBlock <= std::min(tar_end, size);) {
        const std::string header = read_bytes(in, at, kTarBlock);
        if (header.find_first_not_of('\0') == std::string::npos) break;
        const std::string_view view = header;
        const auto n_bytes = header.size() == kTarBlock ? parse_octal(view.substr(124, 12)) : std::nullopt;
        if (!n_bytes || !is_tar_header(view)) fail("{}: the tar header at byte {} is damaged", name(), at);
        at += kTarBlock;
        if (*n_bytes > size - at)
            fail("{}: the member at byte {} has {} bytes, found {}", name(), at, *n_bytes, size - at);
        const char kind = header[156];
        if (kind == 'x' || kind == 'L') {  // name of the next member
            const std::string text = read_bytes(in, at, std::min(*n_bytes, kMaxPathBytes));
            long_name = kind == 'x' ? extended_path(text) : std::string(until_zero(text));
        } else {
            std::string key = std::exchange(long_name, "");
            if (key.empty()) {
                const std::string_view folder = until_zero(view.substr(345, 155));
                key = std::string(folder) + (folder.empty() ? "" : "/") +
                      std::string(until_zero(view.substr(0, 100)));
            }
            members_[key] = {at, *n_bytes};
        }
        at += (*n_bytes + kTarBlock - 1) / kTarBlock * kTarBlock;
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

std::vector<std::string> ZarrStore::list_keys() const {
    std::vector<std::string> keys;
    for (const auto& [key, range] : members_) keys.push_back(key);
    return keys;
}

std::vector<std::string> ZarrStore::list_children(const std::string& group) const {
    std::vector<std::string> names;
    if (!is_archive_) {
        if (!does_path_exist(path_ / group)) return names;
        for (const fs::path& entry : list_folder(path_ / group))
            if (fs::is_directory(entry)) names.push_back(entry.filename().string());
        std::ranges::sort(names);
        return names;
    }
    const std::string prefix = group.empty() ? "" : group + "/";
    for (auto member = members_.lower_bound(prefix);
         member != members_.end() && member->first.starts_with(prefix); ++member) {
        const std::size_t slash = member->first.find('/', prefix.size());
        if (slash == std::string::npos) continue;
        std::string child = member->first.substr(prefix.size(), slash - prefix.size());
        if (std::ranges::find(names, child) == names.end()) names.push_back(std::move(child));
    }
    std::ranges::sort(names);
    return names;
}

ZarrJson read_zarr_attributes(const ZarrStore& store, const std::string& path) {
    const std::string key = path + (path.empty() ? "" : "/") + ".zattrs";
    ZarrJson attributes{fmt::format("{}: {}", store.name(), key), nlohmann::json::object()};
    if (store.has_key(key)) attributes.json = parse_json(store.read_value(key), attributes.where);
    return attributes;
}

std::string read_zarr_bytes(const ZarrStore& store, const std::string& path, const std::string& type,
                            const std::vector<std::size_t>& shape) {
    const std::string where = fmt::format("{}: {}", store.name(), path);
    const nlohmann::json json = parse_json(store.read_value(path + "/.zarray"), where);
    const JsonField head(json, where, "");
    if (head.at("zarr_format").integer_in(0, 99) != 2) fail("{}: expected version 2 of zarr", where);
    if (const std::string found = head.at("dtype").short_text(99); found != type)
        fail("{}: the type is '{}', expected '{}'", where, quote(found), type);
    if (const auto found = read_shape(head.at("shape")); found != shape)
        fail("{}: the shape is {}, expected {}", where, found, shape);
    if (head.at("order").short_text(9) != "C" || !json.value("filters", nlohmann::json()).is_null())
        fail("{}: expected the order C and no filters", where);
    const bool is_compressed = !json.value("compressor", nlohmann::json()).is_null();
    if (is_compressed && head.at("compressor").at("id").short_text(99) != "blosc")
        fail("{}: the codec is '{}', expected blosc", where,
             quote(head.at("compressor").at("id").short_text(99)));
    const std::vector<std::size_t> chunk_shape = read_shape(head.at("chunks"));
    const std::string separator =
        head.has_member("dimension_separator") ? head.at("dimension_separator").short_text(1) : ".";
    const std::size_t element_bytes = std::size_t(type.back() - '0');
    const std::size_t n_bytes = size_product(shape, where) * element_bytes;
    if (chunk_shape.size() != shape.size() || shape.empty() ||
        (n_bytes > 0 && std::ranges::find(chunk_shape, 0u) != chunk_shape.end()))
        fail("{}: the shape of a chunk is {}, expected {} numbers above 0", where, chunk_shape, shape.size());
    std::string bytes;
    std::vector<std::size_t> index(shape.size(), 0);
    while (n_bytes > 0) {
        const std::string chunk_name = fmt::format("{}/{}", path, fmt::join(index, separator));
        std::string chunk = store.read_value(chunk_name);
        try {
            if (is_compressed) chunk = decompress_blosc(chunk);
        } catch (const DataError& error) {
            fail("{}: {}: {}", store.name(), chunk_name, error.what());
        }
        if (chunk.size() != size_product(chunk_shape, where) * element_bytes)
            fail("{}: {}: the chunk has {} bytes, expected {}", store.name(), chunk_name, chunk.size(),
                 size_product(chunk_shape, where) * element_bytes);
        copy_chunk(chunk, chunk_shape, index, shape, element_bytes, bytes);
        std::size_t d = shape.size();
        while (d-- > 0) {
            if (++index[d] * chunk_shape[d] < shape[d]) break;
            index[d] = 0;
            if (d == 0) return bytes;
        }
    }
    return bytes;
}

}  // namespace relidar
