// SPDX-License-Identifier: Apache-2.0
#include "base/codecs/feather_writer.hpp"
#include "base/codecs/arrow_metadata.hpp"

#include <algorithm>

#include <flatbuffers/flatbuffers.h>
#include <gtest/gtest.h>
#include <lz4frame.h>
#include <zstd.h>
#include <glm/gtc/packing.hpp>

namespace relidar::test {
namespace {

using Builder = flatbuffers::FlatBufferBuilder;
using Offset = flatbuffers::Offset<flatbuffers::Table>;

using Node = codecs::ArrowFieldNode;
using Buffer = codecs::ArrowBufferRange;
using Block = codecs::ArrowFileBlock;

flatbuffers::voffset_t entry(int field) { return flatbuffers::voffset_t(4 + 2 * field); }

template <class Add>
Offset table(Builder& builder, const Add& add) {
    const auto start = builder.StartTable();
    add();
    return Offset(builder.EndTable(start));
}

Offset make_type(Builder& builder, const FeatherColumn& column) {
    return table(builder, [&] {
        if (column.kind == FeatherColumn::Kind::integer) {
            builder.AddElement<std::int32_t>(entry(0), column.bits, 0);
            builder.AddElement<std::uint8_t>(entry(1), column.is_signed, 0);
        } else if (column.kind == FeatherColumn::Kind::floating) {
            builder.AddElement<std::int16_t>(entry(0), std::int16_t(column.bits / 32), 0);
        }
    });
}

Offset make_schema(Builder& builder, const std::vector<FeatherColumn>& columns) {
    std::vector<Offset> fields;
    for (std::size_t i = 0; i < columns.size(); ++i) {
        const FeatherColumn& column = columns[i];
        const auto name = builder.CreateString(column.name);
        const Offset type = make_type(builder, column);
        const auto children = builder.CreateVector(std::vector<Offset>());
        Offset index, dictionary;
        if (column.by_dictionary) {
            index = make_type(builder, {FeatherColumn::Kind::integer, "", 8, true, {}, {}, false});
            dictionary = table(builder, [&] {
                builder.AddElement<std::int64_t>(entry(0), std::int64_t(i), 0);
                builder.AddOffset(entry(1), index);
            });
        }
        const std::uint8_t kinds[] = {2, 3, 5};  // Int, FloatingPoint, Utf8
        fields.push_back(table(builder, [&] {
            builder.AddOffset(entry(0), name);
            builder.AddElement<std::uint8_t>(entry(1), 1, 0);
            builder.AddElement<std::uint8_t>(entry(2), kinds[int(column.kind)], 0);
            builder.AddOffset(entry(3), type);
            if (column.by_dictionary) builder.AddOffset(entry(4), dictionary);
            builder.AddOffset(entry(5), children);
        }));
    }
    const auto all = builder.CreateVector(fields);
    return table(builder, [&] { builder.AddOffset(entry(1), all); });
}

std::string compress_bytes(const std::string& bytes, FeatherCodec codec) {
    std::string packed(codec == FeatherCodec::lz4 ? LZ4F_compressFrameBound(bytes.size(), nullptr)
                                                  : ZSTD_compressBound(bytes.size()),
                       '\0');
    const std::size_t n =
        codec == FeatherCodec::lz4
            ? LZ4F_compressFrame(packed.data(), packed.size(), bytes.data(), bytes.size(), nullptr)
            : ZSTD_compress(packed.data(), packed.size(), bytes.data(), bytes.size(), 3);
    packed.resize(n);
    return packed;
}

struct Body {
    FeatherCodec codec;
    std::string bytes;
    std::vector<Node> nodes;
    std::vector<Buffer> buffers;

