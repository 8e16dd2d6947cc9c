// SPDX-License-Identifier: Apache-2.0
// Reads tables from Feather V2 files, which are Arrow IPC files. Supports columns of
// numbers and text, uncompressed or compressed with lz4 or zstd.
#pragma once

#include <filesystem>

#include "base/codecs/arrow_metadata.hpp"
#include "base/files.hpp"

namespace relidar {

/// Each column is decompressed when it is requested. Every offset and length is checked
/// against the size of the file, and the memory is limited to a multiple of it.
class Feather {
public:
    /// @throws DataError with the file name if the file is missing, truncated or damaged
    explicit Feather(const std::filesystem::path& file) : Feather(file.string(), read_file(file)) {}
    Feather(std::string where, std::string bytes);
    Feather(const Feather&) = delete;  // Not copyable, because batches refer to the bytes.
    Feather& operator=(const Feather&) = delete;

    const std::string& name() const { return name_; }
    std::size_t row_count() const { return rows_; }

    /// Reads a column of integers or floating point numbers. All values are finite.
    /// @throws DataError with file and column if the column is missing, damaged or has
    /// another type (also the functions below)
    std::vector<double> read_numbers(const std::string& column_name) const;
    std::vector<std::int64_t> read_integers(const std::string& column_name) const;
    std::vector<std::string> read_texts(const std::string& column_name) const;

    struct Batch {
        codecs::RecordBatch layout;
        std::string_view body;
    };
    /// `node` and `buffer` are first indices in the lists of every record batch.
    struct Column {
        codecs::ArrowField field;
        std::size_t node = 0, buffer = 0;
    };

private:
    std::string name_, bytes_;
    std::vector<Column> columns_;
    std::vector<Batch> batches_, dictionaries_;
    std::size_t rows_ = 0;

    const Column& find_column(const std::string& column_name) const;
    /// Calls task(column). Adds the names of file and column to its errors.
    template <class Task>
    auto with_location(const std::string& column_name, const Task& task) const;
};

}  // namespace relidar
