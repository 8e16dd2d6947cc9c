// SPDX-License-Identifier: Apache-2.0
// Reads OpenEXR scan-line images. Checks the header before OpenEXR parses it. Otherwise a
// damaged header could make OpenEXR allocate much more memory than the file can fill.
#include <relidar/base/images.hpp>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <iterator>
#include <set>
#include <sstream>

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputFile.h>
#include <fmt/format.h>

#include "base/fail.hpp"
#include "base/files.hpp"

namespace relidar {
namespace {

namespace imf = OPENEXR_IMF_NAMESPACE;

constexpr std::uint32_t kExrMagic = 20000630, kVersionBits = 0xFF, kTiles = 0x200, kDeep = 0x800,
                        kParts = 0x1000;
constexpr std::size_t kMostChannels = 256, kLongestNote = 10000;
// Maximum compression ratio of deflate. An image with a higher ratio is invalid.
constexpr std::size_t kMostInflated = 1032;
// Images up to this uncompressed size in bytes are accepted at any compression ratio.
constexpr std::size_t kAlwaysFits = 16 << 20;
// Number of rows in a compressed block, indexed by compression method.
constexpr std::int64_t kRowsAtOnce[] = {1, 1, 1, 16, 32, 16, 32, 32, 32, 256};

class ExrHeaderReader {
public:
    explicit ExrHeaderReader(const std::string& bytes) : file_(bytes) {}

    std::int32_t read_int32() {
        std::int32_t value = 0;
        std::memcpy(&value, read_bytes(sizeof value).data(), sizeof value);
        return value;
    }
    std::string_view read_bytes(std::size_t n_bytes) {
        if (n_bytes > file_.size() - at_) throw DataError("the header is truncated");
        at_ += n_bytes;
        return std::string_view(file_).substr(at_ - n_bytes, n_bytes);
    }
    std::string read_name() {
        const std::size_t end = file_.find('\0', at_);
        if (end == std::string::npos || end - at_ > 255)
            fail("the header is truncated, or it contains a name that is longer than 255 bytes");
        const std::string text = file_.substr(at_, end - at_);
        at_ = end + 1;
        return text;
    }

