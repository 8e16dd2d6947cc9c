// SPDX-License-Identifier: Apache-2.0
// Error messages for invalid files, folders, texts and names.
#include "base/files.hpp"

#include <cstdlib>

#include <unistd.h>

#include <relidar/base/error.hpp>
#include "base/codecs/temporary_folder.hpp"
#include "base/toml_depth.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

/// Switches to the user "nobody" if the test runs as root, because permissions do not
/// apply to root.
struct Nobody {
    Nobody() : root(::geteuid() == 0) {
        if (root && ::seteuid(65534) != 0) std::abort();
    }
    ~Nobody() {
        if (root && ::seteuid(0) != 0) std::abort();
    }
    bool root;
};

using Files = TemporaryFolder;

TEST_F(Files, WhatCannotBeReadIsToldApartFromWhatIsMissing) {
    const fs::path locked = folder / "locked", loop = folder / "loop", file = folder / "file",
                   long_name = folder / std::string(300, 'x');
    fs::create_directory(locked);
    fs::permissions(locked, fs::perms::none);
    fs::create_symlink(loop, loop);
    put(file, "x");
    fs::permissions(file, fs::perms::none);
    fs::permissions(folder, fs::perms::all);
    const Nobody nobody;
    for (const auto& read :
         {std::function<void(const fs::path&)>([](const fs::path& p) { read_file(p); }),
          std::function<void(const fs::path&)>([](const fs::path& p) { list_folder(p); }),
          std::function<void(const fs::path&)>([](const fs::path& p) { does_path_exist(p); })}) {
        EXPECT_THAT(get_data_error_message([&] { read(locked / "inside"); }),
                    test::Names("inside: Permission denied"));
        EXPECT_THAT(get_data_error_message([&] { read(loop); }), test::Names("loop: Too many levels"));
        EXPECT_THAT(get_data_error_message([&] { read(long_name); }), test::Names("File name too long"));
    }
    EXPECT_THAT(get_data_error_message([&] { read_file(file); }), test::Names("file: Permission denied"));
    EXPECT_THAT(get_data_error_message([&] { list_folder(locked); }),
                test::Names("locked: Permission denied"));
    EXPECT_THAT(get_data_error_message([&] { read_file(folder / "nothing"); }), test::Names("nothing"));
    EXPECT_THAT(get_data_error_message([&] { list_folder(folder / "nothing"); }), test::Names("nothing"));
    EXPECT_THAT(get_data_error_message([&] { read_file(folder); }), test::Names("file"));
    EXPECT_FALSE(does_path_exist(folder / "nothing"));
    EXPECT_FALSE(does_path_exist(file / "below"));
    EXPECT_TRUE(does_path_exist(file));
}

TEST_F(Files, AByteOrderMarkIsNoText) {
    put(folder / "excel.csv", "\xEF\xBB\xBFx,y\n");
    put(folder / "unicode.csv", std::string("\xFF\xFEx\0", 4));
    EXPECT_EQ(read_text_file(folder / "excel.csv"), "x,y\n");
    EXPECT_EQ(read_file(folder / "excel.csv").size(), 7u) << "bytes stay as they are";
    EXPECT_THAT(get_data_error_message([&] { read_text_file(folder / "unicode.csv"); }),
                test::Names("UTF-16 ... UTF-8"));
}

TEST_F(Files, NumbersInNames) {
    EXPECT_EQ(parse_stem("0000000012"), 12);
    EXPECT_EQ(parse_stem("00000000000000000007"), 7);
    EXPECT_EQ(parse_stem("99999999"), 99999999);
    for (const char* none : {"", "100000000", "9999999999", "nan", "1e3", "-1", "1.5", " 1"})
        EXPECT_FALSE(parse_stem(none)) << none;
}

TEST_F(Files, ExcerptsAreShortAndPrintable) {
    EXPECT_EQ(quote("a\tb\n"), "a?b?");
    EXPECT_EQ(quote(std::string(80, 'x')), std::string(80, 'x'));
    EXPECT_EQ(quote(std::string(1 << 20, 'x')), std::string(77, 'x') + "...");
    // must not cut a multi-byte character
    EXPECT_EQ(quote(std::string(76, 'x') + "\u00e9" + std::string(9, 'x')), std::string(76, 'x') + "...");
}

TEST(TomlDepth, DeepKeysAreRefused) {
    std::string dots = "a";
    for (int i = 0; i < 40000; ++i) dots += ".a";
    for (const std::string& line : {dots + " = 1", "[" + dots + "]", "a = {" + dots + " = 1}"})
        EXPECT_THAT(get_data_error_message([&] { check_toml_depth("x = 1\n" + line + "\n", "f.toml"); }),
                    test::Names("f.toml:2"));
    EXPECT_NO_THROW(
        check_toml_depth("c.d.e.f.g.h.i.j = 1.5\nl = [1.5, 2.5, 3.5, 4.5, 5.5, 6.5]\n", "f.toml"));
}

const std::vector<std::string> kPresets{"paper", "released", "default", "quick"};

TEST(DidYouMean, NamesWhatIsSpelledAlmostAlike) {
    EXPECT_THAT(did_you_mean("quik", kPresets), test::Names("quick"));
    EXPECT_THAT(did_you_mean("PAPR", kPresets, "'"), test::Names("'paper'"));
    EXPECT_THAT(did_you_mean("trian", {"render", "train"}), test::Names("train"));
    EXPECT_THAT(did_you_mean("maen", {"sh", "mean"}), test::Names("mean"));
    EXPECT_THAT(did_you_mean("defualt", kPresets, "\""), test::Names("\"default\""));
    EXPECT_THAT(did_you_mean("iterations", {"train.iterations", "train.interval"}),
                test::Names("train.iterations"));
    EXPECT_THAT(did_you_mean("azimuth_ofset_deg", {"azimuth", "azimuth_offset_deg"}),
                test::Names("azimuth_offset_deg"));
}

TEST(DidYouMean, SaysNothingWhereNothingResembles) {
    EXPECT_EQ(did_you_mean("fast", kPresets), "");
    EXPECT_EQ(did_you_mean("fast", kPresets, "", ", expected a preset"), ", expected a preset");
    EXPECT_EQ(did_you_mean("", kPresets), "");
    EXPECT_EQ(did_you_mean("quick", {}), "");
}

}  // namespace
}  // namespace relidar
