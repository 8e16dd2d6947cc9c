// SPDX-License-Identifier: Apache-2.0
// Reads and writes a checkpoint as a safetensors file. A checksum over all arrays and
// texts detects damaged files.
#include <relidar/run/checkpoint.hpp>

#include <algorithm>

#include <fmt/ranges.h>
#include <zlib.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/number_text.hpp"

namespace relidar {
namespace {

using Texts = std::map<std::string, std::string>;

constexpr const char* kCheckpointFormat = "relidar checkpoint";
constexpr const char* kCheckpointVersion = "1";
constexpr const char* kChecksumKey = "crc32";

/// Returns the CRC-32 of all metadata, except the checksum, and arrays in hexadecimal.
std::string checksum(const Texts& metadata, const std::vector<NamedArray>& arrays) {
    uLong crc = ::crc32_z(0, nullptr, 0);
    const auto add_bytes = [&](const void* bytes, std::size_t n_bytes) {
        // zlib restarts the checksum if the pointer is null
        if (n_bytes > 0) crc = ::crc32_z(crc, static_cast<const Bytef*>(bytes), n_bytes);
    };
    // With the terminating zero, "ab","c" and "a","bc" have different checksums.
    const auto add_text = [&](const std::string& text) { add_bytes(text.c_str(), text.size() + 1); };
    for (const auto& [key, value] : metadata) {
        if (key == kChecksumKey) continue;
        add_text(key);
        add_text(value);
    }
    for (const NamedArray& array : arrays) {
        add_text(array.name);
        add_text(array.dtype);
        add_text(fmt::format("{}", fmt::join(array.shape, ",")));
        add_bytes(array.bytes.data(), array.bytes.size());
    }
    return fmt::format("{:08x}", crc);
}

/// Removes an entry from the metadata and returns its value. Used for entries of the file
/// format, which callers must not see.
std::string pop_value(Texts& metadata, const std::string& key) {
    const auto it = metadata.find(key);
    if (it == metadata.end())
        fail("the metadata key \"{}\" is missing, expected a checkpoint of relidar", key);
    std::string value = std::move(it->second);
    metadata.erase(it);
    return value;
}

void check_equal(const std::string& what, const std::string& found, const std::string& expected) {
    if (found != expected) fail("{}: found \"{}\", expected \"{}\"", what, quote(found), expected);
}

/// Parses an integer of at least 0. Returns nothing for other texts.
std::optional<int> parse_iteration(std::string_view text) {
    const std::optional<int> iteration = parse_integer<int>(text);
    return iteration >= 0 ? iteration : std::nullopt;
}

/// Checks format, version and checksum of a file, and that all numbers are finite.
Checkpoint parse_checkpoint(Texts metadata, std::vector<NamedArray> arrays) {
    check_equal("metadata format", metadata["format"], kCheckpointFormat);
    // First the version, because other versions may have another checksum.
    check_equal("metadata version", metadata["version"], kCheckpointVersion);
    const std::string computed_checksum = checksum(metadata, arrays);
    check_equal("checksum of the metadata and arrays", computed_checksum, pop_value(metadata, kChecksumKey));
    for (const char* key : {"format", "version", "relidar"}) pop_value(metadata, key);
    const std::string text = pop_value(metadata, "iteration");
    const std::optional<int> iteration = parse_iteration(text);
    if (!iteration)
        fail("the metadata key \"iteration\" is \"{}\", expected an integer of at least 0", quote(text));
    Checkpoint checkpoint{*iteration, std::move(metadata), std::move(arrays)};
    check_finite_arrays(checkpoint);
    return checkpoint;
}

/// Returns the iteration in the name of a checkpoint file; nothing for other files.
std::optional<int> iteration_of_file(const std::filesystem::path& path) {
    const std::string name = path.stem().string(), start = "iteration_";
    if (path.extension() != ".safetensors" || !name.starts_with(start)) return std::nullopt;
    return parse_iteration(name.substr(start.size()));
}

}  // namespace

void write_checkpoint(const std::filesystem::path& path, const Checkpoint& checkpoint) {
    Texts texts = checkpoint.texts;
    texts["format"] = kCheckpointFormat;
    texts["version"] = kCheckpointVersion;
    texts["relidar"] = RELIDAR_VERSION;
    texts["iteration"] = fmt::format("{}", checkpoint.iteration);
    texts[kChecksumKey] = checksum(texts, checkpoint.arrays);
    write_safetensors(path, checkpoint.arrays, texts);
}

Checkpoint read_checkpoint(const std::filesystem::path& path) {
    Texts texts;
    std::vector<NamedArray> arrays = read_safetensors(path, &texts);
    try {
        return parse_checkpoint(std::move(texts), std::move(arrays));
    } catch (const DataError& error) {
        fail("cannot read checkpoint '{}': {}", path.string(), error.what());
    }
}

std::vector<std::filesystem::path> list_checkpoints(const std::filesystem::path& folder) {
    std::vector<std::filesystem::path> paths;
    // The error of a missing folder is ignored: it has no checkpoints.
    std::error_code failed;
    for (const auto& entry : std::filesystem::directory_iterator(folder, failed))
        if (iteration_of_file(entry.path())) paths.push_back(entry.path());
    std::ranges::sort(paths, {}, iteration_of_file);
    return paths;
}

void save_checkpoint(const std::filesystem::path& folder, const Checkpoint& checkpoint, int max_checkpoints) {
    std::error_code failed;
    // If this call fails, the write below also fails and reports the error.
    std::filesystem::create_directories(folder, failed);
    const std::filesystem::path path =
        folder / fmt::format("iteration_{:08}.safetensors", checkpoint.iteration);
    write_checkpoint(path, checkpoint);
    // The new checkpoint is on disk before others are removed.
    std::vector<std::filesystem::path> older;
    for (const std::filesystem::path& other : list_checkpoints(folder)) {
        const int iteration = *iteration_of_file(other);
        if (iteration < checkpoint.iteration) older.push_back(other);
        if (iteration > checkpoint.iteration) std::filesystem::remove(other, failed);
    }
    // `older` is sorted by iteration.
    const std::size_t n_kept = static_cast<std::size_t>(std::max(max_checkpoints, 1) - 1);
    for (std::size_t i = 0; i + n_kept < older.size(); ++i) std::filesystem::remove(older[i], failed);
}

std::optional<Checkpoint> load_newest(const std::filesystem::path& folder,
                                      const std::function<void(const std::string&)>& report_unreadable) {
    const std::vector<std::filesystem::path> paths = list_checkpoints(folder);
    for (auto path = paths.rbegin(); path != paths.rend(); ++path) {
        try {
            return read_checkpoint(*path);
        } catch (const DataError& error) {
            report_unreadable(fmt::format("{}; relidar uses the previous checkpoint instead", error.what()));
        }
    }
    if (!paths.empty())
        fail("cannot resume from {}: it contains {} checkpoints, but none of them can be read",
             folder.string(), paths.size());
    return std::nullopt;
}

void remove_checkpoints(const std::filesystem::path& folder) {
    std::error_code failed;
    for (const std::filesystem::path& path : list_checkpoints(folder)) std::filesystem::remove(path, failed);
    // Does nothing if the folder is not empty.
    std::filesystem::remove(folder, failed);
}

}  // namespace relidar
