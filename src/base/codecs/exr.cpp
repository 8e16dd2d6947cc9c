// SPDX-License-Identifier: Apache-2.0
// Writes and reads OpenEXR images of float channels. Images are encoded in memory and
// written with our own file functions. OpenEXR's file class would not report a full disk,
// because it writes its line table in a destructor. Headers are checked before OpenEXR
// parses them. Otherwise a damaged header could make OpenEXR allocate much more memory
// than the file can fill.
#include <array>
#include <relidar/base/images.hpp>

#include <algorithm>
#include <cstdint>
#include <iterator>
#include <set>

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfInputFile.h>
#include <ImfOutputFile.h>
#include <ImfStdIO.h>
#include <ImfStringAttribute.h>

#include "base/codecs/byte_reader.hpp"
#include "base/fail.hpp"
#include "base/files.hpp"
#include "file_io.hpp"

namespace relidar {
namespace {

namespace imf = OPENEXR_IMF_NAMESPACE;
using codecs::ByteReader;

constexpr std::uint32_t kExrMagic = 20000630, kVersionBits = 0xFF, kTiles = 0x200, kDeep = 0x800,
                        kParts = 0x1000;
constexpr std::size_t kMostChannels = 256, kLongestNote = 10000, kMaxNameBytes = 255;
// Maximum compression ratio of deflate. An image with a higher ratio is invalid.
constexpr std::size_t kMostInflated = 1032;
// Images up to this uncompressed size in bytes are accepted at any compression ratio.
constexpr std::size_t kAlwaysFits = 16 << 20;
// Number of rows in a compressed block, indexed by compression method.
constexpr std::int64_t kRowsAtOnce[] = {1, 1, 1, 16, 32, 16, 32, 32, 32, 256};

// Maximum number of pixels. The rays of a scan with so many pixels need 500 MB of memory.
constexpr std::int64_t kMaxPixels = std::int64_t(1) << 24;

void check_channels(int rows, int columns, const std::map<std::string, std::vector<float>>& channels) {
    if (rows <= 0 || columns <= 0 || channels.empty())
        fail("cannot write an EXR image with {} x {} pixels and {} channels, expected at least one of each",
             rows, columns, channels.size());
    const std::size_t n = std::size_t(rows) * std::size_t(columns);
    for (const auto& [name, values] : channels)
        if (values.size() != n)
            fail("cannot write an EXR image: channel '{}' has {} values, expected {}", name, values.size(),
                 n);
}

/// Reads a text that ends with a zero byte.
std::string read_name(ByteReader& reader) {
    const std::string_view rest = ByteReader(reader).read_rest();
    const std::size_t length = rest.find('\0');
    if (length == std::string_view::npos || length > kMaxNameBytes)
        fail("the header is truncated, or it contains a name that is longer than {} bytes", kMaxNameBytes);
    reader.read_bytes(length + 1);
    return std::string(rest.substr(0, length));
}

struct ImageHeader {
    std::int64_t rows = 0, columns = 0, rows_at_once = 1;
    std::vector<std::string> channels;
    std::map<std::string, std::string> notes;
};

/// Reads the size of the image from the attribute 'dataWindow', which has the first and
/// the last pixel: x_min, y_min, x_max, y_max.
void parse_window(std::string_view bytes, ImageHeader& image_header) {
    if (bytes.size() != 16) fail("attribute 'dataWindow' has {} bytes, expected 16", bytes.size());
    ByteReader reader(bytes);
    // Larger coordinates could overflow OpenEXR's 32-bit integers.
    constexpr std::int32_t kMaxCoordinate = 1 << 29;
    std::array<std::int32_t, 4> window;
    for (std::int32_t& coordinate : window) {
        coordinate = reader.read_number<std::int32_t>();
        if (coordinate < -kMaxCoordinate || coordinate > kMaxCoordinate)
            fail("attribute 'dataWindow' has the coordinate {}, expected {} to {}", coordinate,
                 -kMaxCoordinate, kMaxCoordinate);
    }
    const auto [x_min, y_min, x_max, y_max] = window;
    image_header.columns = std::int64_t(x_max) - x_min + 1;
    image_header.rows = std::int64_t(y_max) - y_min + 1;
}

void parse_compression(std::string_view bytes, ImageHeader& image_header) {
    const std::size_t kind =
        bytes.empty() ? std::size(kRowsAtOnce) : std::size_t(static_cast<unsigned char>(bytes[0]));
    if (kind >= std::size(kRowsAtOnce)) fail("the compression of the image is unknown");
    image_header.rows_at_once = kRowsAtOnce[kind];
}

/// Reads the list of channels: name, type, linearity and sampling, until an empty name.
void parse_channels(std::string_view bytes, ImageHeader& image_header) {
    ByteReader items(bytes);
    std::vector<std::string>& channels = image_header.channels;
    for (std::string name = read_name(items); !name.empty(); name = read_name(items)) {
        items.read_bytes(8);  // Skips type and linearity, because OpenEXR checks both.
        const auto x_step = items.read_number<std::int32_t>(), y_step = items.read_number<std::int32_t>();
        if (x_step != 1 || y_step != 1)
            fail("channel '{}' is subsampled by {} x {}, expected a value for every pixel", quote(name),
                 x_step, y_step);
        if (std::ranges::find(channels, name) != channels.end())
            fail("channel '{}' occurs twice, expected it once", quote(name));
        channels.push_back(name);
        if (channels.size() > kMostChannels)
            fail("the image has too many channels, expected at most {}", kMostChannels);
    }
    if (items.remaining() > 0)
        fail("the list of channels is shorter than its stored size, so the file is damaged");
}

/// Checks that the size of an attribute matches its type. OpenEXR ignores the stored
/// size, so a wrong size would make it read unchecked data.
void check_attribute(const std::string& name, const std::string& type, std::size_t n_bytes) {
    static const std::map<std::size_t, std::set<std::string>> kTypesBySize{
        {1, {"compression", "deepImageState", "envmap", "lineOrder"}},
        {4, {"float", "int"}},
        {8, {"double", "rational", "timecode", "v2f", "v2i"}},
        {9, {"tiledesc"}},
        {12, {"v3f", "v3i"}},
        {16, {"box2f", "box2i", "v2d"}},
        {24, {"v3d"}},
        {28, {"keycode"}},
        {32, {"chromaticities"}},
        {36, {"m33f"}},
        {64, {"m44f"}},
        {72, {"m33d"}},
        {128, {"m44d"}}};
    // Values of these types contain more sizes, for example of a preview image. Nothing
    // checks these inner sizes, so such attributes are rejected.
    static const std::set<std::string> kRejectedTypes{"idmanifest", "preview", "bytes", "stringvector"};
    if (kRejectedTypes.contains(type) || (type == "chlist" && name != "channels"))
        fail("attribute '{}' has the type '{}', which is not supported", quote(name), type);
    for (const auto& [size, types] : kTypesBySize)
        if (types.contains(type) && n_bytes != size)
            fail("attribute '{}' of type '{}' has {} bytes, expected {}", quote(name), type, n_bytes, size);
}

void check_magic(ByteReader& header_reader) {
    if (header_reader.read_number<std::uint32_t>() != kExrMagic)
        fail("the file does not begin like an OpenEXR file, expected the format OpenEXR");
    const auto version = header_reader.read_number<std::uint32_t>();
    if ((version & kVersionBits) > 2)
        fail("the file has version {} of the format, expected 2", version & kVersionBits);
    if (version & (kTiles | kDeep | kParts))
        fail("the OpenEXR file has tiles, several images, or deep data, expected one image of scan lines");
}

/// Parses the attributes at the begin of a file: name, type, size and value of each. An
/// empty name ends the list.
ImageHeader parse_exr_header(std::string_view exr_file_bytes) {
    ByteReader header(exr_file_bytes);
    check_magic(header);
    ImageHeader image_header;
    std::set<std::string> attribute_names;
    for (std::string name = read_name(header); !name.empty(); name = read_name(header)) {
        const std::string type = read_name(header);
        const auto size = header.read_number<std::int32_t>();
        if (size < 0) fail("attribute '{}' has an invalid size of {} bytes", quote(name), size);
        const std::string_view bytes = header.read_bytes(std::size_t(size));
        if (!attribute_names.insert(name).second)
            fail("attribute '{}' occurs twice, expected it once", quote(name));
        check_attribute(name, type, bytes.size());
        if (name == "dataWindow") parse_window(bytes, image_header);
        if (name == "compression") parse_compression(bytes, image_header);
        if (name == "channels") parse_channels(bytes, image_header);
        if (type == "string" && bytes.size() <= kLongestNote) image_header.notes[name] = bytes;
    }
    if (!attribute_names.contains("dataWindow") || !attribute_names.contains("channels"))
        fail("the header has no dataWindow, or no channels");
    return image_header;
}

/// Checks that the file can contain the image, before memory for the image is allocated.
void check_file_size(const ImageHeader& image_header, std::size_t file_size_bytes) {
    const std::int64_t rows = image_header.rows, columns = image_header.columns;
    if (rows <= 0 || columns <= 0 || image_header.channels.empty())
        fail("the image has {} x {} pixels and {} channels, expected at least one of each", rows, columns,
             image_header.channels.size());
    if (rows > std::int64_t(kMaxPixels) / columns)
        fail("the image has {} x {} pixels, expected at most {} pixels", rows, columns, kMaxPixels);
    // Rows are compressed in blocks of rows_at_once rows. The last may be shorter.
    const std::int64_t n_blocks = (rows + image_header.rows_at_once - 1) / image_header.rows_at_once;
    const std::int64_t n_block_rows = n_blocks * image_header.rows_at_once;
    constexpr std::size_t kMinBytesPerValue = 2;  // half precision
    const std::size_t min_unpacked_bytes =
        std::size_t(n_block_rows * columns) * image_header.channels.size() * kMinBytesPerValue;
    if (min_unpacked_bytes > std::max(kAlwaysFits, kMostInflated * file_size_bytes))
        fail("{} x {} pixels with {} channels are impossible in a file of {} bytes", rows, columns,
             image_header.channels.size(), file_size_bytes);
}

/// Decodes the bytes of a file. OpenEXR converts all channels to float.
ExrImage decode_exr(const std::string& exr_file_bytes) {
    // Checks the header before OpenEXR parses it again.
    ImageHeader image_header = parse_exr_header(exr_file_bytes);
    check_file_size(image_header, exr_file_bytes.size());
    imf::StdISStream stream;
    stream.str(exr_file_bytes);
    imf::InputFile input(stream);
    if (!input.isComplete()) fail("the image file is truncated");
    ExrImage image{.rows = int(image_header.rows),
                   .columns = int(image_header.columns),
                   .channels = {},
                   .notes = std::move(image_header.notes)};
    const auto window = input.header().dataWindow();
    imf::FrameBuffer buffer;
    const std::size_t value_bytes = sizeof(float), row_bytes = value_bytes * std::size_t(image.columns);
    for (const std::string& name : image_header.channels) {
        std::vector<float>& values = image.channels[name];
        values.resize(std::size_t(image.rows) * std::size_t(image.columns));
        buffer.insert(name, imf::Slice::Make(imf::FLOAT, values.data(), window, value_bytes, row_bytes));
    }
    input.setFrameBuffer(buffer);
    input.readPixels(window.min.y, window.max.y);
    return image;
}

}  // namespace

void write_exr(const std::filesystem::path& path, int rows, int columns,
               const std::map<std::string, std::vector<float>>& channels, const FileMetadata& metadata) {
    check_channels(rows, columns, channels);
    imf::StdOSStream stream;  // OpenEXR's file class would not report a full disk.
    try {
        imf::Header header(columns, rows);
        header.compression() = imf::ZIP_COMPRESSION;
        for (const auto& [name, text] : metadata) header.insert(name, imf::StringAttribute(text));
        imf::FrameBuffer buffer;
        const std::size_t value_bytes = sizeof(float), row_bytes = value_bytes * std::size_t(columns);
        for (const auto& [name, values] : channels) {
            header.channels().insert(name, imf::Channel(imf::FLOAT));
            // OpenEXR requires a pointer to non-const values, but only reads them.
            char* base = reinterpret_cast<char*>(const_cast<float*>(values.data()));
            buffer.insert(name, imf::Slice(imf::FLOAT, base, value_bytes, row_bytes));
        }
        imf::OutputFile file(stream, header);
        file.setFrameBuffer(buffer);
        file.writePixels(rows);
    } catch (const std::exception& error) {
        fail("cannot encode '{}' as EXR: {}", path.string(), error.what());
    }
    codecs::write_file(path, stream.str());
}

ExrImage read_exr(const std::filesystem::path& path) {
    const std::string bytes = read_file(path);
    try {
        return decode_exr(bytes);
    } catch (const DataError& error) {
        fail("{}: {}", path.string(), error.what());
    } catch (const std::exception& error) {  // OpenEXR throws its own exceptions.
        fail("{}: {}", path.string(), quote(error.what()));
    }
}

}  // namespace relidar
