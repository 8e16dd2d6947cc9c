// SPDX-License-Identifier: Apache-2.0
// Checkpoint files. A checkpoint is the complete state of a training, so that the
// training can resume exactly. It is a list of named arrays and texts. Each class lists
// its state in one function, which serves both writing and reading.
//
// A checkpoint is stored as a safetensors file, which is written atomically. Its metadata
// contain the texts and the keys format, version, relidar (version of the writer),
// iteration and crc32. crc32 is the CRC-32 (as in zlib) of the following bytes: every
// other metadata entry, sorted by key, as "key\0value\0"; then every array as
// "name\0type\0n,m,...\0" followed by its bytes. The type is written as in numpy ("f4").
#pragma once

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

struct Checkpoint {
    int iteration = 0;  ///< Number of the last completed iteration.
    std::map<std::string, std::string> texts;
    std::vector<NamedArray> arrays;

    /// Returns the array or the text with this name.
    /// @throws DataError if the name does not exist
    const NamedArray& array(const std::string& name) const;
    const std::string& text(const std::string& name) const;
};

/// Returns the NumPy name of a number type, for example "f4" for float.
template <class T>
constexpr const char* numpy_dtype() {
    static_assert(std::is_arithmetic_v<T> && (sizeof(T) == 4 || sizeof(T) == 8));
    if constexpr (std::is_floating_point_v<T>) return sizeof(T) == 4 ? "f4" : "f8";
    else if constexpr (std::is_signed_v<T>) return sizeof(T) == 4 ? "i4" : "i8";
    else return sizeof(T) == 4 ? "u4" : "u8";
}

/// The first n values of a device array, which may be longer.
template <class T>
struct ArrayPrefix {
    Array<T>& array;
    std::size_t n;
};

/// Copies the state of a training into a checkpoint, with one call per array or number.
/// No submitted GPU work may use the device arrays during a call.
class CheckpointWriter {
public:
    explicit CheckpointWriter(Checkpoint& checkpoint) : checkpoint_(checkpoint) {}

    /// Stores a number, a host array [n] or a device array [n] under a name.
    template <class T>
    void operator()(const std::string& name, const T& value) requires std::is_arithmetic_v<T> {
        copy_array(name, numpy_dtype<T>(), {}, &value);
    }
    template <class T>
    void operator()(const std::string& name, const std::vector<T>& values) {
        copy_array(name, numpy_dtype<T>(), {values.size()}, values.data());
    }
    template <class T>
    void operator()(const std::string& name, const Array<T>& array) {
        (*this)(name, array.download());
    }
    template <class T>
    void operator()(const std::string& name, const ArrayPrefix<T>& first) {
        (*this)(name, first.array.download(first.n));
    }
    /// Stores one array per group of parameters, for example name/mean, [n,3].
    void operator()(const std::string& name, const SurfelArrays& surfels);

private:
    Checkpoint& checkpoint_;

    void copy_array(const std::string& name, const char* dtype, std::vector<std::size_t> shape,
                    const void* values);
};

/// Restores a state with the same calls as CheckpointWriter. Host vectors are resized to
/// the stored length. Device arrays must already have the right length.
/// @throws DataError naming an array that is missing or has the wrong shape
class CheckpointReader {
public:
    explicit CheckpointReader(const Checkpoint& checkpoint) : checkpoint_(checkpoint) {}

    template <class T>
    void operator()(const std::string& name, T& value) const requires std::is_arithmetic_v<T> {
        copy_bytes(checked_array(name, numpy_dtype<T>(), {}), &value);
    }
    template <class T>
    void operator()(const std::string& name, std::vector<T>& values) const {
        const NamedArray& stored_array = array_of_type(name, numpy_dtype<T>());
        values.resize(stored_array.element_count());
        copy_bytes(stored_array, values.data());
    }
    template <class T>
    void operator()(const std::string& name, Array<T>& array) const {
        (*this)(name, ArrayPrefix<T>{array, array.size()});
    }
    template <class T>
    void operator()(const std::string& name, const ArrayPrefix<T>& first) const {
        std::vector<T> values(first.n);
        copy_bytes(checked_array(name, numpy_dtype<T>(), {first.n}), values.data());
        first.array.upload(values);
    }
    void operator()(const std::string& name, SurfelArrays& surfels) const {
        surfels.upload(read_surfels(name, surfels.n));
    }

    /// Returns the stored surfels as host arrays. Their number is in the checkpoint.
    Surfels read_surfels(const std::string& name) const;

private:
    const Checkpoint& checkpoint_;

    /// Returns an array. array_of_type() accepts any length.
    /// @throws DataError if type or shape differ
    const NamedArray& checked_array(const std::string& name, const char* dtype,
                                    const std::vector<std::size_t>& shape) const;
    const NamedArray& array_of_type(const std::string& name, const char* dtype) const;
    Surfels read_surfels(const std::string& name, std::size_t n_surfels) const;
    static void copy_bytes(const NamedArray& array, void* destination);
};

/// Checks that all stored numbers are finite.
/// @throws DataError naming the array and row of the first number that is not finite
void check_finite_arrays(const Checkpoint& checkpoint);

/// Writes a checkpoint. The file appears only when it is complete.
/// @throws DataError if the file cannot be written
void write_checkpoint(const std::filesystem::path& path, const Checkpoint& checkpoint);
/// Reads a checkpoint. Checks its format, version, sizes and checksum, and that all
/// values are finite.
/// @throws DataError with the reason if a check fails
Checkpoint read_checkpoint(const std::filesystem::path& path);

/// Lists the checkpoint files of a folder, oldest first, for example
/// iteration_00000400.safetensors. Returns an empty list if the folder does not exist.
std::vector<std::filesystem::path> list_checkpoints(const std::filesystem::path& folder);
/// Writes a checkpoint into a folder, which it creates if needed. Then removes older
/// checkpoints, so that at most `max_checkpoints` remain. Also removes checkpoints of
/// later iterations, because they belong to an abandoned training.
/// @throws DataError if the file cannot be written
void save_checkpoint(const std::filesystem::path& folder, const Checkpoint& checkpoint, int max_checkpoints);
/// Loads the newest checkpoint of a folder that can be read.
/// @param report_unreadable receives one line of text about each unreadable checkpoint
/// @return nullopt if there is no checkpoint
/// @throws DataError if there are checkpoints but none is readable
std::optional<Checkpoint> load_newest(const std::filesystem::path& folder,
                                      const std::function<void(const std::string&)>& report_unreadable);
/// Removes all checkpoints of a folder, and the folder if it has no other files.
void remove_checkpoints(const std::filesystem::path& folder);

}  // namespace relidar
