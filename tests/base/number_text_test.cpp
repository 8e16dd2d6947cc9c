// SPDX-License-Identifier: Apache-2.0
#include "base/number_text.hpp"

#include <bit>
#include <cmath>
#include <cstdlib>
#include <random>
#include <sstream>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>
#define TOML_EXCEPTIONS 1
#include <toml++/toml.h>

#include "support/comma_locale.hpp"

namespace relidar {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

std::uint64_t bits(double value) { return std::bit_cast<std::uint64_t>(value); }

std::vector<double> make_many_numbers() {
    std::vector<double> numbers;
    std::istringstream edges(
        "0 -0 1 0.1 8 1e15 1e16 1e21 1e22 1e23 123456789012345680 9007199254740993 5e-324 "
        "2.2250738585072014e-308 1.7976931348623157e308");
    for (std::string edge; edges >> edge;) numbers.push_back(std::strtod(edge.c_str(), nullptr));
    std::mt19937_64 random(5);
    while (numbers.size() < 20'000)
        if (const auto x = std::bit_cast<double>(random()); std::isfinite(x)) numbers.push_back(x);
    // typical numbers with few digits
    for (int i = 0; i < 2'000; ++i) numbers.push_back(double(random() % 2'000'000) / 1000.0);
    return numbers;
}

TEST(NumberText, IsAsWritten) {
    const std::vector<std::pair<double, const char*>> expected{
        {8.0, "8.0"},         {0.0, "0.0"},         {-0.0, "-0.0"},     {-3.0, "-3.0"},
        {0.1, "0.1"},         {1e-9, "1e-09"},      {1e300, "1e+300"},  {1e15, "1e+15"},
        {10000.0, "10000.0"}, {100000.0, "1e+05"},  {1234.5, "1234.5"}, {-2.5e-7, "-2.5e-07"},
        {kInfinity, "inf"},   {-kInfinity, "-inf"}, {NAN, "nan"},       {-NAN, "nan"}};
    for (const auto& [value, text] : expected) EXPECT_EQ(number_text(value), text);
    EXPECT_EQ(number_text(0.1f), "0.1") << "as a double it would have 17 digits";
    EXPECT_EQ(number_text(16777216.0f), "16777216.0");
}

TEST(NumberText, IsARealNumberOfTomlAndJsonWithTheSameBits) {
    for (const double x : make_many_numbers()) {
        const std::string text = number_text(x);
        const toml::table table = toml::parse("x = " + text);
        ASSERT_TRUE(table["x"].is_floating_point()) << text;
        EXPECT_EQ(bits(table["x"].as_floating_point()->get()), bits(x)) << text;
        const nlohmann::json json = nlohmann::json::parse(text);
        ASSERT_TRUE(json.is_number_float()) << text;
        EXPECT_EQ(bits(json.get<double>()), bits(x)) << text;
        const auto y = static_cast<float>(x);
        if (!std::isfinite(y)) continue;
        EXPECT_EQ(bits(double(std::strtof(number_text(y).c_str(), nullptr))), bits(double(y))) << text;
    }
    EXPECT_TRUE(toml::parse("x = [nan, inf, -inf]")["x"].is_array()) << "what is not finite is TOML's";
}

TEST(NumberText, IsTheSameInEveryLocale) {
    const std::vector<double> numbers = make_many_numbers();
    std::vector<std::string> before;
    for (const double x : numbers) before.push_back(number_text(x));
    const test::CommaLocale comma;
    std::ostringstream stream;
    stream << 1234.5;
    ASSERT_EQ(stream.str(), "1.234,5") << "the locale is in force";
    for (std::size_t i = 0; i < numbers.size(); ++i) EXPECT_EQ(number_text(numbers[i]), before[i]);
}

}  // namespace
}  // namespace relidar
