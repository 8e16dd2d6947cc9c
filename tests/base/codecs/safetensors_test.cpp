// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/arrays.hpp>

#include <algorithm>
#include <cstring>

#include "temporary_folder.hpp"

namespace relidar {
namespace {

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
