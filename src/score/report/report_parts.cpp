// SPDX-License-Identifier: Apache-2.0
// Writes texts, numbers, images and 3D views of the report as HTML.
#include "score/report/report_parts.hpp"

#include <algorithm>
#include <cmath>
#include <span>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "base/base64.hpp"

namespace relidar {

// All JavaScript modules, from a file that cmake/Assets.cmake generates.
std::span<const std::pair<std::string_view, std::string_view>> script_texts();

namespace report {
namespace {

// on a page: 5.3 MB as base64
constexpr std::size_t kMaxPoints = 500'000;
constexpr float kMaxDrawnRange_m = 300.0f;
constexpr float kErrorStep_m = 0.004f;

/// Packs points into 8 bytes each, little-endian, which points/report.js reads: x, y, z
/// in centimetres (int16), intensity in steps of 1/255, and range error in steps of
/// kErrorStep_m, at most 254. 255 means an unknown error.
std::vector<std::uint8_t> pack_cloud(const ReportCloud& cloud, std::size_t max_points) {
    const std::size_t n = cloud.position_m.size(),
                      step = std::max<std::size_t>(1, (n + max_points - 1) / max_points);
    std::vector<std::uint8_t> bytes;
    for (std::size_t i = 0; i < n; i += step) {
        const glm::vec3& p = cloud.position_m[i];
        if (!(glm::length(p) < kMaxDrawnRange_m)) continue;
        for (int k = 0; k < 3; ++k) {
            const auto cm = static_cast<std::uint16_t>(static_cast<std::int16_t>(std::lround(100.0f * p[k])));
            bytes.push_back(static_cast<std::uint8_t>(cm & 0xff));
            bytes.push_back(static_cast<std::uint8_t>(cm >> 8));
        }
        bytes.push_back(
            static_cast<std::uint8_t>(std::lround(255.0f * std::clamp(cloud.intensity[i], 0.0f, 1.0f))));
        const float error_m = cloud.error_m[i];
        const long error_steps =
            std::isfinite(error_m) ? std::lround(std::min(std::abs(error_m) / kErrorStep_m, 254.0f)) : 255;
        bytes.push_back(static_cast<std::uint8_t>(error_steps));
    }
    return bytes;
}

/// Converts a JavaScript module, so that it can be joined with others into one script.
/// Removes imports and the keyword `export`.
std::string strip_module(std::string_view module_source) {
    std::string script;
    while (!module_source.empty()) {
        const std::size_t end = std::min(module_source.find('\n'), module_source.size() - 1);
        std::string_view line = module_source.substr(0, end + 1);
        module_source.remove_prefix(end + 1);
        if (line.starts_with("import ")) continue;
        constexpr std::string_view kExportKeyword = "export ";
        if (line.starts_with(kExportKeyword)) line.remove_prefix(kExportKeyword.size());
        script += line;
    }
    return script;
}

}  // namespace

std::string escape_html(std::string_view text) {
    std::string result;
    for (char c : text) {
        if (c == '&') result += "&amp;";
        else if (c == '<') result += "&lt;";
        else if (c == '>') result += "&gt;";
        else if (c == '"') result += "&quot;";
        else if (c == '\'') result += "&#39;";
        else result += c;
    }
    return result;
}

std::string format_number(double value) {
    if (std::isnan(value)) return "\u2013";
    const double size = std::abs(value);
    if (value == 0.0 || (size >= 1e-4 && size < 1e7)) {
        const int digits = value == 0.0 ? 0 : std::clamp(3 - int(std::floor(std::log10(size))), 0, 7);
        return fmt::format("{:.{}f}", value, digits);
    }
    return fmt::format("{:.3g}", value);
}

std::string png_data_url(const Image& image) {
    return "data:image/png;base64," + encode_base64(encode_png(image));
}

std::string view_html(const ReportView& view, std::size_t n_views) {
    // All clouds of all views of the page share kMaxPoints.
    const std::size_t max_points = kMaxPoints / std::max<std::size_t>(1, view.clouds.size() * n_views) + 1;
    std::string figures;
    for (const ReportCloud& cloud : view.clouds) {
        const std::string name = escape_html(cloud.name);
        figures += fmt::format(
            "<figure><figcaption>{0}</figcaption><canvas tabindex=\"0\" role=\"application\" "
            "aria-label=\"{0}: points in 3D; arrow keys turn, plus and minus zoom\" "
            "data-points=\"{1}\"></canvas></figure>\n",
            name, encode_base64(pack_cloud(cloud, max_points)));
    }
    return fmt::format(
        "<div class=\"view3d\">\n<div class=\"pair\">\n{}</div>\n<p class=\"controls\"><label>colour "
        "<select><option value=\"range\">range</option><option value=\"height\">height</option><option "
        "value=\"intensity\">intensity</option><option value=\"error\">range error</option></select></label> "
        "<span class=\"legend3d\"></span></p>\n"
        "<p class=\"note\">Drag turns both, Ctrl and drag moves, the wheel zooms; or the arrow keys, plus "
        "and minus.</p>\n"
        "</div>\n",
        figures);
}

std::string view_script() {
    std::string script;
    for (const auto& [name, module] : script_texts()) script += strip_module(module);
    return "<script>\n(() => {\n'use strict';\n" + script + "})();\n</script>\n";
}

}  // namespace report
}  // namespace relidar
