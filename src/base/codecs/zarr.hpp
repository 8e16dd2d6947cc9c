// SPDX-License-Identifier: Apache-2.0
// Reads hierarchies of zarr version 2: folders, and the indexed tar archives (.itar) of
// NVIDIA's NCore.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <type_traits>
#include <vector>

#include <nlohmann/json.hpp>

#include "base/json_field.hpp"

namespace relidar {

/// The keys and values of a hierarchy. A key is a path such as "group/array/.zarray".
/// Several threads can read at the same time.
class ZarrStore {
public:
    /// Opens a folder, or an archive, whose members it lists.
    /// @throws DataError if the store has version 3 of zarr, or if the archive is damaged
    explicit ZarrStore(std::filesystem::path path);

    std::string name() const { return path_.string(); }
    bool has_key(const std::string& key) const;
    /// @throws DataError if the key is missing
    std::string read_value(const std::string& key) const;
    /// Returns the names of the groups and arrays in a group, sorted. "": the root
    std::vector<std::string> list_children(const std::string& group) const;

private:
    struct ByteRange {
        std::uint64_t begin = 0, size = 0;
    };
    std::filesystem::path path_;
    bool is_archive_ = false;
    std::map<std::string, ByteRange> members_;  ///< empty for a folder

    void list_members();
};

/// A JSON value of a store, with its place for error messages.
struct ZarrJson {
    std::string where;
    nlohmann::json json;

    JsonField root() const { return JsonField(json, where, ""); }
};
/// Reads the attributes of a group or array. Returns an empty object if it has none.
ZarrJson read_zarr_attributes(const ZarrStore& store, const std::string& path);

/// Reads an array, whose chunks may divide only its first dimension.
/// @param type  type of the elements as numpy names it, for example "<f4"
/// @param shape  expected shape
/// @throws DataError if type, shape or compression differ, or if a chunk is missing
std::string read_zarr_bytes(const ZarrStore& store, const std::string& path, const std::string& type,
                            const std::vector<std::size_t>& shape);

/// Reads an array of numbers. See read_zarr_bytes().
template <class T>
std::vector<T> read_zarr_array(const ZarrStore& store, const std::string& path,
                               const std::vector<std::size_t>& shape) {
    const char* kind = std::is_floating_point_v<T> ? "f" : "u";
    const std::string type = (sizeof(T) == 1 ? "|" : "<") + (kind + std::to_string(sizeof(T)));
    const std::string bytes = read_zarr_bytes(store, path, type, shape);
    std::vector<T> values(bytes.size() / sizeof(T));
    bytes.copy(reinterpret_cast<char*>(values.data()), bytes.size());
    return values;
}

}  // namespace relidar
