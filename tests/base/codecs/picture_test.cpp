// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/files.hpp>
#include <relidar/base/images.hpp>

#include <algorithm>
#include <csetjmp>

#include <png.h>

#include "temporary_folder.hpp"

namespace relidar {
namespace {

using Picture = TemporaryFolder;

TEST_F(Picture, ExrKeepsEveryBit) {
    // 37 is not a multiple of the 16 rows that OpenEXR compresses together
    constexpr int rows = 37, columns = 53;
    std::vector<float> range(rows * columns), intensity(rows * columns);
    for (std::size_t i = 0; i < range.size(); ++i) {
        range[i] = 80.0f * float(i * 2654435761u % 1009u) / 1009.0f;
        intensity[i] = -1.0f / float(i % 100 + 1);
    }
    range[0] = std::numeric_limits<float>::infinity();
    range[1] = std::numeric_limits<float>::denorm_min();
    write_exr(folder / "a.exr", rows, columns, {{"range_m", range}, {"intensity", intensity}},
              {{"sensor", "VLP-16"}, {"run", "über\nzwei"}});
    EXPECT_LT(std::filesystem::file_size(folder / "a.exr"), 2 * sizeof(float) * range.size()) << "compressed";
    const ExrImage image = read_exr(folder / "a.exr");
    EXPECT_EQ(image.rows, rows);
    EXPECT_EQ(image.columns, columns);
    EXPECT_EQ(image.channels.at("range_m"), range);
    EXPECT_EQ(image.channels.at("intensity"), intensity);
    EXPECT_EQ(image.notes.at("sensor"), "VLP-16");
    EXPECT_EQ(image.notes.at("run"), "über\nzwei");
}

TEST_F(Picture, ExrRefusesWrongSizes) {
    get_data_error_message([&] { write_exr(folder / "a.exr", 2, 2, {{"range_m", std::vector<float>(3)}}); });
    get_data_error_message([&] { write_exr(folder / "a.exr", 2, 2, {}); });
    get_data_error_message([&] { write_exr(folder / "a.exr", 0, 2, {{"range_m", {}}}); });
    EXPECT_TRUE(files().empty());
}

Image read_png(const std::vector<std::uint8_t>& bytes) {
    png_image description{};
    description.version = PNG_IMAGE_VERSION;
    EXPECT_TRUE(png_image_begin_read_from_memory(&description, bytes.data(), bytes.size()))
        << description.message;
    EXPECT_EQ(description.format, PNG_FORMAT_RGB);
    Image image{int(description.height), int(description.width),
                std::vector<std::uint8_t>(PNG_IMAGE_SIZE(description))};
    EXPECT_TRUE(png_image_finish_read(&description, nullptr, image.rgb.data(), 0, nullptr))
        << description.message;
    return image;
}

std::vector<std::pair<std::string, std::string>> read_png_texts(const std::vector<std::uint8_t>& bytes) {
    png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
    png_infop info = png_create_info_struct(png);
    std::pair<const std::uint8_t*, std::size_t> rest{bytes.data(), bytes.size()};
    std::vector<std::pair<std::string, std::string>> texts;
    png_set_read_fn(png, &rest, [](png_structp from, png_bytep to, std::size_t count) {
        auto& left = *static_cast<std::pair<const std::uint8_t*, std::size_t>*>(png_get_io_ptr(from));
        if (count > left.second) png_error(from, "the file ends early");
        std::copy(left.first, left.first + count, to);
        left = {left.first + count, left.second - count};
    });
    if (setjmp(png_jmpbuf(png)) == 0) {
        png_read_png(png, info, PNG_TRANSFORM_IDENTITY, nullptr);
        png_textp text = nullptr;
        const int n = png_get_text(png, info, &text, nullptr);
        for (int i = 0; i < n; ++i) texts.emplace_back(text[i].key, text[i].text);
    } else {
        ADD_FAILURE() << "libpng refuses the file";
    }
    png_destroy_read_struct(&png, &info, nullptr);
    return texts;
}

TEST_F(Picture, PngCarriesNotes) {
    const Image image{2, 3, std::vector<std::uint8_t>(18, 7)};
    const FileMetadata notes{{"sensor", "VLP-16"}, {"run", "über zwei"}};
    EXPECT_EQ(read_png_texts(encode_png(image, notes)), notes);
    EXPECT_EQ(read_png(encode_png(image, notes)).rgb, image.rgb);
    EXPECT_TRUE(read_png_texts(encode_png(image)).empty());
}

TEST_F(Picture, PngKeepsEveryPixel) {
    Image image{7, 13, {}};
    for (int i = 0; i < 7 * 13 * 3; ++i) image.rgb.push_back(std::uint8_t(i * 97 % 256));
    const Image read = read_png(encode_png(image));
    EXPECT_EQ(read.rows, 7);
    EXPECT_EQ(read.columns, 13);
    EXPECT_EQ(read.rgb, image.rgb);
    write_png(folder / "a.png", image);
    const std::string file = read_contents(folder / "a.png");
    EXPECT_EQ(std::vector<std::uint8_t>(file.begin(), file.end()), encode_png(image));
}

TEST_F(Picture, PngRefusesWrongSizes) {
    get_data_error_message([] { encode_png(Image{2, 2, std::vector<std::uint8_t>(11)}); });
    get_data_error_message([] { encode_png(Image{}); });
    get_data_error_message([] { encode_png(Image{-1, -1, std::vector<std::uint8_t>(3)}); });
}

using Rgb = std::vector<int>;

Rgb pixel(const Image& image, int index) {
    const auto first = image.rgb.begin() + 3 * index;
    return {first, first + 3};
}

TEST(ColourMap, GrayAndHeatHitTheirEnds) {
    const Image gray = apply_colour_map({-1, 0, 5, 10, 99}, 1, 5, 0, 10, "gray");
    const int expected[] = {0, 0, 128, 255, 255};
    for (int i = 0; i < 5; ++i) EXPECT_EQ(pixel(gray, i), Rgb(3, expected[i])) << i;
    const Image heat = apply_colour_map({0, 1}, 1, 2, 0, 1, "heat");
    for (int i = 0; i < 2; ++i) EXPECT_EQ(pixel(heat, i), Rgb(3, 255 * i)) << i;
}

TEST(ColourMap, TurboRunsFromBlueOverGreenToRed) {
    const Image image = apply_colour_map({0, 0.25f, 0.5f, 0.75f, 1}, 1, 5, 0, 1, "turbo");
    EXPECT_GT(pixel(image, 1)[2], pixel(image, 1)[0]);
    EXPECT_GT(pixel(image, 2)[1], pixel(image, 2)[0]);
    EXPECT_GT(pixel(image, 2)[1], pixel(image, 2)[2]);
    EXPECT_GT(pixel(image, 4)[0], 2 * pixel(image, 4)[1]);
}

TEST(ColourMap, NoValueIsDarkGray) {
    const float nan = std::numeric_limits<float>::quiet_NaN(), inf = std::numeric_limits<float>::infinity();
    EXPECT_EQ(pixel(apply_colour_map({3}, 1, 1, 3, 3, "gray"), 0), (Rgb{0, 0, 0})) << "constant image";
    const Image image = apply_colour_map({nan, 1, 1, inf, -inf}, 1, 5, 0, 1, "gray", {1, 0, 1, 1, 1});
    EXPECT_EQ(pixel(image, 0), pixel(image, 1));
    EXPECT_LT(pixel(image, 0)[0], 80);
    EXPECT_GT(pixel(image, 0)[0], 20);
    EXPECT_EQ(pixel(image, 2), (Rgb{255, 255, 255}));
    EXPECT_EQ(pixel(image, 3), (Rgb{255, 255, 255}));
    EXPECT_EQ(pixel(image, 4), (Rgb{0, 0, 0}));
}

TEST(ColourMap, RefusesWrongArguments) {
    const float nan = std::numeric_limits<float>::quiet_NaN();
    EXPECT_THROW(apply_colour_map({1}, 1, 1, 0, 1, "rainbow"), UsageError);
    get_data_error_message([] { apply_colour_map({1}, 1, 2, 0, 1, "gray"); });
    get_data_error_message([] { apply_colour_map({1}, 1, 1, 0, 1, "gray", {1, 1}); });
    get_data_error_message([=] { apply_colour_map({1}, 1, 1, nan, 1, "gray"); });
}

TEST(Stack, StretchesAndSeparates) {
    const Image a = apply_colour_map({0, 1}, 1, 2, 0, 1, "gray"),
                b = apply_colour_map({1, 0, 0, 1}, 2, 2, 0, 1, "gray");
    const Image image = stack_images({a, b}, 3);
    EXPECT_EQ(image.columns, 2);
    ASSERT_EQ(image.rows, 3 + 2 + 6);
    ASSERT_EQ(image.rgb.size(), std::size_t(11 * 2 * 3));
    const std::vector<int> first_column{0, 0, 0, 128, 128, 255, 255, 255, 0, 0, 0};
    for (int row = 0; row < image.rows; ++row)
        EXPECT_EQ(pixel(image, 2 * row)[0], first_column[std::size_t(row)]) << row;
}

TEST(Stack, RefusesUnequalWidths) {
    const Image a = apply_colour_map({0, 1}, 1, 2, 0, 1, "gray"),
                b = apply_colour_map({0, 1}, 2, 1, 0, 1, "gray");
    get_data_error_message([&] { stack_images({a, b}); });
    EXPECT_THROW(stack_images({a}, 0), UsageError);
    EXPECT_EQ(stack_images({}).rows, 0);
}

}  // namespace
}  // namespace relidar
