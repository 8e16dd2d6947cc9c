// SPDX-License-Identifier: Apache-2.0
// Tests the requests of the viewer's page.
#include "../../tools/view/request.hpp"

#include <gmock/gmock.h>

#include <relidar/base/error.hpp>

#include "support/names.hpp"

namespace relidar::view {
namespace {

using test::Names;

const std::string kEdits = R"({"copies": [{"of": "0", "from": "", "at": [1, 2, 3, 90, 4, 6, 5]},
    {"of": "7", "from": "../run2", "at": [0, 0, 0, 0, 0, 0, 0]}], "moves": {"1": [0, -3.5, 0, 10]}, "removed": ["2"],
    "hidden": ["3", "4"]})";
const std::string kNoEdits = R"({"copies": [], "moves": {}, "removed": [], "hidden": []})";

std::string scan(const std::string& place, const std::string& edits = kNoEdits,
                 const std::string& time = "1.5", const std::string& weather = "fog=50") {
    return R"({"do": "scan", "id": 7, "time_s": )" + time + R"(, "place": )" + place +
           R"(, "sensor": "VLP-16", "lidar": 1, "weather": ")" + weather +
           R"(", "simulate": true, "real": false, "edits": )" + edits + "}";
}

std::string refusal(const std::string& message) {
    try {
        (void)parse_request(message);
    } catch (const UsageError& error) {
        return error.what();
    }
    return "";
}

TEST(ViewRequest, ReadsAScan) {
    const auto wish = std::get<LiveScanRequest>(parse_request(scan("[1, 2, 3, 90, 0, 0]", kEdits)));
    EXPECT_EQ(wish.id, 7);
    EXPECT_EQ(wish.time_s, 1.5);
    EXPECT_EQ(wish.sensor, "VLP-16");
    EXPECT_EQ(wish.lidar, 1);
    EXPECT_EQ(wish.weather.fog_visibility_m, 50.0);
    EXPECT_TRUE(wish.simulate);
    EXPECT_FALSE(wish.real);
    const glm::dvec3 ahead = wish.sensor_offset * glm::dvec3(1, 0, 0);  // 90 degrees to the left
    EXPECT_NEAR(glm::distance(ahead, glm::dvec3(1, 3, 3)), 0.0, 1e-12);
    ASSERT_EQ(wish.edits.copies.size(), 2u);
    EXPECT_EQ(wish.edits.copies[0].from, "");
    EXPECT_EQ(wish.edits.copies[1].from, "../run2");
    EXPECT_EQ(wish.edits.copies[0].of, "0");
    EXPECT_EQ(wish.edits.copies[0].at, (std::array<double, 7>{1, 2, 3, 90, 4, 6, 5}));
    EXPECT_EQ(wish.edits.moves.at("1"), (std::array<double, 4>{0, -3.5, 0, 10}));
    EXPECT_EQ(wish.edits.removed, std::set<std::string>{"2"});
    EXPECT_EQ(wish.edits.hidden, (std::set<std::string>{"3", "4"}));
}

TEST(ViewRequest, RefusesWhatIsNoScan) {
    const std::string zero = "[0, 0, 0, 0, 0, 0]";
    ASSERT_EQ(refusal(scan(zero)), "");
    const std::vector<std::pair<std::string, std::string>> cases = {
        {"", "JSON object"},
        {"[1]", "JSON object"},
        {std::string(100'000, '['), "JSON object"},
        {"{\"do\": \"scan\"", "JSON object"},
        {"{}", "do"},
        {R"({"do": 5})", "do"},
        {R"({"do": "quit"})", "found \"quit\""},
        {R"({"do": "scan"})", "place"},
        {scan("[0, 0, 0]"), "place ... 6"},
        {scan("[0, 0, null, 0, 0, 0]"), "place 3"},
        {scan("[0, 1e5, 0, 0, 0, 0]"), "place 2 ... -10000 ... 10000"},
        {scan(zero, kNoEdits, "1e300"), "time_s"},
        {scan(zero, kNoEdits, "1.5", "fog=0"), "weather ... fog=0 ... 1 ... 1e6"},
        {scan(zero, kNoEdits, "1.5", std::string(65, 'f')), "weather ... 1 ... 64"},
        {scan(zero, kNoEdits, "1e999"), "JSON object"},
        {scan(zero, "[]"), "edits"},
        {scan(zero, R"({"copies": [1], "moves": {}, "removed": [], "hidden": []})"), "copies"},
        {scan(
             zero,
             R"({"copies": [{"of": "0", "from": "", "at": [1, 2, 3, 90, 5]}], "moves": {}, "removed": [], "hidden": []})"),
         "at ... 7"},
        {scan(zero, R"({"copies": [], "moves": {"0": [1]}, "removed": [], "hidden": []})"), "moves ... 4"},
        {scan(zero, R"({"copies": [], "moves": {}, "removed": "0", "hidden": []})"), "removed"}};
    for (const auto& [message, why] : cases)
        EXPECT_THAT(refusal(message), Names(why)) << message.substr(0, 80);
    std::string many = R"({"copies": [], "moves": {}, "removed": ["0")";
    for (int i = 1; i < 300; ++i) many += ",\"" + std::to_string(i) + "\"";
    EXPECT_THAT(refusal(scan(zero, many + R"(], "hidden": []})")), Names("256"));
}

TEST(ViewRequest, SavesUnderPlainNamesAlone) {
    const auto save = [](const std::string& name) {
        return R"({"do": "save", "name": ")" + name + R"(", "edits": )" + kNoEdits + "}";
    };
    for (const char* name : {"run2", "a.b-c_D", "0"})
        EXPECT_EQ(std::get<SaveRequest>(parse_request(save(name))).name, name);
    for (const char* name : {"", ".", "..", "../run", "a/b", "/tmp/x", "a\\\\b", ".hidden", "-f", "a b",
                             "a\\u0000b", "\\u00e4", "a\\nb"})
        EXPECT_NE(refusal(save(name)), "") << name;
    EXPECT_NE(refusal(save(std::string(65, 'x'))), "");
}

TEST(ViewRequest, TakesPlacesOnTheGround) {
    const auto wish = std::get<GroundPoseRequest>(
        parse_request(R"({"do": "ground", "of": "0", "from": "", "at": [12.5, -3]})"));
    EXPECT_EQ(wish.of, "0");
    EXPECT_EQ(wish.from, "");
    EXPECT_EQ(wish.at, (std::array<double, 2>{12.5, -3.0}));
    EXPECT_THAT(refusal(R"({"do": "ground", "of": "0", "from": "", "at": [12.5]})"), Names("at ... 2"));
    EXPECT_THAT(refusal(R"({"do": "ground", "of": "0", "from": 3, "at": [1, 2]})"), Names("from"));
}

TEST(ViewRequest, TakesSensorFiles) {
    const auto file = std::get<SensorFile>(
        parse_request(R"({"do": "sensor", "file": "beams.csv", "text": "elevation_deg\n5\n"})"));
    EXPECT_EQ(file.name, "beams.csv");
    EXPECT_EQ(file.text, "elevation_deg\n5\n");
    EXPECT_THAT(refusal(R"({"do": "sensor", "file": "beams.csv"})"), Names("text"));
}

}  // namespace
}  // namespace relidar::view
