// SPDX-License-Identifier: Apache-2.0
// Reads the records of TFRecord files and checks their CRC-32C. This CRC uses the
// reflected polynomial 0x82F63B78, and inverts its initial and final value.
#include "base/codecs/tfrecord.hpp"

#include <array>
#include <fstream>
#include <utility>

#include <fmt/format.h>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {
namespace {

using codecs::number_at;
// The header has the length (8 bytes) and its CRC (4), the footer the CRC of the data.
constexpr std::uint64_t kLengthBytes = 8, kHeaderBytes = kLengthBytes + 4, kFooterBytes = 4;

constexpr std::array<std::uint32_t, 256> make_crc_table() {
    std::array<std::uint32_t, 256> table{};
    for (std::uint32_t byte = 0; byte < 256; ++byte) {
        std::uint32_t c = byte;
        for (int bit = 0; bit < 8; ++bit) c = (c >> 1) ^ ((c & 1) != 0 ? 0x82F63B78u : 0u);
        table[byte] = c;
    }
    return table;
}

}  // namespace

std::uint32_t masked_crc32c(std::string_view bytes) {
    static constexpr std::array<std::uint32_t, 256> kCrcTable = make_crc_table();
    std::uint32_t c = ~0u;
    for (const char byte : bytes) c = kCrcTable[(c ^ static_cast<unsigned char>(byte)) & 0xFF] ^ (c >> 8);
    c = ~c;
    return ((c >> 15) | (c << 17)) + 0xa282ead8u;
}

/// Finds the positions of all records. A record has a length (8 bytes), the CRC of the
/// length, the data, and the CRC of the data, which read_record() checks.
TfRecordReader::TfRecordReader(std::filesystem::path file) : file_(std::move(file)) {
    if (!does_path_exist(file_)) fail("{}: no such file", file_.string());
    std::ifstream in(file_, std::ios::binary | std::ios::ate);
    const std::streamoff end = in ? std::streamoff(in.tellg()) : -1;
    if (end < 0) fail("cannot read {}", file_.string());
    std::uint64_t position = 0, n_left_bytes = std::uint64_t(end);
    while (n_left_bytes > 0) {
        const std::string where = fmt::format("{}: record {}", file_.string(), records_.size());
        std::string header(kHeaderBytes, '\0');
        in.seekg(std::streamoff(position));
        if (n_left_bytes < kHeaderBytes || !in.read(header.data(), kHeaderBytes))
            fail("{} is truncated: its header has {} bytes, expected {}", where, n_left_bytes, kHeaderBytes);
        if (number_at<std::uint32_t>(header, kLengthBytes) != masked_crc32c(header.substr(0, kLengthBytes)))
            fail("{}: the checksum (CRC) of its length is wrong, so the file is damaged or no TFRecord file",
                 where);
        const auto data_bytes = number_at<std::uint64_t>(header, 0);
        n_left_bytes -= kHeaderBytes;
        if (n_left_bytes < kFooterBytes || data_bytes > n_left_bytes - kFooterBytes)
            fail("{} is truncated: its length is {} bytes + {} of checksum, found {}", where, data_bytes,
                 kFooterBytes, n_left_bytes);
        records_.push_back({.begin = position + kHeaderBytes, .size = data_bytes});
        position += kHeaderBytes + data_bytes + kFooterBytes;
        n_left_bytes -= data_bytes + kFooterBytes;
    }
    if (records_.empty())
        fail("{} is empty, expected a TFRecord file with at least one record", file_.string());
}

/// Reads the data of a record and compares its checksum. Opens the file for each record,
/// so that several threads can read at the same time.
std::string TfRecordReader::read_record(std::size_t record_index) const {
    const RecordByteRange& byte_range = records_[record_index];
    std::string data(byte_range.size + kFooterBytes, '\0');
    std::ifstream in(file_, std::ios::binary);
    in.seekg(std::streamoff(byte_range.begin));
    if (!in.read(data.data(), std::streamsize(data.size())))
        fail("{}: record {}: cannot read its {} bytes", file_.string(), record_index, data.size());
    // The checksum of the data follows the data.
    const auto crc = number_at<std::uint32_t>(data, byte_range.size);
    data.resize(byte_range.size);
    if (crc != masked_crc32c(data))
        fail("{}: record {}: the checksum (CRC) of its data is wrong; the file is damaged", file_.string(),
             record_index);
    return data;
}

}  // namespace relidar