    bool is_at_end() const { return at_ == file_.size(); }

private:
    const std::string& file_;
    std::size_t at_ = 0;
};

// Maximum number of pixels. The rays of a scan with so many pixels need 500 MB of memory.
constexpr std::int64_t kMaxPixels = std::int64_t(1) << 24;

struct ImageHeader {
    std::int64_t rows = 0, columns = 0, rows_at_once = 1;
    std::vector<std::string> channels;
    std::map<std::string, std::string> notes;
};

void parse_window(std::string_view bytes, ImageHeader& image_header) {
    if (bytes.size() != 16) fail("attribute 'dataWindow' has {} bytes, expected 16", bytes.size());
    std::int32_t corner[4];
    std::memcpy(corner, bytes.data(), sizeof corner);
    image_header.columns = std::int64_t(corner[2]) - corner[0] + 1;
    image_header.rows = std::int64_t(corner[3]) - corner[1] + 1;
    // Maximum absolute value of a corner coordinate. Larger values could overflow
    // OpenEXR's 32-bit integers.
    constexpr std::int32_t kMaxCoordinate = 1 << 29;
    for (const std::int32_t c : corner)
        if (c < -kMaxCoordinate || c > kMaxCoordinate)
            fail("attribute 'dataWindow' has the coordinate {}, expected {} to {}", c, -kMaxCoordinate,
                 kMaxCoordinate);
}

void parse_compression(std::string_view bytes, ImageHeader& image_header) {
    const std::size_t kind =
        bytes.empty() ? std::size(kRowsAtOnce) : std::size_t(static_cast<unsigned char>(bytes[0]));
    if (kind >= std::size(kRowsAtOnce)) fail("the compression of the image is unknown");
    image_header.rows_at_once = kRowsAtOnce[kind];
}

/// Reads the list of channels: name, type, linearity and sampling of each channel. An
/// empty name ends the list.
void parse_channels(std::string_view bytes, ImageHeader& image_header) {
    const std::string list(bytes);
    ExrHeaderReader items(list);
    for (std::string name = items.read_name(); !name.empty(); name = items.read_name()) {
        items.read_bytes(8);  // Skips type and linearity, because OpenEXR checks both.
        const std::int32_t x = items.read_int32(), y = items.read_int32();
        if (x != 1 || y != 1)
            fail("channel '{}' is subsampled by {} x {}, expected a value for every pixel", quote(name), x,
                 y);
        if (std::find(image_header.channels.begin(), image_header.channels.end(), name) !=
            image_header.channels.end())
            fail("channel '{}' occurs twice, expected it once", quote(name));
        image_header.channels.push_back(name);
        if (image_header.channels.size() > kMostChannels)
            fail("the image has too many channels, expected at most {}", kMostChannels);
    }
    if (!items.is_at_end())
        fail("the list of channels is shorter than its stored size, so the file is damaged");
}

/// Checks that the size of an attribute matches its type. OpenEXR ignores the stored
/// size, so a wrong size would make it read unchecked data.
void check_attribute(const std::string& name, const std::string& attribute_type, std::string_view bytes) {
    static const std::map<std::string, std::size_t> kAttributeBytes = [] {
        std::istringstream text(
            "box2i 16 box2f 16 chromaticities 32 compression 1 deepImageState 1 double 8 envmap 1 float 4 "
            "int 4 keycode 28 lineOrder 1 m33d 72 m33f 36 m44d 128 m44f 64 rational 8 tiledesc 9 timecode 8 "
            "v2d 16 v2f 8 v2i 8 v3d 24 v3f 12 v3i 12");
        std::map<std::string, std::size_t> sizes;
        std::string type;
        for (std::size_t size; text >> type >> size;) sizes[type] = size;
        return sizes;
    }();
    if (const auto size_entry = kAttributeBytes.find(attribute_type);
        size_entry != kAttributeBytes.end() && size_entry->second != bytes.size())
        fail("attribute '{}' of type '{}' has {} bytes, expected {}", quote(name), attribute_type,
             bytes.size(), size_entry->second);
    if (attribute_type == "chlist") {
        ImageHeader of_others;
        parse_channels(bytes, of_others);
    }
    if (attribute_type == "stringvector") {
        const std::string list(bytes);
        for (ExrHeaderReader items(list); !items.is_at_end();) {
            const std::int32_t size = items.read_int32();
            if (size < 0) fail("attribute '{}' has an invalid text length of {} bytes", quote(name), size);
            items.read_bytes(std::size_t(size));
        }
    }
}

void check_magic(ExrHeaderReader& header_reader) {
    if (header_reader.read_int32() != std::int32_t(kExrMagic))
        throw DataError("the file does not begin like an OpenEXR file, expected the format OpenEXR");
    const auto version = std::uint32_t(header_reader.read_int32());
    if ((version & kVersionBits) > 2)
        fail("the file has version {} of the format, expected 2", version & kVersionBits);
    if (version & kTiles)
        fail("the OpenEXR image is stored in tiles, expected an image that is stored as scan lines");
    if (version & kDeep) fail("the OpenEXR image is a deep image, expected one value per pixel and channel");
    if (version & kParts) throw DataError("the file contains several images, expected one");
}

ImageHeader parse_exr_header(const std::string& exr_file_bytes) {
    ExrHeaderReader header(exr_file_bytes);
    check_magic(header);
    ImageHeader image_header;
    std::set<std::string> attribute_names;
    for (std::string name = header.read_name(); !name.empty(); name = header.read_name()) {
        const std::string type = header.read_name();
        const std::int32_t size = header.read_int32();
        if (size < 0) fail("attribute '{}' has an invalid size of {} bytes", quote(name), size);
        const std::string_view bytes = header.read_bytes(std::size_t(size));
        if (!attribute_names.insert(name).second)
            fail("attribute '{}' occurs twice, expected it once", quote(name));
        // Values of these types contain more sizes, for example of a preview image.
        // Nothing checks these inner sizes, so such attributes are rejected.
        if (type == "idmanifest" || type == "preview" || type == "bytes")
            fail("attribute '{}' has the type '{}', which is not supported", quote(name), type);
        check_attribute(name, type, bytes);
        if (name == "dataWindow") parse_window(bytes, image_header);
        if (name == "compression") parse_compression(bytes, image_header);
        if (name == "channels") parse_channels(bytes, image_header);
        if (type == "string" && bytes.size() <= kLongestNote) image_header.notes[name] = bytes;
    }
    if (!attribute_names.contains("dataWindow") || !attribute_names.contains("channels"))
        throw DataError("the header has no dataWindow, or no channels");
    return image_header;
}

/// Checks that the file is large enough for the image size that its header states.
void check_file_size(const ImageHeader& image_header, std::size_t file_size_bytes) {
    const std::int64_t rows = image_header.rows, columns = image_header.columns;
    if (rows <= 0 || columns <= 0 || image_header.channels.empty())
        fail("the image has {} x {} pixels and {} channels, expected at least one of each", rows, columns,
             image_header.channels.size());
    if (rows > std::int64_t(kMaxPixels) / columns)
        fail("the image has {} x {} pixels, expected at most {} pixels", rows, columns, kMaxPixels);
    const std::int64_t unpacked =
        (rows + image_header.rows_at_once - 1) / image_header.rows_at_once * image_header.rows_at_once;
    // Minimum uncompressed size in bytes, assuming half-precision channels.
    const std::size_t least = std::size_t(unpacked * columns) * image_header.channels.size() * 2;
    if (least > std::max(kAlwaysFits, kMostInflated * file_size_bytes))
        fail("{} x {} pixels with {} channels are impossible in a file of {} bytes", rows, columns,
             image_header.channels.size(), file_size_bytes);
}

class ExrMemoryReader : public imf::IStream {
public:
    explicit ExrMemoryReader(const std::string& bytes) : IStream("memory"), bytes_(bytes) {}

