// SPDX-License-Identifier: Apache-2.0
// TFRecord files: u64 length, u32 masked CRC-32C of these 8 bytes, data, u32 masked
// CRC-32C of the data; little-endian, no header.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// CRC-32C (Castagnoli), as TFRecord masks it: rotated right by 15 bits, plus 0xa282ead8.
std::uint32_t masked_crc32c(std::string_view bytes);

/// The records of a file; they are read one by one.
class TfRecords {
public:
    /// Finds all records. @throws DataError naming the record whose length, or end, is
    /// wrong
    explicit TfRecords(std::filesystem::path file);

    std::size_t size() const { return records_.size(); }
    const std::filesystem::path& file() const { return file_; }
    /// Data of a record. Several threads may read. @throws DataError where it cannot be
    /// read or its CRC is wrong
    std::string read(std::size_t record) const;

private:
    struct Place {
        std::uint64_t begin, size;  ///< of the data, bytes
    };
    std::filesystem::path file_;
    std::vector<Place> records_;
};

}  // namespace relidar
