// SPDX-License-Identifier: Apache-2.0
// Writes OpenEXR images of float channels with ZIP compression. Encodes the image in
// memory and then writes the bytes with our own file functions. OpenEXR's file class
// would not report a full disk, because it writes its line table in a destructor.
#include <relidar/base/files.hpp>
#include <relidar/base/images.hpp>

#include <cstring>

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfOutputFile.h>
#include <ImfStringAttribute.h>

#include "base/fail.hpp"
#include "file_io.hpp"

namespace relidar {
namespace {

class ExrMemoryWriter : public OPENEXR_IMF_NAMESPACE::OStream {
public:
    ExrMemoryWriter() : OStream("memory") {}

    void write(const char bytes[], int count) override {
        if (count <= 0) return;
        const std::size_t end = position_ + std::size_t(count);
        if (end > content.size()) content.resize(end);
        std::memcpy(content.data() + position_, bytes, std::size_t(count));
        position_ = end;
    }
    std::uint64_t tellp() override { return position_; }
    void seekp(std::uint64_t position) override { position_ = position; }

    std::string content;

private:
    std::size_t position_ = 0;
};

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

}  // namespace

void write_exr(const std::filesystem::path& path, int rows, int columns,
               const std::map<std::string, std::vector<float>>& channels, const FileMetadata& metadata) {
    namespace imf = OPENEXR_IMF_NAMESPACE;
    check_channels(rows, columns, channels);
    ExrMemoryWriter stream;
    try {
        imf::Header header(columns, rows);
        header.compression() = imf::ZIP_COMPRESSION;
        for (const auto& [name, text] : metadata) header.insert(name, imf::StringAttribute(text));
        imf::FrameBuffer buffer;
        const std::size_t stride = sizeof(float);
        for (const auto& [name, values] : channels) {
            header.channels().insert(name, imf::Channel(imf::FLOAT));
            // OpenEXR requires a pointer to non-const values, but only reads them.
            char* base = reinterpret_cast<char*>(const_cast<float*>(values.data()));
            buffer.insert(name, imf::Slice(imf::FLOAT, base, stride, stride * std::size_t(columns)));
        }
        imf::OutputFile file(stream, header);
        file.setFrameBuffer(buffer);
        file.writePixels(rows);
    } catch (const std::exception& error) {
        fail("cannot encode '{}' as EXR: {}", path.string(), error.what());
    }
    codecs::write_file(path, stream.content);
}

}  // namespace relidar
