// SPDX-License-Identifier: Apache-2.0
// Random changes would fail at CRCs and zlib streams. Therefore the first byte of an
// input selects its use: the file, the data of a record, or an uncompressed matrix of
// TOP.
#include "harness.hpp"

#include <cstdlib>

#include "read/datasets/waymo/waymo_segment.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

enum Part : unsigned { kFile, kRecord, kImage, kPixelPoses, kParts };

const test::WaymoSegment& make_segment_in(const fs::path& folder) {
    static const test::WaymoSegment segment((::setenv("TEST_TMPDIR", folder.c_str(), 1), "fuzz_waymo"));
    return segment;
}

/// Returns a matrix with only eight columns, because libFuzzer inputs are short.
std::string make_small_matrix(int channels) {
    const int rows = test::WaymoSegment::kTopRows, columns = 8;
    return test::make_waymo_unpacked_matrix(std::vector<float>(std::size_t(rows * columns * channels), 5.0f),
                                            {rows, columns, channels});
}

/// @param image, poses uncompressed matrices of the TOP LiDAR
std::string record_with(const test::WaymoSegment& segment, const std::string& image,
                        const std::string& poses) {
    test::WaymoFrame frame = segment.frames[0];
    frame.lasers = {test::make_waymo_laser(1, test::deflate_bytes(image), test::deflate_bytes(image),
                                           test::deflate_bytes(poses))};
    return frame.encode_frame_message();
}

std::string file_of(std::string_view input, const test::WaymoSegment& segment) {
    const unsigned part = input.empty() ? 0u : static_cast<unsigned char>(input[0]) % kParts;
    const std::string bytes(input.substr(std::min<std::size_t>(1, input.size())));
    if (part == kFile) return bytes;
    if (part == kRecord) return test::make_tfrecord(bytes);
    if (part == kImage) return test::make_tfrecord(record_with(segment, bytes, make_small_matrix(6)));
    return test::make_tfrecord(record_with(segment, make_small_matrix(4), bytes));
}

void read_waymo(std::string_view input, const fs::path& folder) {
    const test::WaymoSegment& segment = make_segment_in(folder);
    put(segment.file, file_of(input, segment));
    load_sequence("waymo:" + segment.file.string(), {});
}

std::vector<std::string> make_waymo_seeds(const fs::path& folder) {
    const std::string record =
        record_with(make_segment_in(folder), make_small_matrix(4), make_small_matrix(6));
    const auto seed = [](Part part, const std::string& bytes) { return static_cast<char>(part) + bytes; };
    return {seed(kFile, test::make_tfrecord(record)), seed(kRecord, record),
            seed(kImage, make_small_matrix(4)), seed(kPixelPoses, make_small_matrix(6))};
}

}  // namespace

std::vector<Harness> list_waymo_harnesses() { return {{"waymo", make_waymo_seeds, read_waymo}}; }

}  // namespace relidar::fuzz
