// SPDX-License-Identifier: Apache-2.0
// Tables in Feather V2 files, which are Arrow IPC files: columns of numbers or text,
// uncompressed or compressed by lz4 or zstd.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "base/codecs/arrow_metadata.hpp"

namespace relidar {

/// A file in memory; a column is decompressed when it is asked for. Every offset and
/// length is checked against the file, and no file is believed to hold more than 64 rows,
/// or 1024 bytes of one column's text, for each of its bytes.
class Feather {
public:
    /// @throws DataError naming the file: no such file, cut short or damaged
    explicit Feather(const std::filesystem::path& file);
    /// @param name  of the bytes in messages
    Feather(std::string name, std::string bytes);
    Feather(const Feather&) = delete;  // batches look into the bytes
    Feather& operator=(const Feather&) = delete;

    const std::string& name() const { return name_; }
    std::size_t rows() const { return rows_; }

    /// Values of a column of numbers, all of them finite. @throws DataError naming file
    /// and column: missing, of another type, damaged
    std::vector<double> numbers(const std::string& column) const;
    /// Values of a column of integers. @throws as numbers
    std::vector<std::int64_t> integers(const std::string& column) const;
    /// Values of a column of text, written out or by a dictionary. @throws as numbers
    std::vector<std::string> texts(const std::string& column) const;

    struct Batch {
        arrow::RecordBatch layout;
        std::string_view body;
    };
    /// A column, and its place among the nodes and buffers of each batch.
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
    /// Runs a task whose failures are of a column of this file.
    template <class Task>
    auto reading(const std::string& column, const Task& task) const;
};

}  // namespace relidar
