// SPDX-License-Identifier: Apache-2.0
// Every truncation and every changed byte must give equal values or a DataError.
#include <relidar/base/arrays.hpp>

#include <cstring>

#include "temporary_folder.hpp"

namespace relidar {
namespace {

// npz files that numpy 1.24.2 wrote, in hexadecimal. The values are f4 [2,3] = 0
// 0.5 1 1.5 2 2.5, mask b1 [3] = 1 0 1, frame i8 [] = -7, and wide f8 [2] = 1.5 -2.25.
// Three further files must be rejected. numpy writes zip64 fields into every local
// header.
constexpr std::string_view kNumpyStored =
    "504b0304140000000000000021000bc0b07698000000980000000a00140076616c7565732e6e7079010010009800000000000000"
    "9800000000000000934e554d5059010076007b276465736372273a20273c6634272c2027666f727472616e5f6f72646572273a20"
    "46616c73652c20277368617065273a2028322c2033292c207d202020202020202020202020202020202020202020202020202020"
    "202020202020202020202020202020202020202020202020202020202020200a000000000000003f0000803f0000c03f00000040"
    "00002040504b03041400000000000000210016938cbb8300000083000000080014006d61736b2e6e707901001000830000000000"
    "00008300000000000000934e554d5059010076007b276465736372273a20277c6231272c2027666f727472616e5f6f7264657227"
    "3a2046616c73652c20277368617065273a2028332c292c207d202020202020202020202020202020202020202020202020202020"
    "2020202020202020202020202020202020202020202020202020202020202020200a010001504b030414000000000000002100c8"
    "b83ce48800000088000000090014006672616d652e6e70790100100088000000000000008800000000000000934e554d50590100"
    "76007b276465736372273a20273c6938272c2027666f727472616e5f6f72646572273a2046616c73652c20277368617065273a20"
    "28292c207d2020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020"
    "2020202020202020202020202020200af9ffffffffffffff504b03041400000000000000210032faf37390000000900000000800"
    "1400776964652e6e70790100100090000000000000009000000000000000934e554d5059010076007b276465736372273a20273c"
    "6638272c2027666f727472616e5f6f72646572273a2046616c73652c20277368617065273a2028322c292c207d20202020202020"
    "20202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020202020"
    "200a000000000000f83f00000000000002c0504b01021403140000000000000021000bc0b07698000000980000000a0000000000"
    "00000000000080010000000076616c7565732e6e7079504b010214031400000000000000210016938cbb83000000830000000800"
    "000000000000000000008001d40000006d61736b2e6e7079504b0102140314000000000000002100c8b83ce48800000088000000"
    "0900000000000000000000008001910100006672616d652e6e7079504b010214031400000000000000210032faf3739000000090"
    "000000080000000000000000000000800154020000776964652e6e7079504b05060000000004000400db0000001e0300000000";

constexpr std::string_view kNumpyDeflated =
    "504b0304140000000800000021000bc0b07657000000980000000a00140076616c7565732e6e7079010010009800000000000000"
    "57000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e9366a2aea3a09e965f54529498179f5f94920a12774b"
    "cc294e058a17672416a402f91a463a0ac69a3a0ab50a64032e0608b067606800e20340cce0c0c0a0e00000504b03041400000008"
    "000000210016938cbb4700000083000000080014006d61736b2e6e707901001000830000000000000047000000000000009bec17"
    "ea1b10c9c850c650ad9e925a9c5ca46ea5a05e9364a8aea3a09e965f54529498179f5f94920a12774bcc294e058a17672416a402"
    "f91ac63a9a3a0ab50a14002e46064600504b030414000000080000002100c8b83ce44600000088000000090014006672616d652e"
    "6e707901001000880000000000000046000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e9369a1aea3a09e"
    "965f54529498179f5f94920a12774bcc294e058a17672416a402f91a9a3a0ab50a1401ae9fff210000504b030414000000080000"
    "00210032faf3734d0000009000000008001400776964652e6e70790100100090000000000000004d000000000000009bec17ea1b"
    "10c9c850c650ad9e925a9c5ca46ea5a06e9366a1aea3a09e965f54529498179f5f94920a12774bcc294e058a17672416a402f91a"
    "463a9a3a0ab50a14002e0630f8610fa1990e0000504b01021403140000000800000021000bc0b07657000000980000000a000000"
    "000000000000000080010000000076616c7565732e6e7079504b010214031400000008000000210016938cbb4700000083000000"
    "0800000000000000000000008001930000006d61736b2e6e7079504b0102140314000000080000002100c8b83ce4460000008800"
    "00000900000000000000000000008001140100006672616d652e6e7079504b010214031400000008000000210032faf3734d0000"
    "0090000000080000000000000000000000800195010000776964652e6e7079504b05060000000004000400db0000001c02000000"
    "00";

constexpr std::string_view kNumpyFortran =
    "504b030414000000080000002100ce2ce0d356000000980000000a00140076616c7565732e6e7079010010009800000000000000"
    "56000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e9366a2aea3a09e965f54529498179f5f94920a120f29"
    "2a4d050a17672416a402b91a463a0ac69a3a0ab50ae4032e06307070606068b007620710878161810300504b0102140314000000"
    "080000002100ce2ce0d356000000980000000a000000000000000000000080010000000076616c7565732e6e7079504b05060000"
    "00000100010038000000920000000000";

constexpr std::string_view kNumpyBigEndian =
    "504b0304140000000800000021002ba970824d0000008c0000000a00140076616c7565732e6e7079010010008c00000000000000"
    "4d000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e9766a2aea3a09e965f54529498179f5f94920a12774b"
    "cc294e058a17672416a402f91ac63a9a3a0ab50a14002e0620b06f60607000d200504b01021403140000000800000021002ba970"
    "824d0000008c0000000a000000000000000000000080010000000076616c7565732e6e7079504b05060000000001000100380000"
    "00890000000000";

constexpr std::string_view kNumpyText =
    "504b03041400000008000000210070476d964d000000900000000a00140076616c7565732e6e7079010010009000000000000000"
    "4d000000000000009bec17ea1b10c9c850c650ad9e925a9c5ca46ea5a06e136aa4aea3a09e965f54529498179f5f94920a12774b"
    "cc294e058a17672416a402f91a463a9a3a0ab50a1400ae4406084802e264200600504b010214031400000008000000210070476d"
    "964d000000900000000a000000000000000000000080010000000076616c7565732e6e7079504b05060000000001000100380000"
    "00890000000000";

using Npz = TemporaryFolder;

std::string from_hex(std::string_view text) {
    std::string bytes;
    for (std::size_t i = 0; i < text.size(); i += 2)
        bytes += char(std::stoi(std::string(text.substr(i, 2)), nullptr, 16));
    return bytes;
}

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
    for (std::string_view file : {kNumpyStored, kNumpyDeflated}) {
        put(folder / "numpy.npz", from_hex(file));
        const std::vector<NamedArray> arrays = read_npz(folder / "numpy.npz");
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
    const auto refusal = [&](std::string_view file) {
        put(folder / "numpy.npz", from_hex(file));
        return get_data_error_message([&] { read_npz(folder / "numpy.npz"); });
    };
    EXPECT_NE(refusal(kNumpyBigEndian).find("little-endian"), std::string::npos);
    EXPECT_NE(refusal(kNumpyBigEndian).find("values.npy"), std::string::npos);
}

TEST_F(Npz, ReadsFortranOrder) {
    put(folder / "numpy.npz", from_hex(kNumpyFortran));  // [[0, 1, 2], [3, 4, 5]]
    const NamedArray values = read_npz(folder / "numpy.npz").at(0);
    EXPECT_EQ(values.shape, (std::vector<std::size_t>{2, 3}));
    EXPECT_EQ(values.to_floats(), (std::vector<float>{0, 1, 2, 3, 4, 5}));
}

TEST_F(Npz, ReadsTextsOfNumpy) {
    put(folder / "numpy.npz", from_hex(kNumpyText));
    const NamedArray texts = read_npz(folder / "numpy.npz").at(0);
    EXPECT_EQ(texts.dtype, "U2");
    EXPECT_EQ(texts.bytes.size(), texts.element_count() * 2 * sizeof(char32_t));
}

TEST_F(Npz, NamesMissingAndForeignFiles) {
    EXPECT_NE(get_data_error_message([&] { read_npz(folder / "none.npz"); }).find("No such file"),
              std::string::npos);
    get_data_error_message([&] { read_npz(folder); });
    for (const char* text : {"", "not a zip", "PK\x05\x06"}) {
        put(folder / "a.npz", text);
        EXPECT_NE(get_data_error_message([&] { read_npz(folder / "a.npz"); }).find("a.npz"),
                  std::string::npos);
    }
}

TEST_F(Npz, RefusesEveryCut) {
    for (std::string_view file : {kNumpyStored, kNumpyDeflated}) {
        const std::string file_bytes = from_hex(file);
        for (std::size_t n = 0; n < file_bytes.size(); ++n) {
            SCOPED_TRACE(n);
            put(folder / "cut.npz", file_bytes.substr(0, n));
            get_data_error_message([&] { read_npz(folder / "cut.npz"); });
        }
    }
}

TEST_F(Npz, SurvivesEveryChangedByte) {
    const std::string file_bytes = from_hex(kNumpyDeflated);
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

TEST_F(Npz, RefusesAbsurdSizes) {
    std::string file = from_hex(kNumpyDeflated);
    const std::size_t directory = file.find("PK\x01\x02");
    ASSERT_NE(directory, std::string::npos);
    const std::uint32_t absurd = 0xFFFFFFF0;
    // unpacked size of the first entry
    std::memcpy(file.data() + directory + 24, &absurd, sizeof absurd);
    put(folder / "a.npz", file);
    get_data_error_message([&] { read_npz(folder / "a.npz"); });
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

}  // namespace
}  // namespace relidar
