// SPDX-License-Identifier: Apache-2.0
// Compares with pyarrow's files in ../shared/data/fixtures if RELIDAR_SHARED contains
// them.
#include "base/codecs/feather.hpp"

#include <cmath>
#include <cstdlib>
#include <cstring>

#include <relidar/base/arrays.hpp>
#include <relidar/base/error.hpp>
#include "base/codecs/feather_writer.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;
using test::FeatherCodec;
using test::FeatherColumn;
using test::make_feather_bytes;

struct Table {
    std::vector<std::int64_t> wide{
        std::numeric_limits<std::int64_t>::min(), 315966265259836001, -1, 0, 1, 2, 3};
    std::vector<std::uint8_t> narrow{0, 255, 1, 2, 3, 4, 5};
    std::vector<std::int16_t> middle{-32768, 32767, 0, 1, 2, 3, 4};
    std::vector<std::uint32_t> unsigned_wide{4294967295u, 0, 1, 2, 3, 4, 5};
    std::vector<double> f64{1e-300, -2.5, 0, 1, 2, 3, 4};
    std::vector<float> f32{1e-30f, -2.5f, 0, 1, 2, 3, 4},
        f16{65504.0f, -0.333251953125f, 5.9604644775390625e-8f, 0.0f, 1, 2, 3};
    std::vector<std::string> text{"up_lidar", "", "äö", "b", "b", "b", "up_lidar"};

    std::vector<FeatherColumn> columns() const {
        return {test::make_numbers("wide", wide),     test::make_numbers("narrow", narrow),
                test::make_numbers("middle", middle), test::make_numbers("unsigned_wide", unsigned_wide),
                test::make_numbers("f64", f64),       test::make_texts("text", text),
                test::make_numbers("f32", f32),       test::make_texts("word", text, true),
                test::make_halves("f16", f16)};
    }
};

template <class T>
std::vector<double> as_double(const std::vector<T>& values) {
    return {values.begin(), values.end()};
}

TEST(Feather, ValuesOfEveryTypeComeBack) {
    const Table truth;
    for (const FeatherCodec codec : {FeatherCodec::none, FeatherCodec::lz4, FeatherCodec::zstd}) {
        for (const std::size_t rows_a_batch : {0, 3}) {
            const Feather table("table.feather", make_feather_bytes(truth.columns(), codec, rows_a_batch));
            ASSERT_EQ(table.row_count(), 7u);
            EXPECT_EQ(table.read_integers("wide"), truth.wide);
            EXPECT_EQ(table.read_numbers("narrow"), as_double(truth.narrow));
            EXPECT_EQ(table.read_numbers("middle"), as_double(truth.middle));
            EXPECT_EQ(table.read_integers("unsigned_wide")[0], 4294967295);
            EXPECT_EQ(table.read_numbers("f64"), truth.f64);
            EXPECT_EQ(table.read_numbers("f32"), as_double(truth.f32));
            EXPECT_EQ(table.read_numbers("f16"), as_double(truth.f16));
            EXPECT_EQ(table.read_texts("text"), truth.text);
            EXPECT_EQ(table.read_texts("word"), truth.text);
        }
    }
}

TEST(Feather, CompressibleColumnsAreBounded) {
    // zstd compresses 160 kB of zeros to about 20 bytes. A file with only this column
    // would exceed the limit on plausible sizes, so the valid file has a second column.
    const std::vector<double> zeros(20000, 0.0);
    std::vector<std::int64_t> noise;
    for (std::int64_t i = 0; i < 20000; ++i) noise.push_back(i * 7919 % 20011);
    const std::vector<FeatherColumn> both{test::make_numbers("zeros", zeros),
                                          test::make_numbers("noise", noise)};
    EXPECT_EQ(Feather("both", make_feather_bytes(both, FeatherCodec::zstd)).read_numbers("zeros"), zeros);
    const auto nothing_else = make_feather_bytes(
        {test::make_numbers("zeros", std::vector<double>(200000, 0.0))}, FeatherCodec::zstd);
    EXPECT_THROW(Feather("zeros", nothing_else), DataError);
}

