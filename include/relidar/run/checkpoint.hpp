// SPDX-License-Identifier: Apache-2.0
// Checkpoints: the complete state of a training, from which it resumes exactly. A
// checkpoint is a list of named arrays and texts. The class that has the state lists it
// once, in a function used with both StateWriter and StateReader.
//
// A checkpoint is stored as a safetensors file, which is written atomically. Its metadata
// contain the texts and the keys format, version, relidar (version of the writer),
// iteration and crc32. crc32 is the CRC-32 (as in zlib) of the following bytes: every
// other metadata entry, sorted by key, as "key\0value\0"; then every array as
// "name\0type\0n,m,...\0" followed by its bytes. The type is written as in numpy ("f4").
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <type_traits>
#include <vector>

#include <relidar/base/arrays.hpp>
#include <relidar/gpu/stream.hpp>
#include <relidar/scene/device_scene.hpp>

namespace relidar {

/// State of a training after an iteration.
struct Checkpoint {
    int iteration = 0;  ///< Number of the last completed iteration.
    std::map<std::string, std::string> texts;
    std::vector<NamedArray> arrays;

    /// Returns the array or text with this name.
    /// @throws DataError if it does not exist
    const NamedArray& array(const std::string& name) const;
    const std::string& text(const std::string& name) const;
};

/// Returns numpy's name of a number type.
template <class T>
constexpr const char* dtype_of() {
    static_assert(std::is_arithmetic_v<T> && (sizeof(T) == 4 || sizeof(T) == 8));
    if constexpr (std::is_floating_point_v<T>) return sizeof(T) == 4 ? "f4" : "f8";
    else if constexpr (std::is_signed_v<T>) return sizeof(T) == 4 ? "i4" : "i8";
    else return sizeof(T) == 4 ? "u4" : "u8";
}

/// Reference to the first n values of a device array, which may be larger.
template <class T>
struct FirstOf {
    Array<T>& array;
    std::size_t n;
};

/// Copies state into a checkpoint, with one call per array or number. No running work may
/// use the device arrays.
class StateWriter {
public:
    explicit StateWriter(Checkpoint& checkpoint) : checkpoint_(checkpoint) {}

    /// Stores a number, an array on the host [n] or an array on the device [n].
    template <class T>
    void operator()(const std::string& name, const T& value) requires std::is_arithmetic_v<T> {
        put(name, dtype_of<T>(), {}, &value);
    }
    template <class T>
    void operator()(const std::string& name, const std::vector<T>& values) {
        put(name, dtype_of<T>(), {values.size()}, values.data());
    }
    template <class T>
    void operator()(const std::string& name, const Array<T>& array) {
        (*this)(name, array.download());
    }
    template <class T>
    void operator()(const std::string& name, const FirstOf<T>& first) {
        (*this)(name, first.array.download(first.n));
    }
    /// Stores one array per parameter group: name/mean [n,3] and so on.
    void operator()(const std::string& name, const SurfelArrays& surfels);

private:
    Checkpoint& checkpoint_;

    /// Copies the values into the checkpoint.
    void put(const std::string& name, const char* dtype, std::vector<std::size_t> shape, const void* values);
};

/// Copies state back from a checkpoint, with the same calls as the writer. Host vectors
/// are resized to the stored length; device arrays must have the right length already.
/// @throws DataError if an array is missing or has the wrong shape; the message names the
/// array
class StateReader {
public:
    explicit StateReader(const Checkpoint& checkpoint) : checkpoint_(checkpoint) {}

    /// Restores a number, an array on the host [n] or an array on the device [n].
    template <class T>
    void operator()(const std::string& name, T& value) const requires std::is_arithmetic_v<T> {
        copy(find(name, dtype_of<T>(), {}), &value);
    }
    template <class T>
    void operator()(const std::string& name, std::vector<T>& values) const {
        const NamedArray& found = find_rows(name, dtype_of<T>());
        values.resize(found.count());
        copy(found, values.data());
    }
    template <class T>
    void operator()(const std::string& name, Array<T>& array) const {
        (*this)(name, FirstOf<T>{array, array.size()});
    }
    template <class T>
    void operator()(const std::string& name, const FirstOf<T>& first) const {
        std::vector<T> values(first.n);
        copy(find(name, dtype_of<T>(), {first.n}), values.data());
        first.array.upload(values);
    }
    void operator()(const std::string& name, SurfelArrays& surfels) const {
        surfels.upload(surfels_of(name, surfels.n));
    }

    /// Returns the stored surfels on the host, for any number of surfels.
    Surfels surfels(const std::string& name) const;

private:
    const Checkpoint& checkpoint_;

    /// Helpers that return an array of the given type and shape, an array of the given
    /// type and any length, or the arrays of n surfels. copy() copies all bytes of an
    /// array.
    const NamedArray& find(const std::string& name, const char* dtype,
                           const std::vector<std::size_t>& shape) const;
    const NamedArray& find_rows(const std::string& name, const char* dtype) const;
    Surfels surfels_of(const std::string& name, std::size_t n) const;
    static void copy(const NamedArray& array, void* values);
};

/// Checks that all stored numbers are finite.
/// @throws DataError naming array and row of the first number that is not finite
void check_finite(const Checkpoint& checkpoint);

/// Writes a checkpoint file atomically.
/// @throws DataError if the file cannot be written
void write_checkpoint(const std::filesystem::path& path, const Checkpoint& checkpoint);
/// Reads a checkpoint file and checks format, version, sizes, checksum and that all
/// values are finite.
/// @throws DataError with the reason if a check fails
Checkpoint read_checkpoint(const std::filesystem::path& path);

/// Lists the checkpoint files of a folder, oldest first, for example
/// iteration_00000400.safetensors. Returns an empty list if the folder does not exist.
std::vector<std::filesystem::path> list_checkpoints(const std::filesystem::path& folder);
/// Writes a checkpoint into a folder, which is created if needed. Then removes older
/// checkpoints, so that at most `keep` remain. Also removes checkpoints of later
/// iterations, which belong to an abandoned training. Removes files only after the new
/// checkpoint is on disk.
/// @throws DataError as write_checkpoint()
void save_checkpoint(const std::filesystem::path& folder, const Checkpoint& checkpoint, int keep);
/// Loads the newest readable checkpoint of a folder.
/// @param note callback for one line about each unreadable checkpoint
/// @return nullopt if there is no checkpoint
/// @throws DataError if there are checkpoints but none is readable
std::optional<Checkpoint> load_newest_checkpoint(const std::filesystem::path& folder,
                                                 const std::function<void(const std::string&)>& note);
/// Removes all checkpoints of a folder. Removes the folder if it is then empty.
void remove_checkpoints(const std::filesystem::path& folder);

}  // namespace relidar
