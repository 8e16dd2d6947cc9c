// SPDX-License-Identifier: Apache-2.0
// Checkpoints: everything a run has changed so far, so that it continues as if it had
// never stopped. A checkpoint is a list of named arrays and texts; what they are is the
// business of whoever owns the state, who lists it once for StateWriter and StateReader.
//
// On disk it is a safetensors file, written whole or not at all. Its metadata hold the
// texts and format, version, relidar (who wrote it), iteration, and crc32: the CRC-32
// (zlib's) of, in this order, every other metadata entry sorted by key as "key\0value\0",
// then every array as "name\0type\0n,m,...\0" followed by its bytes, type as numpy writes
// it ("f4").
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

/// State of a run after an iteration.
struct Checkpoint {
    int iteration = 0;  ///< the last one that is done
    std::map<std::string, std::string> texts;
    std::vector<NamedArray> arrays;

    /// @throws DataError where there is none of that name
    const NamedArray& array(const std::string& name) const;
    const std::string& text(const std::string& name) const;
};

/// numpy's name of a number's type.
template <class T>
constexpr const char* dtype_of() {
    static_assert(std::is_arithmetic_v<T> && (sizeof(T) == 4 || sizeof(T) == 8));
    if constexpr (std::is_floating_point_v<T>) return sizeof(T) == 4 ? "f4" : "f8";
    else if constexpr (std::is_signed_v<T>) return sizeof(T) == 4 ? "i4" : "i8";
    else return sizeof(T) == 4 ? "u4" : "u8";
}

/// The first n values of a device array that may have room for more.
template <class T>
struct FirstOf {
    Array<T>& array;
    std::size_t n;
};

/// Copies state into a checkpoint: one call for each thing that is state. Device arrays
/// must not be in use by work still running.
class StateWriter {
public:
    explicit StateWriter(Checkpoint& checkpoint) : checkpoint_(checkpoint) {}

    /// A number, numbers on the host [n], numbers on the device [n].
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
    /// An array for each group of parameters, name/mean [n,3] and so on.
    void operator()(const std::string& name, const SurfelArrays& surfels);

private:
    Checkpoint& checkpoint_;

    /// copies
    void put(const std::string& name, const char* dtype, std::vector<std::size_t> shape, const void* values);
};

/// Copies state back from a checkpoint, called exactly as the writer was. Vectors on the
/// host take the length found; what is on the device must have it already. @throws
/// DataError naming the array that is missing or misshapen
class StateReader {
public:
    explicit StateReader(const Checkpoint& checkpoint) : checkpoint_(checkpoint) {}

    /// A number, numbers on the host [n], numbers on the device [n].
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

    /// The same arrays on the host, however many surfels there are.
    Surfels surfels(const std::string& name) const;

private:
    const Checkpoint& checkpoint_;

    /// An array that must have this type and shape; one of this type and any length;
    /// arrays of n surfels; all bytes of one.
    const NamedArray& find(const std::string& name, const char* dtype,
                           const std::vector<std::size_t>& shape) const;
    const NamedArray& find_rows(const std::string& name, const char* dtype) const;
    Surfels surfels_of(const std::string& name, std::size_t n) const;
    static void copy(const NamedArray& array, void* values);
};

/// @throws DataError naming array and row of the first number that is not finite
void check_finite(const Checkpoint& checkpoint);

/// Writes one file atomically. @throws DataError where it cannot be written
void write_checkpoint(const std::filesystem::path& path, const Checkpoint& checkpoint);
/// Reads it back, all of it checked: format, version, sizes, checksum, finite values.
/// @throws DataError saying what is wrong
Checkpoint read_checkpoint(const std::filesystem::path& path);

/// The checkpoints in a folder, oldest first: iteration_00000400.safetensors. Empty where
/// there is no folder.
std::vector<std::filesystem::path> list_checkpoints(const std::filesystem::path& folder);
/// Writes a checkpoint into a folder, which is made where missing, then removes all but
/// the newest `keep` up to this one, and those of later iterations: of a future that was
/// left. Nothing is removed before the new one is on the disk. @throws as
/// write_checkpoint
void save_checkpoint(const std::filesystem::path& folder, const Checkpoint& checkpoint, int keep);
/// The newest that can be read. @param note gets one line for each that cannot @return
/// nothing where there is no checkpoint
/// @throws DataError where there are some but none can be read
std::optional<Checkpoint> load_newest_checkpoint(const std::filesystem::path& folder,
                                                 const std::function<void(const std::string&)>& note);
/// Removes all checkpoints of a folder, and the folder where nothing else is in it.
void remove_checkpoints(const std::filesystem::path& folder);

}  // namespace relidar
