// SPDX-License-Identifier: Apache-2.0
#include <relidar/base/images.hpp>
#include <relidar/score/report.hpp>

#include <cmath>
#include <limits>
#include <sstream>

#include "../../support/comma_locale.hpp"
#include "base/codecs/temporary_folder.hpp"

namespace relidar {
namespace {

using ReportFile = TemporaryFolder;

Report make_some_report() {
    Report report;
    report.title = "Title <b>&\"'";
    report.summary = "One paragraph.";
    report.facts = {{"device", "lavapipe <llvm>"}};
    report.curves = {{"loss/total", {0, 1, 2}, {1.0, 0.1, 0.001}},
                     {"loss/depth", {0, 1, 2}, {0.5, 0.05, 0.0005}},
                     {"score/psnr", {0, 1}, {24, 25}}};
    report.metrics = {{"relidar", {{"peer/depth_rmse_m", 3.25}, {"peer/depth_psnr_db", 28.0}}},
                      {"paper", {{"peer/depth_rmse_m", 3.4671}}}};
    report.timings_ms = {{"Training step", {{"forward", 3.0}, {"backward", 9.0}}}};
    report.figures = {{"Frame 5", {{"real", apply_colour_map({0, 1}, 1, 2, 0, 1, "turbo")}}}};
    report.bars = {{"Errors",
                    "Of all rays.",
                    {"small", "large"},
                    {{"near", 8.0, {0.75, 0.25}}, {"far", 0.0, {0.0, 0.0}}}}};
    report.tables = {{"Actors", "Worst first.", {{"actor", "m"}, {"van <1>", "0.12"}}},
                     {"Empty table", "", {{"actor", "m"}}}};
    report.key_metrics = {{"peer/depth_rmse_m", "Range error, m", "less is better"},
                          {"peer/none", "Nothing", "not there"}};
    return report;
}

Report report_with_view() {
    Report report = make_some_report();
    const float nan = std::nanf("");
    report.views = {
        {"Points",
         {{"real", {{1.5f, -2.0f, 0.25f}, {1000, 0, 0}, {nan, 0, 0}}, {0.5f, 1, 1}, {0.02f, 0, 0}}}}};
    return report;
}

std::string between(const std::string& text, const std::string& before, const std::string& after) {
    const std::size_t start = text.find(before) + before.size();
    return text.substr(start, text.find(after, start) - start);
}

std::string written(const std::filesystem::path& folder, const Report& report) {
    write_report(folder / "report.html", report);
    return read_contents(folder / "report.html");
}

std::size_t count(const std::string& text, const std::string& part) {
    std::size_t n = 0;
    for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
    return n;
}

void expect_well_formed(const std::string& html) {
    std::vector<std::string> open;
    std::size_t at = html.find("<body>");
    ASSERT_NE(at, std::string::npos);
    for (; at != std::string::npos; at = html.find('<', at + 1)) {
        const std::size_t end = html.find('>', at);
        ASSERT_NE(end, std::string::npos);
        const std::string tag = html.substr(at + 1, end - at - 1), name = tag.substr(0, tag.find(' '));
        if (name == "/html") break;
        if (name == "img" || tag.ends_with('/')) continue;
        if (!name.starts_with('/')) {
            open.push_back(name);
            continue;
        }
        ASSERT_FALSE(open.empty()) << name;
        ASSERT_EQ("/" + open.back(), name);
        open.pop_back();
    }
    EXPECT_TRUE(open.empty());
}

std::vector<double> list_path_heights(const std::string& html) {
    const std::size_t start = html.find(" d=\"M") + 4, end = html.find('"', start);
    std::istringstream path(html.substr(start, end - start));
    std::vector<double> heights;
    double x = 0.0, y = 0.0;
    for (char command; path >> command >> x >> y;) heights.push_back(y);
    return heights;
}

TEST_F(ReportFile, HoldsEverything) {
    const std::string html = written(folder, make_some_report());
    expect_well_formed(html);
    EXPECT_EQ(count(html, "<svg"), 2u);  // two groups of curves
    EXPECT_EQ(count(html, "<path"), 3u);
    for (const char* part : {"One paragraph.", "lavapipe", "depth_rmse_m", "3.250", "3.467", "28.00",
                             "backward", "9.000", "75.0 %", "12.000", "Frame 5", "real"})
        EXPECT_NE(html.find(part), std::string::npos) << part;
    EXPECT_NE(html.find("<td class=\"best\">3.250</td><td>3.467</td>"), std::string::npos);
    Report apart = make_some_report();
    apart.same_scans = false;
    EXPECT_EQ(written(folder, apart).find("class=\"best\""), std::string::npos);
    EXPECT_LT(html.find("backward"), html.find("forward"));  // longest time first
}

TEST_F(ReportFile, BeginsWithWhatAPersonWantsToSee) {
    const std::string html = written(folder, report_with_view());
    std::size_t before = 0;
    for (const char* part : {"One paragraph.", "<canvas", "Frame 5", "<svg", "Errors",
                             "<td class=\"name\">van &lt;1&gt;</td><td>0.12</td>", "Range error, m",
                             "All metrics", "lavapipe", "backward"}) {
        const std::size_t here = html.find(part);
        ASSERT_NE(here, std::string::npos) << part;
        EXPECT_GT(here, before) << part;
        before = here;
    }
    EXPECT_LT(html.find("<details>"), html.find("All metrics"));
    EXPECT_EQ(count(html, "<details>"), 3u);
    EXPECT_EQ(html.find("<details open"), std::string::npos);
    for (const char* part : {"75.0 %", "25.0 %", "width:75.00%", "less is better"})
        EXPECT_NE(html.find(part), std::string::npos) << part;
    EXPECT_EQ(html.find("not there"), std::string::npos);  // a metric without values
    EXPECT_EQ(html.find(">far<"), std::string::npos);      // a class without rays
    EXPECT_EQ(html.find("Empty table"), std::string::npos);
}

TEST_F(ReportFile, PacksPointsInEightBytes) {
    const std::string html = written(folder, report_with_view());
    // Expects a point at 150, -200, 25 cm (int16) with intensity 128, and an error of 2
    // cm in steps of 4 mm. Points that cannot be shown are omitted. The expected text is
    // from Python: base64.b64encode(struct.pack("<hhhBB", 150, -200, 25, 128, 5))
    EXPECT_EQ(between(html, "data-points=\"", "\""), "lgA4/xkAgAU=");
}

TEST_F(ReportFile, HoldsScriptForViewsAlone) {
    EXPECT_EQ(written(folder, make_some_report()).find("<script"), std::string::npos);
    const std::string html = written(folder, report_with_view());
    EXPECT_EQ(count(html, "<script"), 1u);
    const std::string script = between(html, "<script>", "</script>");
    for (const char* line : {"\nimport ", "\nexport ", "http"})
        EXPECT_EQ(script.find(line), std::string::npos) << line;
    EXPECT_NE(script.find("class Camera"), std::string::npos);
}

TEST_F(ReportFile, StaysBelowEightMegabytes) {
    Report report;
    const std::vector<glm::vec3> many(400'000, glm::vec3(1.0f));
    const std::vector<float> ones(many.size(), 1.0f);
    const std::vector<ReportCloud> pair = {{"real", many, ones, ones}, {"simulated", many, ones, ones}};
    report.views = {{"one", pair}, {"two", pair}};
    const std::string html = written(folder, report);
    EXPECT_LT(html.size(), 8'000'000u);
    EXPECT_GT(html.size(), 4'000'000u);  // not thinned more than necessary
}

TEST_F(ReportFile, EscapesWhateverItIsGiven) {
    Report report = make_some_report();
    const std::string evil = "</title></style><script>alert(1)</script>\"'&";
    report.title = report.summary = evil;
    report.facts = {{evil, evil}};
    report.curves = {{evil, {0, 1}, {1, 2}}};
    report.metrics = {{evil, {{evil, 1.0}}}};
    report.timings_ms = {{evil, {{evil, 1.0}}}};
    report.figures[0].title = report.figures[0].images[0].first = evil;
    report.bars[0] = {evil, evil, {evil}, {{evil, 1.0, {1.0}}}};
    report.key_metrics = {{evil, evil, evil}};
    const std::string html = written(folder, report);
    EXPECT_EQ(html.find("<script"), std::string::npos);
    EXPECT_EQ(count(html, "</title></style>"), 0u);
    EXPECT_GE(count(html, "&lt;script&gt;alert(1)"), 10u);
    expect_well_formed(html);
}

TEST_F(ReportFile, NeedsNothingBesideIt) {
    const std::string html = written(folder, make_some_report());
    EXPECT_EQ(html.find("http"), std::string::npos);
    EXPECT_EQ(count(html, "src="), count(html, "src=\"data:image/png;base64,iVBORw0KGgo"));
    EXPECT_EQ(count(html, "href="), 0u);
    EXPECT_EQ(count(html, "url("), 0u);
}

TEST_F(ReportFile, EncodesPicturesAsBase64) {
    const std::string html = written(folder, make_some_report());
    const std::size_t start = html.find("base64,") + 7, end = html.find('"', start);
    const std::vector<std::uint8_t> png = encode_png(make_some_report().figures[0].images[0].second);
    EXPECT_EQ(end - start, (png.size() + 2) / 3 * 4);
    EXPECT_EQ(end - start - html.substr(start, end - start).find_last_not_of('=') - 1,
              (3 - png.size() % 3) % 3);
}

TEST_F(ReportFile, LogarithmicAxisOnlyWhereAllValuesArePositive) {
    Report report;
    report.curves = {{"loss", {0, 1, 2}, {100, 10, 1}}};
    const std::vector<double> y = list_path_heights(written(folder, report));
    ASSERT_EQ(y.size(), 3u);
    EXPECT_NEAR(y[1] - y[0], y[2] - y[1], 0.21);  // equal factors must give equal steps
    EXPECT_LT(y[0], y[2]);                        // y points down in SVG

    report.curves[0].y = {100, 50, 0};
    const std::vector<double> linear = list_path_heights(written(folder, report));
    ASSERT_EQ(linear.size(), 3u);
    EXPECT_NEAR(linear[1] - linear[0], linear[2] - linear[1], 0.21);
}

TEST_F(ReportFile, TakesPoisonedAndLongCurves) {
    const double nan = std::nan(""), inf = std::numeric_limits<double>::infinity();
    Report report;
    ReportCurve curve{"long", {}, {}};
    for (int i = 0; i < 30'000; ++i) {
        curve.x.push_back(i);
        curve.y.push_back(i % 1000 == 7 ? nan : 1.0 + 1.0 / (1 + i));
    }
    report.curves = {curve,
                     {"a", {0, 1, 2, 3}, {1, nan, inf, 2}},
                     {"none", {}, {}},
                     {"one", {5}, {5}},
                     {"bad", {nan}, {nan}},
                     {"huge", {0, 1}, {1e308, -1e308}},
                     {"alone/flat", {1, 1}, {0, 0}},
                     {"empty/none", {}, {}}};
    report.metrics = {{"a", {{"x/rmse", nan}, {"x/ssim", inf}}}, {"b", {}}};
    report.timings_ms = {{"t", {{"nan", nan}, {"zero", 0.0}}}, {"none", {}}};
    const std::string html = written(folder, report);
    expect_well_formed(html);
    const std::string svg = html.substr(html.find("<svg"), html.rfind("</svg>") - html.find("<svg"));
    EXPECT_EQ(svg.find("nan"), std::string::npos);
    EXPECT_EQ(svg.find("inf"), std::string::npos);
    EXPECT_LT(html.size(), 100'000u);  // long curves are thinned
}

TEST_F(ReportFile, RefusesCurvesOfUnequalLength) {
    Report report;
    report.curves = {{"loss", {0, 1, 2}, {1, 2}}};
    get_data_error_message([&] { write_report(folder / "report.html", report); });
    EXPECT_TRUE(files().empty());
}

TEST_F(ReportFile, EmptyReportIsAPage) { expect_well_formed(written(folder, {})); }

TEST_F(ReportFile, IsTheSameInEveryLocale) {
    write_report(folder / "before.html", make_some_report());
    const test::CommaLocale comma;
    write_report(folder / "after.html", make_some_report());
    EXPECT_EQ(read_contents(folder / "after.html"), read_contents(folder / "before.html"));
}

}  // namespace
}  // namespace relidar
