// SPDX-License-Identifier: Apache-2.0
// Reads TFRecord files. Each record has a u64 length, a u32 masked CRC-32C of these 8
// bytes, the data, and a u32 masked CRC-32C of the data. Numbers are little-endian. The
// file has no header.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// Returns the CRC-32C (Castagnoli) of bytes with the mask of TFRecord: rotated right by
/// 15 bits, plus 0xa282ead8.
std::uint32_t masked_crc32c(std::string_view bytes);

/// Gives access to the records of a TFRecord file. Each record is read from the file when
/// it is requested.
class TfRecords {
public:
    /// Finds the positions of all records in the file.
    /// @throws DataError naming the record whose length or end is wrong
    explicit TfRecords(std::filesystem::path file);

    std::size_t size() const { return records_.size(); }
    const std::filesystem::path& file() const { return file_; }
    /// Reads the data of a record from the file. Thread-safe.
    /// @throws DataError if the record cannot be read or its CRC is wrong
    std::string read(std::size_t record) const;

private:
    struct Place {
        std::uint64_t begin, size;  ///< Position and size of the data, bytes.
    };
    std::filesystem::path file_;
    std::vector<Place> records_;
};

}  // namespace relidar