    void add(const std::string& buffer) {
        std::string stored = buffer;
        if (codec != FeatherCodec::none && !buffer.empty()) {
            std::int64_t n = std::int64_t(buffer.size());
            std::string packed = compress_bytes(buffer, codec);
            if (packed.size() >= buffer.size()) {
                n = -1;
                packed = buffer;
            }
            stored.assign(reinterpret_cast<const char*>(&n), sizeof n);
            stored += packed;
        }
        buffers.push_back({std::int64_t(bytes.size()), std::int64_t(stored.size())});
        bytes += stored;
        bytes.resize((bytes.size() + 7) / 8 * 8, '\0');
    }
    void add_texts(const std::vector<std::string>& texts) {
        std::vector<std::int32_t> offsets{0};
        std::string characters;
        for (const std::string& text : texts) {
            characters += text;
            offsets.push_back(std::int32_t(characters.size()));
        }
        nodes.push_back({std::int64_t(texts.size()), 0});
        add("");
        add({reinterpret_cast<const char*>(offsets.data()), offsets.size() * sizeof(std::int32_t)});
        add(characters);
    }
    void add_numbers(const std::string& values, std::size_t rows) {
        nodes.push_back({std::int64_t(rows), 0});
        add("");
        add(values);
    }
};

std::vector<std::string> get_words(const FeatherColumn& column) {
    std::vector<std::string> words = column.texts;
    std::sort(words.begin(), words.end());
    words.erase(std::unique(words.begin(), words.end()), words.end());
    return words;
}

void add_rows(Body& body, const FeatherColumn& column, std::size_t begin, std::size_t end) {
    if (column.kind != FeatherColumn::Kind::text) {
        const std::size_t width = std::size_t(column.bits / 8);
        return body.add_numbers(column.values.substr(begin * width, (end - begin) * width), end - begin);
    }
    const std::vector<std::string> texts(column.texts.begin() + std::ptrdiff_t(begin),
                                         column.texts.begin() + std::ptrdiff_t(end));
    if (!column.by_dictionary) return body.add_texts(texts);
    const std::vector<std::string> words = get_words(column);
    std::string indices;
    for (const std::string& text : texts)
        indices += char(std::lower_bound(words.begin(), words.end(), text) - words.begin());
    body.add_numbers(indices, end - begin);
}

Offset make_batch(Builder& builder, const Body& body, std::size_t rows) {
    const auto nodes = builder.CreateVectorOfStructs(body.nodes);
    const auto buffers = builder.CreateVectorOfStructs(body.buffers);
    const Offset compression = table(builder, [&] {
        if (body.codec == FeatherCodec::zstd) builder.AddElement<std::int8_t>(entry(0), 1, 0);
    });
    return table(builder, [&] {
        builder.AddElement<std::int64_t>(entry(0), std::int64_t(rows), 0);
        builder.AddOffset(entry(1), nodes);
        builder.AddOffset(entry(2), buffers);
        if (body.codec != FeatherCodec::none) builder.AddOffset(entry(3), compression);
    });
}

/// @param header type of the message: 1 schema, 2 dictionary, 3 record batch
Block append_message(std::string& file, Builder& builder, std::uint8_t kind, Offset header,
                     const std::string& body) {
    builder.Finish(table(builder, [&] {
        builder.AddElement<std::int16_t>(entry(0), 4, 0);  // metadata version 5
        builder.AddElement<std::uint8_t>(entry(1), kind, 0);
        builder.AddOffset(entry(2), header);
        builder.AddElement<std::int64_t>(entry(3), std::int64_t(body.size()), 0);
    }));
    const std::uint32_t mark = 0xFFFFFFFFu;
    const std::int32_t n = std::int32_t((builder.GetSize() + 7) / 8 * 8);
    const Block block{std::int64_t(file.size()), n + 8, 0, std::int64_t(body.size())};
    file.append(reinterpret_cast<const char*>(&mark), 4).append(reinterpret_cast<const char*>(&n), 4);
    file.append(reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize());
    file.resize(std::size_t(block.offset + block.metadata_bytes), '\0');
    file += body;
    return block;
}

}  // namespace

FeatherColumn make_halves(const std::string& name, const std::vector<float>& values) {
    FeatherColumn column{FeatherColumn::Kind::floating, name, 16, true, {}, {}, false};
    for (const float value : values) {
        const std::uint16_t half = glm::packHalf1x16(value);
        column.values.append(reinterpret_cast<const char*>(&half), 2);
    }
    return column;
}

FeatherColumn make_texts(const std::string& name, const std::vector<std::string>& texts, bool by_dictionary) {
    return {FeatherColumn::Kind::text, name, 0, false, {}, texts, by_dictionary};
}

std::string make_feather_bytes(const std::vector<FeatherColumn>& columns, FeatherCodec codec,
                               std::size_t rows_a_batch) {
    std::string file("ARROW1\0\0", 8);
    std::vector<Block> dictionaries, batches;
    {
        Builder builder;
        append_message(file, builder, 1, make_schema(builder, columns), "");
    }
    for (std::size_t i = 0; i < columns.size(); ++i) {
        if (!columns[i].by_dictionary) continue;
        Body body{codec, {}, {}, {}};
        body.add_texts(get_words(columns[i]));
        Builder builder;
        const Offset batch = make_batch(builder, body, get_words(columns[i]).size());
        const Offset header = table(builder, [&] {
            builder.AddElement<std::int64_t>(entry(0), std::int64_t(i), 0);
            builder.AddOffset(entry(1), batch);
        });
        dictionaries.push_back(append_message(file, builder, 2, header, body.bytes));
    }
    const std::size_t rows = columns.empty() ? 0 : columns[0].rows(),
                      step = rows_a_batch == 0 ? std::max<std::size_t>(rows, 1) : rows_a_batch;
    for (std::size_t begin = 0; begin < rows; begin += step) {
        const std::size_t end = std::min(rows, begin + step);
        Body body{codec, {}, {}, {}};
        for (const FeatherColumn& column : columns) {
            EXPECT_EQ(column.rows(), rows) << column.name;
            add_rows(body, column, begin, end);
        }
        Builder builder;
        batches.push_back(
            append_message(file, builder, 3, make_batch(builder, body, end - begin), body.bytes));
    }
    file += std::string("\xFF\xFF\xFF\xFF\0\0\0\0", 8);  // end of the messages
    Builder builder;
    const Offset schema = make_schema(builder, columns);
    const auto of_dictionaries = builder.CreateVectorOfStructs(dictionaries),
               of_batches = builder.CreateVectorOfStructs(batches);
    builder.Finish(table(builder, [&] {
        builder.AddElement<std::int16_t>(entry(0), 4, 0);
        builder.AddOffset(entry(1), schema);
        builder.AddOffset(entry(2), of_dictionaries);
        builder.AddOffset(entry(3), of_batches);
    }));
    const std::int32_t n = std::int32_t(builder.GetSize());
    file.append(reinterpret_cast<const char*>(builder.GetBufferPointer()), builder.GetSize());
    file.append(reinterpret_cast<const char*>(&n), 4);
    return file + "ARROW1";
}

}  // namespace relidar::test