    bool read(char out[], int count) override {
        const std::size_t n_bytes = std::size_t(std::max(count, 0));
        if (n_bytes > bytes_.size() - std::min(position_, bytes_.size()))
            throw DataError("the image file is truncated");
        std::memcpy(out, bytes_.data() + position_, n_bytes);
        position_ += n_bytes;
        return position_ < bytes_.size();
    }
    std::uint64_t tellg() override { return position_; }
    void seekg(std::uint64_t position) override { position_ = position; }

private:
    const std::string& bytes_;
    std::size_t position_ = 0;
};

ExrImage decode_exr(const std::string& exr_file_bytes) {
    ImageHeader image_header = parse_exr_header(exr_file_bytes);
    check_file_size(image_header, exr_file_bytes.size());
    ExrMemoryReader stream(exr_file_bytes);
    imf::InputFile input(stream);
    if (!input.isComplete()) throw DataError("the image file is truncated");
    ExrImage image{int(image_header.rows), int(image_header.columns), {}, std::move(image_header.notes)};
    const auto window = input.header().dataWindow();
    imf::FrameBuffer buffer;
    const std::size_t stride = sizeof(float), row = stride * std::size_t(image.columns);
    for (const std::string& name : image_header.channels) {
        std::vector<float>& values = image.channels[name];
        values.resize(std::size_t(image.rows) * std::size_t(image.columns));
        buffer.insert(name, imf::Slice::Make(imf::FLOAT, values.data(), window, stride, row));
    }
    input.setFrameBuffer(buffer);
    input.readPixels(window.min.y, window.max.y);
    return image;
}

}  // namespace

ExrImage read_exr(const std::filesystem::path& path) {
    try {
        return decode_exr(read_file(path));
    } catch (const DataError& error) {
        const std::string message = error.what();
        // Some messages of read_file() already begin with the path.
        throw DataError(message.starts_with(path.string()) ? message
                                                           : fmt::format("{}: {}", path.string(), message));
    } catch (const std::exception& error) {  // OpenEXR throws its own exceptions.
        fail("{}: {}", path.string(), quote(error.what()));
    }
}

}  // namespace relidar
