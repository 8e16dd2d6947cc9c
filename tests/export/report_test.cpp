// SPDX-License-Identifier: Apache-2.0
// The HTML report: complete, self-contained, well-formed, and safe whatever the names in it hold.
#include <relidar/export.hpp>

#include <cmath>
#include <limits>
#include <sstream>

#include "../support/comma_locale.hpp"
#include "temporary_folder.hpp"

namespace relidar {
namespace {

using ReportFile = TemporaryFolder;

Report some_report() {
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
    report.figures = {{"Frame 5", {{"real", colour_map({0, 1}, 1, 2, 0, 1, "turbo")}}}};
    return report;
}

std::string written(const std::filesystem::path& folder, const Report& report) {
    write_report(folder / "report.html", report);
    return contents(folder / "report.html");
}

std::size_t count(const std::string& text, const std::string& part) {
    std::size_t n = 0;
    for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
    return n;
}

/// Every element of the body that opens also closes, in order.
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

/// Heights of the points of the first path drawn.
std::vector<double> path_heights(const std::string& html) {
    const std::size_t start = html.find(" d=\"M") + 4, end = html.find('"', start);
    std::istringstream path(html.substr(start, end - start));
    std::vector<double> heights;
    double x = 0.0, y = 0.0;
    for (char command; path >> command >> x >> y;) heights.push_back(y);
    return heights;
}

TEST_F(ReportFile, HoldsEverything) {
    const std::string html = written(folder, some_report());
    expect_well_formed(html);
    EXPECT_EQ(count(html, "<svg"), 2u);   // two groups of curves
    EXPECT_EQ(count(html, "<path"), 3u);
    for (const char* part : {"One paragraph.", "lavapipe", "depth_rmse_m", "3.250", "3.467", "28.00", "backward", "9.000", "75.0 %",
                             "12.000", "Frame 5", "real"})
        EXPECT_NE(html.find(part), std::string::npos) << part;
    EXPECT_NE(html.find("<td class=\"best\">3.250</td><td>3.467</td>"), std::string::npos);
    Report apart = some_report();
    apart.same_scans = false;
    EXPECT_EQ(written(folder, apart).find("class=\"best\""), std::string::npos) << "scores of different scans are not compared";
    EXPECT_LT(html.find("backward"), html.find("forward"));   // longest first
}

TEST_F(ReportFile, EscapesWhateverItIsGiven) {
    Report report = some_report();
    const std::string evil = "</title></style><script>alert(1)</script>\"'&";
    report.title = report.summary = evil;
    report.facts = {{evil, evil}};
    report.curves = {{evil, {0, 1}, {1, 2}}};
    report.metrics = {{evil, {{evil, 1.0}}}};
    report.timings_ms = {{evil, {{evil, 1.0}}}};
    report.figures[0].title = report.figures[0].images[0].first = evil;
    const std::string html = written(folder, report);
    EXPECT_EQ(html.find("<script"), std::string::npos);
    EXPECT_EQ(count(html, "</title></style>"), 0u);
    EXPECT_GE(count(html, "&lt;script&gt;alert(1)"), 10u);
    expect_well_formed(html);
}

TEST_F(ReportFile, NeedsNothingBesideIt) {
    const std::string html = written(folder, some_report());
    EXPECT_EQ(html.find("http"), std::string::npos);
    EXPECT_EQ(count(html, "src="), count(html, "src=\"data:image/png;base64,iVBORw0KGgo"));
    EXPECT_EQ(count(html, "href="), 0u);
    EXPECT_EQ(count(html, "url("), 0u);
}

TEST_F(ReportFile, EncodesPicturesAsBase64) {
    const std::string html = written(folder, some_report());
    const std::size_t start = html.find("base64,") + 7, end = html.find('"', start);
    const std::vector<std::uint8_t> png = encode_png(some_report().figures[0].images[0].second);
    EXPECT_EQ(end - start, (png.size() + 2) / 3 * 4);
    EXPECT_EQ(end - start - html.substr(start, end - start).find_last_not_of('=') - 1, (3 - png.size() % 3) % 3);
}

TEST_F(ReportFile, LogarithmicAxisOnlyWhereAllValuesArePositive) {
    Report report;
    report.curves = {{"loss", {0, 1, 2}, {100, 10, 1}}};
    const std::vector<double> y = path_heights(written(folder, report));
    ASSERT_EQ(y.size(), 3u);
    EXPECT_NEAR(y[1] - y[0], y[2] - y[1], 0.21);   // equal factors, equal steps
    EXPECT_LT(y[0], y[2]);                         // SVG counts downwards

    report.curves[0].y = {100, 50, 0};
    const std::vector<double> linear = path_heights(written(folder, report));
    ASSERT_EQ(linear.size(), 3u);
    EXPECT_NEAR(linear[1] - linear[0], linear[2] - linear[1], 0.21);
}

TEST_F(ReportFile, TakesPoisonedAndLongCurves) {
    const double nan = std::nan(""), inf = std::numeric_limits<double>::infinity();
    Report report;
    ReportCurve curve{"long", {}, {}};
    for (int i = 0; i < 30'000; ++i) curve.x.push_back(i), curve.y.push_back(i % 1000 == 7 ? nan : 1.0 + 1.0 / (1 + i));
    report.curves = {curve, {"a", {0, 1, 2, 3}, {1, nan, inf, 2}}, {"none", {}, {}}, {"one", {5}, {5}}, {"bad", {nan}, {nan}},
                     {"huge", {0, 1}, {1e308, -1e308}}, {"alone/flat", {1, 1}, {0, 0}}, {"empty/none", {}, {}}};
    report.metrics = {{"a", {{"x/rmse", nan}, {"x/ssim", inf}}}, {"b", {}}};
    report.timings_ms = {{"t", {{"nan", nan}, {"zero", 0.0}}}, {"none", {}}};
    const std::string html = written(folder, report);
    expect_well_formed(html);
    const std::string svg = html.substr(html.find("<svg"), html.rfind("</svg>") - html.find("<svg"));
    EXPECT_EQ(svg.find("nan"), std::string::npos);
    EXPECT_EQ(svg.find("inf"), std::string::npos);
    EXPECT_LT(html.size(), 100'000u);   // long curves are thinned
}

TEST_F(ReportFile, RefusesCurvesOfUnequalLength) {
    Report report;
    report.curves = {{"loss", {0, 1, 2}, {1, 2}}};
    data_error([&] { write_report(folder / "report.html", report); });
    EXPECT_TRUE(files().empty());
}

TEST_F(ReportFile, EmptyReportIsAPage) { expect_well_formed(written(folder, {})); }

TEST_F(ReportFile, IsTheSameInEveryLocale) {
    write_report(folder / "before.html", some_report());
    const test::CommaLocale comma;
    write_report(folder / "after.html", some_report());
    EXPECT_EQ(contents(folder / "after.html"), contents(folder / "before.html"));
}

}  // namespace
}  // namespace relidar
