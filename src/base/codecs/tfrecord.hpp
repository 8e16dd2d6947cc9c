// SPDX-License-Identifier: Apache-2.0
// Reads TFRecord files. Each record contains a u64 length, its masked CRC-32C (u32), the
// data, and the masked CRC-32C of the data (u32). Numbers are little-endian. The file has
// no header.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace relidar {

/// CRC-32C (Castagnoli) rotated right by 15 bits, plus 0xa282ead8.
std::uint32_t masked_crc32c(std::string_view bytes);

/// Reads the data of a record only when it is requested.
class TfRecordReader {
public:
    /// @throws DataError with the number of the record whose length or end is wrong
    explicit TfRecordReader(std::filesystem::path file);

    std::size_t size() const { return records_.size(); }
    const std::filesystem::path& file_path() const { return file_; }
    std::string read_record(std::size_t record_index) const;

private:
    struct RecordByteRange {
        std::uint64_t begin, size;  ///< Position and size of the data, bytes.
    };
    std::filesystem::path file_;
    std::vector<RecordByteRange> records_;
};

}  // namespace relidar
