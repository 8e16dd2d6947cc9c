// SPDX-License-Identifier: Apache-2.0
#include <relidar/log/channels.hpp>

#include <cstring>

#include <relidar/base/error.hpp>

#include "base/files.hpp"
#include "support/names.hpp"

namespace relidar {
namespace {

using test::Names;
using testing::ElementsAre;

TEST(ChannelList, IsAskedForByNames) {
    const std::vector<ChannelInfo> channel_infos = parse_channels("seen, normal,seen");
    ASSERT_EQ(channel_infos.size(), 2u) << "each once";
    EXPECT_EQ(channel_infos[0].name, "seen");
    EXPECT_EQ(channel_infos[1].name, "normal");
    EXPECT_TRUE(parse_channels("").empty());
    EXPECT_THAT([] { parse_channels("normal,sean"); },
                testing::ThrowsMessage<UsageError>(Names("\"sean\" ... seen")));
}

TEST(ChannelList, NumbersAndRowsAgree) {
    const std::vector<ScanChannel> channels{
        {{.name = "way"}, std::vector<glm::vec3>{{1.0f, 2.0f, 3.0f}, {4.0f, 5.0f, 6.0f}}},
        {{.name = "label"}, std::vector<std::int32_t>{7, -8}},
        {{.name = "share"}, std::vector<float>{0.5f, 0.25f}}};
    std::vector<std::string> names;
    std::vector<bool> integers;
    for (const auto& [name, is_integer] : list_columns(channels, ".")) {
        names.push_back(name);
        integers.push_back(is_integer);
    }
    EXPECT_THAT(names, ElementsAre("way.x", "way.y", "way.z", "label", "share"));
    EXPECT_THAT(integers, ElementsAre(false, false, false, true, false));
    std::string bytes;
    append_values(bytes, channels, 1);
    ASSERT_EQ(bytes.size(), 20u);
    const struct {
        float way[3];
        std::int32_t label;
        float share;
    } row{{4.0f, 5.0f, 6.0f}, -8, 0.25f};
    EXPECT_EQ(std::memcmp(bytes.data(), &row, sizeof row), 0);
}

TEST(ChannelList, WhatACallerAddsIsChecked) {
    const auto check = [](const std::string& name, std::size_t count) {
        check_channels(
            {{{.name = "mine"}, std::vector<float>(3)}, {{.name = name}, std::vector<std::int32_t>(count)}},
            3, "a scan");
    };
    EXPECT_NO_THROW(check("label_2", 3));
    EXPECT_THROW(check("label", 2), DataError);
    for (const char* name : {"", "my label", "Label", "range", "instance", "range_2", "mine", "x"})
        EXPECT_THROW(check(name, 3), DataError) << name;
}

/// Returns a row of a Markdown table for a channel: | `name` | unit | meaning |
std::string row_of(const ChannelInfo& channel) {
    return "\n| `" + channel.name + "` | " + channel.unit + (channel.unit.empty() ? "" : " ") + "| " +
           channel.meaning + " |";
}

TEST(ChannelList, IsWhatTheGuideSays) {
    const std::string guide = read_file(std::filesystem::path(RELIDAR_SOURCE_DIR) / "docs" / "guide.md");
    for (const ChannelInfo& channel : file_channels()) EXPECT_THAT(guide, Names(row_of(channel)));
    for (const ChannelInfo& channel : optional_channels()) EXPECT_THAT(guide, Names(row_of(channel)));
}

}  // namespace
}  // namespace relidar
