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
    /// Reads a file.
    /// @throws DataError naming the file if it is missing, truncated or damaged
    explicit Feather(const std::filesystem::path& file);
    /// Reads a table from bytes.
    /// @param name name of the bytes in messages
    Feather(std::string name, std::string bytes);
    Feather(const Feather&) = delete;  // Not copyable, because batches refer to the bytes.
    Feather& operator=(const Feather&) = delete;

    const std::string& name() const { return name_; }
    std::size_t rows() const { return rows_; }

    /// Returns the values of a numeric column, all of them finite.
    /// @throws DataError naming file and column if the column is missing, has another
    /// type, or is damaged
    std::vector<double> numbers(const std::string& column) const;
    /// Returns the values of an integer column.
    /// @throws DataError as numbers()
    std::vector<std::int64_t> integers(const std::string& column) const;
    /// Returns the values of a text column, plain or dictionary-encoded.
    /// @throws DataError as numbers()
    std::vector<std::string> texts(const std::string& column) const;

    struct Batch {
        arrow::RecordBatch layout;
        std::string_view body;
    };
    /// Column and its position among the nodes and buffers of each batch.
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
    /// Runs a task, and adds file and column to the message of a failure.
    template <class Task>
    auto reading(const std::string& column, const Task& task) const;
};

}  // namespace relidar
