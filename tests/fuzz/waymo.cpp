// SPDX-License-Identifier: Apache-2.0
// Fuzzes a Waymo Open segment. Random changes would fail at CRCs and zlib streams and not
// reach the parsers behind them. Therefore the first byte of an input selects how the
// remainder is used: as the file, as the data of a record, or as an uncompressed matrix
// of the TOP LiDAR.
#include "harness.hpp"

#include <cstdlib>

#include <relidar/log/dataset.hpp>

#include "log/readers/waymo/waymo_segment.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

enum Part : unsigned { kFile, kRecord, kImage, kPixelPoses, kParts };

const test::WaymoSegment& segment_in(const fs::path& folder) {
    static const test::WaymoSegment segment((::setenv("TEST_TMPDIR", folder.c_str(), 1), "fuzz_waymo"));
    return segment;
}

/// Returns a matrix with only eight columns, because libFuzzer inputs are short.
std::string small_matrix(int channels) {
    const int rows = test::WaymoSegment::kTopRows, columns = 8;
    return test::waymo_unpacked_matrix(std::vector<float>(std::size_t(rows * columns * channels), 5.0f),
                                       {rows, columns, channels});
}

/// Returns a record that contains only the TOP LiDAR.
/// @param image, poses uncompressed matrices
std::string record_with(const test::WaymoSegment& segment, const std::string& image,
                        const std::string& poses) {
    test::WaymoFrame frame = segment.frames[0];
    frame.lasers = {
        test::waymo_laser(1, test::deflated(image), test::deflated(image), test::deflated(poses))};
    return frame.encoded();
}

/// Returns the bytes of a segment file. The first byte of the input selects the part of
/// the file that the remainder of the input replaces.
std::string file_of(std::string_view input, const test::WaymoSegment& segment) {
    const unsigned part = input.empty() ? 0u : static_cast<unsigned char>(input[0]) % kParts;
    const std::string bytes(input.substr(std::min<std::size_t>(1, input.size())));
    if (part == kFile) return bytes;
    if (part == kRecord) return test::tfrecord(bytes);
    if (part == kImage) return test::tfrecord(record_with(segment, bytes, small_matrix(6)));
    return test::tfrecord(record_with(segment, small_matrix(4), bytes));
}

void read_waymo(std::string_view input, const fs::path& folder) {
    const test::WaymoSegment& segment = segment_in(folder);
    put(segment.file, file_of(input, segment));
    load_sequence("waymo:" + segment.file.string(), {});
}

std::vector<std::string> waymo_seeds(const fs::path& folder) {
    const std::string record = record_with(segment_in(folder), small_matrix(4), small_matrix(6));
    const auto seed = [](Part part, const std::string& bytes) { return static_cast<char>(part) + bytes; };
    return {seed(kFile, test::tfrecord(record)), seed(kRecord, record), seed(kImage, small_matrix(4)),
            seed(kPixelPoses, small_matrix(6))};
}

}  // namespace

std::vector<Harness> waymo_harnesses() { return {{"waymo", waymo_seeds, read_waymo}}; }

}  // namespace relidar::fuzz
