// SPDX-License-Identifier: Apache-2.0
// Reads tables from Feather V2 files, which are Arrow IPC files. Columns of numbers or
// text may be uncompressed or compressed with lz4 or zstd.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "base/codecs/arrow_metadata.hpp"

namespace relidar {

/// Feather file in memory. A column is decompressed when it is requested. Every offset
/// and length is checked against the file. To limit memory, a file may have at most 64
/// rows, and 1024 bytes of text per column, for each of its bytes.
class Feather {
public:
    /// Reads a Feather file into memory.
    /// @throws DataError naming the file if it is missing, truncated or damaged
    explicit Feather(const std::filesystem::path& file);
    /// Parses the bytes of a Feather file.
    /// @param name name of the data in error messages
    Feather(std::string name, std::string bytes);
    Feather(const Feather&) = delete;  // Not copyable, because batches refer to the bytes.
    Feather& operator=(const Feather&) = delete;

    const std::string& name() const { return name_; }
    std::size_t rows() const { return rows_; }

    /// Returns the values of a numeric column. All values are finite.
    /// @throws DataError naming file and column if the column is missing, has another
    /// type, or is damaged
    std::vector<double> numbers(const std::string& column) const;
    /// Returns the values of an integer column.
    /// @throws DataError naming file and column if the column is missing, has another
    /// type, or is damaged
    std::vector<std::int64_t> integers(const std::string& column) const;
    /// Returns the values of a text column. The column may be dictionary-encoded.
    /// @throws DataError naming file and column if the column is missing, has another
    /// type, or is damaged
    std::vector<std::string> texts(const std::string& column) const;

    struct Batch {
        arrow::RecordBatch layout;
        std::string_view body;
    };
    /// A column, and the index of its first node and first buffer in each record batch.
    struct Column {
        arrow::Field field;
        std::size_t node = 0, buffer = 0;
    };

private:
    std::string name_, bytes_;
    std::vector<Column> columns_;
    std::vector<Batch> batches_, dictionaries_;
    std::size_t rows_ = 0;

    const Column& find(const std::string& name) const;
    /// Runs a task that reads a column. If it fails, adds the names of file and column to
    /// the error message.
    template <class Task>
    auto reading(const std::string& column, const Task& task) const;
};

}  // namespace relidar