TEST(Feather, SaysWhatIsWrong) {
    const auto expect = [](const std::string& bytes, const std::string& part, const auto& read) {
        try {
            read(Feather("table.feather", bytes));
            ADD_FAILURE() << "no failure, expected " << part;
        } catch (const DataError& error) {
            EXPECT_THAT(error.what(), test::Names("table.feather"));
            EXPECT_THAT(error.what(), test::Names(part));
            EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
        }
    };
    const auto only_open = [](const Feather&) {};
    const std::string good = make_feather_bytes(Table().columns());
    expect("", "0 ... begin ... ARROW1", only_open);
    expect("FEA1" + std::string(100, '\0') + "FEA1", "108 ... begin ... ARROW1", only_open);
    expect(good.substr(0, good.size() - 1), "end ... ARROW1", only_open);
    std::string bad = good;
    bad[bad.size() - 7] = '\x7f';  // length of the footer
    expect(bad, "footer", only_open);
    expect(good, "'wider' ... 'wide, narrow", [](const Feather& t) { t.read_numbers("wider"); });
    expect(good, "column 'text' ... text", [](const Feather& t) { t.read_numbers("text"); });
    expect(good, "column 'f64' ... numbers", [](const Feather& t) { t.read_texts("f64"); });
    expect(good, "column 'f64' ... integers", [](const Feather& t) { t.read_integers("f64"); });
    const std::string nan =
        make_feather_bytes({test::make_numbers("x", std::vector<double>{1.0, std::nan("")})});
    expect(nan, "column 'x': row 1 ... nan", [](const Feather& t) { t.read_numbers("x"); });
    const std::string large =
        make_feather_bytes({test::make_numbers("x", std::vector<std::uint64_t>{1, 1ull << 63})});
    expect(large, "column 'x' ... 9223372036854775808", [](const Feather& t) { t.read_integers("x"); });
}

TEST(Feather, DamagedBytesAreErrorsOrOtherValues) {
    for (const FeatherCodec codec : {FeatherCodec::none, FeatherCodec::lz4, FeatherCodec::zstd}) {
        const std::string good =
            make_feather_bytes({test::make_numbers("x", std::vector<std::int64_t>(40, 7)),
                                test::make_texts("t", std::vector<std::string>(40, "car"), true),
                                test::make_texts("u", std::vector<std::string>(40, "bus"))},
                               codec);
        std::size_t refused = 0;
        for (std::size_t i = 0; i < good.size(); ++i) {
            std::string bad = good;
            bad[i] = char(bad[i] ^ "\x01\x80\xff"[i % 3]);
            try {
                const Feather table("table.feather", bad);
                table.read_integers("x");
                for (const char* name : {"t", "u"}) table.read_texts(name);
            } catch (const DataError&) {
                ++refused;
            }
        }
        EXPECT_GT(refused, good.size() / 6);
    }
}

TEST(Feather, ReadsWhatPyarrowWrote) {
    const char* shared = std::getenv("RELIDAR_SHARED");
    const fs::path folder =
        (shared ? fs::path(shared) : fs::path(RELIDAR_SOURCE_DIR).parent_path() / "shared") / "data" /
        "fixtures";
    if (!fs::exists(folder / "av2.npz"))
        GTEST_SKIP() << folder << " is not there; RELIDAR_SHARED names another folder";
    const std::vector<NamedArray> truth = read_npz(folder / "av2.npz");
    ASSERT_EQ(truth.size(), 6u);
    for (const char* file : {"av2_uncompressed.feather", "av2_lz4.feather", "av2_zstd.feather"}) {
        const Feather table(folder / file);
        EXPECT_EQ(table.row_count(), 5000u);
        for (const NamedArray& array : truth) {
            if (array.name == "offset_ns") {  // more digits than a float has
                std::vector<std::int32_t> expected(5000);
                ASSERT_EQ(array.bytes.size(), 4 * expected.size());
                std::memcpy(expected.data(), array.bytes.data(), array.bytes.size());
                EXPECT_EQ(table.read_integers(array.name),
                          std::vector<std::int64_t>(expected.begin(), expected.end()))
                    << file;
            } else {
                EXPECT_EQ(table.read_numbers(array.name), as_double(array.to_floats()))
                    << file << " " << array.name;
            }
        }
    }
}

}  // namespace
}  // namespace relidar
