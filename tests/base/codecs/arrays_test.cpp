// SPDX-License-Identifier: Apache-2.0
// Every truncation and every changed byte must give equal values or a DataError.
#include <relidar/base/arrays.hpp>

#include <algorithm>
#include <cstring>

#include "temporary_folder.hpp"

namespace relidar {
namespace {

/// Returns the path of a file that numpy 1.24.2 wrote. stored.npz and deflated.npz have
/// values f4 [2,3] = 0 0.5 1 1.5 2 2.5, mask b1 [3] = 1 0 1, frame i8 [] = -7, and wide
/// f8 [2] = 1.5 -2.25. numpy writes zip64 fields into every local header.
std::filesystem::path numpy_file(const std::string& name) {
    return std::string(RELIDAR_SOURCE_DIR) + "/tests/base/codecs/numpy/" + name + ".npz";
}

using Npz = TemporaryFolder;

void expect_equal(const NamedArray& first, const NamedArray& second) {
    EXPECT_EQ(first.name, second.name);
    EXPECT_EQ(first.dtype, second.dtype);
    EXPECT_EQ(first.shape, second.shape);
    EXPECT_EQ(first.bytes, second.bytes);
}

NamedArray make_bytes_array(std::string name, std::string dtype, std::vector<std::size_t> shape,
                            std::size_t n_bytes) {
    NamedArray array{std::move(name), std::move(dtype), std::move(shape), std::vector<std::byte>(n_bytes)};
    for (std::size_t i = 0; i < n_bytes; ++i) array.bytes[i] = std::byte(i * 37 % 251);
    return array;
}

std::vector<NamedArray> make_one_array_per_type() {
    std::vector<NamedArray> arrays;
    for (const char* dtype : {"f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8", "f2", "b1"})
        arrays.push_back(
            make_bytes_array(std::string("of_") + dtype, dtype, {3, 2}, 6 * std::size_t(dtype[1] - '0')));
    arrays.push_back(make_bytes_array("scalar", "f8", {}, 8));
    arrays.push_back(make_bytes_array("empty", "f4", {0, 7}, 0));
    arrays.push_back(make_bytes_array("flat", "i4", {5}, 20));
    arrays.push_back(make_bytes_array("large", "f4", {100'000}, 400'000));
    return arrays;
}

TEST_F(Npz, RoundTripsEveryType) {
    const std::vector<NamedArray> arrays = make_one_array_per_type();
    write_npz(folder / "a.npz", arrays);
    const std::vector<NamedArray> read = read_npz(folder / "a.npz");
    ASSERT_EQ(read.size(), arrays.size());
    for (std::size_t i = 0; i < read.size(); ++i) expect_equal(read[i], arrays[i]);
}

TEST_F(Npz, EqualArraysMakeEqualFiles) {
    write_npz(folder / "a.npz", make_one_array_per_type());
    write_npz(folder / "b.npz", make_one_array_per_type());
    EXPECT_EQ(read_contents(folder / "a.npz"), read_contents(folder / "b.npz"));
}

TEST_F(Npz, ReadsWhatNumpyWrites) {
    for (const char* file : {"stored", "deflated"}) {
        const std::vector<NamedArray> arrays = read_npz(numpy_file(file));
        ASSERT_EQ(arrays.size(), 4u);
        EXPECT_EQ(arrays[0].name, "values");
        EXPECT_EQ(arrays[0].shape, (std::vector<std::size_t>{2, 3}));
        EXPECT_EQ(arrays[0].to_floats(), (std::vector<float>{0, 0.5f, 1, 1.5f, 2, 2.5f}));
        EXPECT_EQ(arrays[1].dtype, "b1");
        EXPECT_EQ(arrays[1].to_floats(), (std::vector<float>{1, 0, 1}));
        EXPECT_EQ(arrays[2].dtype, "i8");
        EXPECT_TRUE(arrays[2].shape.empty());
        EXPECT_EQ(arrays[2].to_floats(), std::vector<float>{-7});
        EXPECT_EQ(arrays[3].to_floats(), (std::vector<float>{1.5f, -2.25f}));
    }
}

TEST_F(Npz, RefusesWhatItCannotHold) {
    const std::string refusal = get_data_error_message([] { read_npz(numpy_file("big_endian")); });
    EXPECT_NE(refusal.find("little-endian"), std::string::npos);
    EXPECT_NE(refusal.find("values.npy"), std::string::npos);
}

TEST_F(Npz, ReadsFortranOrder) {
    const NamedArray values = read_npz(numpy_file("fortran")).at(0);  // [[0, 1, 2], [3, 4, 5]]
    EXPECT_EQ(values.shape, (std::vector<std::size_t>{2, 3}));
    EXPECT_EQ(values.to_floats(), (std::vector<float>{0, 1, 2, 3, 4, 5}));
}

TEST_F(Npz, ReadsTextsOfNumpy) {
    const NamedArray texts = read_npz(numpy_file("text")).at(0);
    EXPECT_EQ(texts.dtype, "U2");
    EXPECT_EQ(texts.bytes.size(), texts.element_count() * 2 * sizeof(char32_t));
}

TEST_F(Npz, NamesMissingAndForeignFiles) {
    EXPECT_NE(get_data_error_message([&] { read_npz(folder / "none.npz"); }).find("none.npz"),
              std::string::npos);
    get_data_error_message([&] { read_npz(folder); });
    for (const char* text : {"", "not a zip", "PK\x05\x06"}) {
        put(folder / "a.npz", text);
        EXPECT_NE(get_data_error_message([&] { read_npz(folder / "a.npz"); }).find("a.npz"),
                  std::string::npos);
    }
}

TEST_F(Npz, RefusesEveryCut) {
    for (const char* file : {"stored", "deflated"}) {
        const std::string file_bytes = read_contents(numpy_file(file));
        for (std::size_t n = 0; n < file_bytes.size(); ++n) {
            SCOPED_TRACE(n);
            put(folder / "cut.npz", file_bytes.substr(0, n));
            get_data_error_message([&] { read_npz(folder / "cut.npz"); });
        }
    }
}

TEST_F(Npz, SurvivesEveryChangedByte) {
    const std::string file_bytes = read_contents(numpy_file("deflated"));
    int n_refused = 0;
    for (std::size_t i = 0; i < file_bytes.size(); ++i)
        for (int change : {0x01, 0x80, 0xFF}) {
            std::string changed = file_bytes;
            changed[i] = char(changed[i] ^ change);
            put(folder / "changed.npz", changed);
            try {
                // the changed byte is in a field that the reader ignores, such as a date
                EXPECT_EQ(read_npz(folder / "changed.npz").size(), 4u) << i;
            } catch (const DataError&) {
                ++n_refused;
            }
        }
    EXPECT_GT(n_refused, int(file_bytes.size()));
}

TEST_F(Npz, RefusesBadArrays) {
    const NamedArray good = make_bytes_array("a", "f4", {2}, 8);
    NamedArray short_of_bytes = good, unknown = good, nameless = good;
    short_of_bytes.shape = {3};
    unknown.dtype = "c8";
    nameless.name.clear();
    for (const std::vector<NamedArray>& arrays :
         {{}, {short_of_bytes}, {unknown}, {nameless}, std::vector{good, good}})
        get_data_error_message([&] { write_npz(folder / "a.npz", arrays); });
    EXPECT_TRUE(files().empty());
}

TEST(NamedArray, ChecksItsShape) {
    const float values[6] = {};
    EXPECT_EQ(make_array("a", {2, 3}, values, 6).element_count(), 6u);
    get_data_error_message([&] { make_array("a", {2, 2}, values, 6); });
    const std::size_t huge = std::size_t(1) << 33;
    get_data_error_message([&] { (void)NamedArray{"a", "f4", {huge, huge}, {}}.element_count(); });
    EXPECT_EQ((NamedArray{"a", "f4", {huge, huge, 0}, {}}.element_count()), 0u);
}

TEST(NamedArray, ConvertsToFloat) {
    const double doubles[2] = {0.25, -3.0};
    const std::int32_t integers[2] = {-5, 1 << 20};
    EXPECT_EQ(make_array("a", {2}, doubles, 2).to_floats(), (std::vector<float>{0.25f, -3.0f}));
    EXPECT_EQ(make_array("a", {2}, integers, 2).to_floats(), (std::vector<float>{-5.0f, 1048576.0f}));
    NamedArray half = make_bytes_array("a", "f2", {7}, 14);
    // IEEE 754 binary16
    const std::uint16_t bits[7] = {0x3c00, 0xc000, 0x3555, 0x0001, 0x83ff, 0x7bff, 0xfc00};
    std::memcpy(half.bytes.data(), bits, sizeof bits);
    EXPECT_EQ(half.to_floats(),
              (std::vector<float>{1.0f, -2.0f, 0.333251953125f, 0x1p-24f, -1023.0f * 0x1p-24f, 65504.0f,
                                  -std::numeric_limits<float>::infinity()}));
    get_data_error_message([] { (void)make_bytes_array("a", "f4", {2}, 7).to_floats(); });
}

TEST_F(Npz, TextsComeBackPadded) {
    // invalid UTF-8: a lead byte without continuation, a surrogate, and a truncated
    // character
    const std::string broken = "a\xC3(\xED\xA0\x80\xF0\x9F";
    write_npz(folder / "a.npz", {make_text_array("names", {"Fußgänger", "", "车\U0001F697", broken}),
                                 make_text_array("none", {})});
    const std::vector<NamedArray> arrays = read_npz(folder / "a.npz");
    EXPECT_EQ(arrays[0].dtype, "U9");
    EXPECT_EQ(arrays[0].shape, std::vector<std::size_t>{4});
    std::u32string letters(4 * 9, U' ');
    ASSERT_EQ(arrays[0].bytes.size(), letters.size() * sizeof(char32_t));
    std::memcpy(letters.data(), arrays[0].bytes.data(), arrays[0].bytes.size());
    const std::u32string zeros(9, U'\0'), unreadable = U"a\uFFFD(\uFFFD\uFFFD\uFFFD\uFFFD\uFFFD";
    EXPECT_EQ(letters, U"Fußgänger" + zeros + U"车\U0001F697" + zeros.substr(2) + unreadable +
                           zeros.substr(unreadable.size()));
    EXPECT_EQ(arrays[1].shape, std::vector<std::size_t>{0});
    get_data_error_message([&] { arrays[0].to_floats(); });
    get_data_error_message([&] { write_safetensors(folder / "a.safetensors", {arrays[0]}, {}); });
    get_data_error_message([&] { write_npz(folder / "b.npz", {{"x", "S4x", {0}, {}}}); });
}

using Safetensors = TemporaryFolder;

std::string file_of(const std::string& header, const std::string& data) {
    const std::uint64_t size = header.size();
    std::string bytes(sizeof size, '\0');
    std::memcpy(bytes.data(), &size, sizeof size);
    return bytes + header + data;
}

std::vector<NamedArray> make_example_arrays() {
    const float mean[6] = {1, 2, 3, -4, 5.5f, 6};
    const double exact[1] = {0.1};
    const std::int32_t ids[3] = {7, -8, 9};
    NamedArray mask{"mask", "b1", {2}, {std::byte(1), std::byte(0)}};
    return {mask, make_array("z_first", {2, 3}, mean, 6), make_array("exact", {}, exact, 1),
            make_array("none", {0, 3}, mean, 0), make_array("a_last \"quoted\" \xC3\xA9", {3}, ids, 3)};
}

TEST_F(Safetensors, RoundTrips) {
    const std::vector<NamedArray> arrays = make_example_arrays();
    const std::map<std::string, std::string> metadata{{"format", "relidar"}, {"step", "30000"}};
    write_safetensors(folder / "a.safetensors", arrays, metadata);
    std::map<std::string, std::string> read_metadata;
    const std::vector<NamedArray> read = read_safetensors(folder / "a.safetensors", &read_metadata);
    EXPECT_EQ(read_metadata, metadata);
    ASSERT_EQ(read.size(), arrays.size());
    for (const NamedArray& array : arrays) {
        const auto it = std::find_if(read.begin(), read.end(),
                                     [&](const NamedArray& other) { return other.name == array.name; });
        ASSERT_NE(it, read.end()) << array.name;
        EXPECT_EQ(it->dtype, array.dtype);
        EXPECT_EQ(it->shape, array.shape);
        EXPECT_EQ(it->bytes, array.bytes);
    }
    // arrays must be in the order of the data, not in alphabetical order
    EXPECT_EQ(read[0].name, "mask");
    EXPECT_EQ(read[1].name, "z_first");
}

TEST_F(Safetensors, WritesTheDocumentedLayout) {
    const float values[2] = {1.0f, -2.0f};
    write_safetensors(folder / "a.safetensors", {make_array("w", {2, 1}, values, 2)}, {{"k", "v"}});
    const std::string file = read_contents(folder / "a.safetensors");
    std::string header =
        R"({"__metadata__":{"k":"v"},"w":{"dtype":"F32","shape":[2,1],"data_offsets":[0,8]}})";
    header.resize((header.size() + 7) / 8 * 8, ' ');
    EXPECT_EQ(file, file_of(header, std::string("\0\0\x80\x3f\0\0\0\xc0", 8)));
}

TEST_F(Safetensors, RefusesEveryCut) {
    write_safetensors(folder / "a.safetensors", make_example_arrays(), {{"k", "v"}});
    const std::string file_bytes = read_contents(folder / "a.safetensors");
    for (std::size_t n = 0; n < file_bytes.size(); ++n) {
        SCOPED_TRACE(n);
        put(folder / "cut", file_bytes.substr(0, n));
        EXPECT_NE(get_data_error_message([&] { read_safetensors(folder / "cut"); }).find("cut"),
                  std::string::npos);
    }
    put(folder / "cut", file_bytes + "x");
    get_data_error_message([&] { read_safetensors(folder / "cut"); });
}

TEST_F(Safetensors, SurvivesEveryChangedByte) {
    write_safetensors(folder / "a.safetensors", make_example_arrays(), {{"k", "v"}});
    const std::string file_bytes = read_contents(folder / "a.safetensors");
    for (std::size_t i = 0; i < file_bytes.size(); ++i)
        for (int change : {0x01, 0x20, 0x80, 0xFF}) {
            std::string changed = file_bytes;
            changed[i] = char(changed[i] ^ change);
            put(folder / "changed", changed);
            try {
                (void)read_safetensors(folder / "changed");
            } catch (const DataError&) {  // any other exception fails the test
            }
        }
}

TEST_F(Safetensors, RefusesHeadersThatDoNotHold) {
    const std::string data(8, 'x');
    const auto refused = [&](const std::string& header) {
        put(folder / "bad", file_of(header, data));
        EXPECT_FALSE(get_data_error_message([&] { read_safetensors(folder / "bad"); }).empty()) << header;
    };
    const auto entry = [](const char* dtype, const char* shape, const char* offsets) {
        return std::string(R"({"dtype":")") + dtype + R"(","shape":)" + shape + R"(,"data_offsets":)" +
               offsets + "}";
    };
    put(folder / "good", file_of("{\"a\":" + entry("F32", "[2]", "[0,8]") + "}", data));
    EXPECT_EQ(read_safetensors(folder / "good").size(), 1u);

    refused("");
    refused("[]");
    refused("{");
    refused("{\"a\":1}");
    refused("{\"a\":{}}");
    refused("{}");  // 8 bytes that belong to no array
    refused("{\"a\":" + entry("F33", "[2]", "[0,8]") + "}");
    refused("{\"a\":" + entry("F32", "[3]", "[0,8]") + "}");   // wrong size
    refused("{\"a\":" + entry("F32", "[2]", "[4,12]") + "}");  // beyond the end
    refused("{\"a\":" + entry("F32", "[2]", "[8,0]") + "}");
    refused("{\"a\":" + entry("F32", "[-2]", "[0,8]") + "}");
    refused("{\"a\":" + entry("F32", "[2.0]", "[0,8]") + "}");
    refused("{\"a\":" + entry("F32", "2", "[0,8]") + "}");
    refused("{\"a\":" + entry("F32", "[2]", "[0]") + "}");
    // the product overflows
    refused("{\"a\":" + entry("F32", "[4611686018427387904,4,2]", "[0,8]") + "}");
    refused("{\"a\":" + entry("F32", "[18446744073709551616]", "[0,8]") + "}");
    refused("{\"a\":" + entry("F32", "[1]", "[0,4]") + "}");  // gap at the end
    refused("{\"a\":" + entry("F32", "[1]", "[4,8]") + "}");  // gap at the start
    // overlap
    refused("{\"a\":" + entry("F32", "[2]", "[0,8]") + ",\"b\":" + entry("F32", "[1]", "[4,8]") + "}");
    // duplicate name
    refused("{\"a\":" + entry("F32", "[2]", "[0,8]") + ",\"a\":" + entry("F32", "[2]", "[0,8]") + "}");
    refused("{\"a\":" + entry("F32", "[2]", "[0,8]") + ",\"b\":" + entry("F32", "[0]", "[8,8]") +
            ",\"b\":" + entry("F32", "[0]", "[8,8]") + "}");
    refused("{\"__metadata__\":{\"k\":1},\"a\":" + entry("F32", "[2]", "[0,8]") + "}");
    refused("{\"__metadata__\":3,\"a\":" + entry("F32", "[2]", "[0,8]") + "}");
}

// Reads many arrays quickly. A JSON parser that compares each new name with all earlier
// names would need quadratic time.
TEST_F(Safetensors, ReadsManyArraysInTheOrderOfTheFile) {
    std::string header = "{";
    constexpr int kArrays = 25000;
    for (int i = kArrays; i > 0; --i)
        header += "\"" + std::to_string(i) + R"(":{"dtype":"F32","shape":[0],"data_offsets":[0,0]})" +
                  (i > 1 ? "," : "}");
    put(folder / "many", file_of(header, ""));
    const std::vector<NamedArray> arrays = read_safetensors(folder / "many");
    ASSERT_EQ(arrays.size(), std::size_t(kArrays));
    EXPECT_EQ(arrays.front().name, "25000");
    EXPECT_EQ(arrays.back().name, "1");
}

TEST_F(Safetensors, RefusesAbsurdHeaderSizes) {
    for (std::uint64_t size :
         {std::uint64_t(4 << 20) + 1, std::uint64_t(1) << 30, ~std::uint64_t(0), ~std::uint64_t(0) - 7}) {
        std::string file = file_of("{}", "");
        std::memcpy(file.data(), &size, sizeof size);
        put(folder / "bad", file);
        get_data_error_message([&] { read_safetensors(folder / "bad"); });
    }
}

TEST_F(Safetensors, RefusesBadArrays) {
    const float values[2] = {};
    const NamedArray good = make_array("a", {2}, values, 2);
    NamedArray reserved = good, latin1 = good;
    reserved.name = "__metadata__";
    latin1.name = "caf\xE9";  // invalid, because JSON is UTF-8
    for (const std::vector<NamedArray>& arrays : {std::vector{good, good}, {reserved}, {latin1}})
        get_data_error_message([&] { write_safetensors(folder / "a", arrays, {}); });
    EXPECT_TRUE(files().empty());
}

}  // namespace
}  // namespace relidar
