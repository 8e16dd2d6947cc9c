// SPDX-License-Identifier: Apache-2.0
// Draws line charts as inline SVG: axes with round ticks, grid lines, and one path for
// each curve. The style sheet of the page defines colours and fonts (classes c0 ... c7,
// axis, grid, faint), so that charts follow the light and dark themes of the page.
#include "score/report/report_parts.hpp"

#include <algorithm>
#include <cmath>
#include <ranges>

#include "base/fail.hpp"

namespace relidar::report {
namespace {

// in SVG units, with space for the labels
constexpr double kLeftMargin = 58, kRightMargin = 14, kTopMargin = 10, kBottomMargin = 30;
// Longer curves are noisy, so their running mean is also drawn.
constexpr std::size_t kMaxSmoothPoints = 250;
// of the x axis; at most two points per interval are drawn
constexpr std::size_t kMaxIntervals = 500;

struct ChartAxis {
    double low = 0.0, high = 1.0;        ///< values at the ends
    double at_low = 0.0, at_high = 1.0;  ///< positions of the ends on the page, SVG units
    bool logarithmic = false;

    double scaled(double value) const { return logarithmic ? std::log10(value) : value; }
    double to_svg(double value) const {
        return at_low + (scaled(value) - scaled(low)) / (scaled(high) - scaled(low)) * (at_high - at_low);
    }
};

struct ValueInterval {
    double low = INFINITY, high = -INFINITY;

    void extend(double value) {
        low = std::min(low, value);
        high = std::max(high, value);
    }
};

bool is_drawable(const ReportCurve& curve, std::size_t point) {
    return std::abs(curve.x[point]) < 1e100 && std::abs(curve.y[point]) < 1e100;
}

/// Returns the smallest step of 1, 2 or 5 times a power of ten that gives at most
/// `n_ticks` intervals.
double choose_tick_step(double span, int n_ticks) {
    const double raw = span / n_ticks, decade = std::pow(10.0, std::floor(std::log10(raw)));
    for (double factor : {1.0, 2.0, 5.0})
        if (raw <= factor * decade) return factor * decade;
    return 10.0 * decade;
}

std::vector<double> linear_ticks(const ChartAxis& axis, int n_ticks) {
    const double step = choose_tick_step(axis.high - axis.low, n_ticks);
    std::vector<double> ticks;
    for (double k = std::ceil(axis.low / step - 1e-9);
         k * step <= axis.high + 1e-9 * step && ticks.size() < 50; ++k)
        ticks.push_back(k == 0.0 ? 0.0 : k * step);
    return ticks;
}

/// Returns the ticks of a logarithmic axis, usually the powers of ten. Leaves some out if
/// there are many. Adds ticks at 2 and 5 times each power if there are few.
std::vector<double> make_log_ticks(const ChartAxis& axis) {
    const int first = int(std::floor(std::log10(axis.low))), last = int(std::ceil(std::log10(axis.high)));
    const int step = std::max(1, (last - first) / 6);  // at most about six powers of ten
    const bool has_few_decades = last - first <= 3;
    std::vector<double> ticks;
    for (int decade = first; decade <= last; decade += step)
        for (double factor : {1.0, 2.0, 5.0}) {
            const double tick = factor * std::pow(10.0, decade);
            if (factor > 1.0 && !has_few_decades) continue;
            if (tick >= axis.low * (1 - 1e-9) && tick <= axis.high * (1 + 1e-9)) ticks.push_back(tick);
        }
    return ticks;
}

std::string format_tick(double value) {
    const double size = std::abs(value);
    if (size >= 1e6) return fmt::format("{:g}M", value / 1e6);
    if (size >= 1e4) return fmt::format("{:g}k", value / 1e3);
    return fmt::format("{:.6g}", value);
}

/// Returns a linear axis from 0 to 1 if there is no value.
ChartAxis make_axis(const ValueInterval& extent, double page_low, double page_high) {
    const auto [low, high] = extent.low > extent.high ? ValueInterval{0.0, 1.0} : extent;
    return {.low = low, .high = high, .at_low = page_low, .at_high = page_high, .logarithmic = false};
}

/// Returns the y axis with a margin. It is logarithmic if all values are positive and
/// span more than a factor of 4.
ChartAxis make_y_axis(const ValueInterval& value_extent, double page_low, double page_high) {
    ChartAxis axis = make_axis(value_extent, page_low, page_high);
    axis.logarithmic = axis.low > 0.0 && axis.high > 4.0 * axis.low;
    if (axis.logarithmic) {
        const double margin = std::pow(axis.high / axis.low, 0.05);
        axis.low /= margin;
        axis.high *= margin;
    } else {
        const double span = axis.high - axis.low;
        const double margin = span > 0.0 ? 0.06 * span : std::max(0.05 * std::abs(axis.low), 1e-6);
        axis.low -= margin;
        axis.high += margin;
    }
    return axis;
}

ChartAxis make_x_axis(const ValueInterval& value_extent, double page_low, double page_high) {
    ChartAxis axis = make_axis(value_extent, page_low, page_high);
    if (!(axis.high > axis.low)) {
        axis.low -= 0.5;
        axis.high += 0.5;
    }
    return axis;
}

/// Returns the indices of the points to draw: the minimum and the maximum of each
/// interval of the x axis. Spikes therefore remain visible. An interval with a value that
/// cannot be drawn becomes a gap.
std::vector<std::size_t> thin_out(const ReportCurve& curve) {
    const std::size_t n = curve.y.size(), width = std::max<std::size_t>(1, n / kMaxIntervals);
    std::vector<std::size_t> point_indices;
    const auto is_point = [&](std::size_t i) { return is_drawable(curve, i); };
    const auto y_of = [&](std::size_t i) { return curve.y[i]; };
    for (std::size_t first = 0; first < n; first += width) {
        const auto interval = std::views::iota(first, std::min(n, first + width));
        const auto gap = std::ranges::find_if_not(interval, is_point);
        const bool has_gap = gap != interval.end();
        const std::size_t low = has_gap ? *gap : *std::ranges::min_element(interval, {}, y_of),
                          high = has_gap ? *gap : *std::ranges::max_element(interval, {}, y_of);
        point_indices.push_back(std::min(low, high));
        if (low != high) point_indices.push_back(std::max(low, high));
    }
    return point_indices;
}

/// Returns the running mean of a curve with more than kMaxSmoothPoints points, at up to
/// kMaxIntervals points. The window is 1/40 of the curve wide.
ReportCurve running_mean(const ReportCurve& curve) {
    const std::size_t n = curve.y.size(), half = n / 80, n_samples = std::min(n, kMaxIntervals);
    ReportCurve result{curve.name, {}, {}};
    for (std::size_t sample = 0; sample < n_samples; ++sample) {
        const std::size_t middle = sample * (n - 1) / (n_samples - 1);
        // A window that is not symmetric would give a biased mean at the ends.
        const std::size_t reach = std::min({half, middle, n - 1 - middle});
        double sum = 0.0, count = 0.0;
        for (std::size_t i = middle - reach; i <= middle + reach; ++i)
            if (is_drawable(curve, i)) {
                sum += curve.y[i];
                ++count;
            }
        result.x.push_back(curve.x[middle]);
        // NaN (a gap) if the window has no finite value
        result.y.push_back(sum / count);
    }
    return result;
}

/// Returns a curve as SVG: one path with gaps at values that are not finite.
/// @param style classes of the style sheet
std::string draw_curve(const ReportCurve& curve, const ChartAxis& x_axis, const ChartAxis& y_axis,
                       const std::string& style) {
    std::string path, dots;
    // The path starts with M (move), also after a gap, and continues with L (line).
    bool connected = false;
    const std::vector<std::size_t> point_indices = thin_out(curve);
    for (std::size_t i : point_indices) {
        if (!is_drawable(curve, i)) {
            connected = false;
            continue;
        }
        const double px = x_axis.to_svg(curve.x[i]), py = y_axis.to_svg(curve.y[i]);
        path += fmt::format("{}{:.1f} {:.1f}", connected ? "L" : "M", px, py);
        // Few points also get dots.
        if (point_indices.size() <= 30)
            dots +=
                fmt::format("<circle class=\"{}\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"2.6\"/>", style, px, py);
        connected = true;
    }
    return fmt::format("<path class=\"line {}\" d=\"{}\"/>{}", style, path, dots);
}

std::string draw_line(const char* style, double x1, double x2, double y1, double y2) {
    return fmt::format("<line class=\"{}\" x1=\"{:.1f}\" x2=\"{:.1f}\" y1=\"{:.1f}\" y2=\"{:.1f}\"/>", style,
                       x1, x2, y1, y2);
}

/// @param anchor  part of the label that is at x: "middle" or "end"
std::string draw_label(double x, double y, const char* anchor, double value) {
    return fmt::format("<text class=\"axis\" x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"{}\">{}</text>\n", x, y,
                       anchor, format_tick(value));
}

/// Returns the axes as SVG: grid lines with labels for y, and tick marks with labels for
/// x.
std::string draw_axes(const ChartAxis& x_axis, const ChartAxis& y_axis) {
    const double left = x_axis.at_low, right = x_axis.at_high, bottom = y_axis.at_low;
    std::string svg;
    for (double tick : y_axis.logarithmic ? make_log_ticks(y_axis) : linear_ticks(y_axis, 5)) {
        const double y = y_axis.to_svg(tick);
        // The y of a label is its base line, which is half the height of a digit lower.
        svg += draw_line("grid", left, right, y, y) + draw_label(left - 8, y + 4, "end", tick);
    }
    const bool is_wide = right - left > 600;  // has space for ten labels
    for (double tick : linear_ticks(x_axis, is_wide ? 10 : 5)) {
        const double x = x_axis.to_svg(tick);
        svg += draw_line("tick", x, x, bottom, bottom + 4) + draw_label(x, bottom + 18, "middle", tick);
    }
    return svg + draw_line("tick", left, right, bottom, bottom) + "\n";
}

}  // namespace

bool has_running_mean(const ReportCurve& curve) { return curve.y.size() > kMaxSmoothPoints; }

std::string draw_svg_chart(const std::vector<const ReportCurve*>& curves, int width, int height) {
    ValueInterval x_extent, y_extent;
    for (const ReportCurve* curve : curves) {
        if (curve->x.size() != curve->y.size())
            fail("cannot draw the curve '{}': it has {} x values and {} y values, expected the same number",
                 curve->name, curve->x.size(), curve->y.size());
        for (std::size_t i = 0; i < curve->x.size(); ++i)
            if (is_drawable(*curve, i)) {
                x_extent.extend(curve->x[i]);
                y_extent.extend(curve->y[i]);
            }
    }
    // SVG's y points down, so the lowest value is at the bottom margin.
    const ChartAxis x = make_x_axis(x_extent, kLeftMargin, width - kRightMargin);
    const ChartAxis y = make_y_axis(y_extent, height - kBottomMargin, kTopMargin);
    std::string names;
    for (const ReportCurve* curve : curves) names += (names.empty() ? "" : ", ") + curve->name;
    std::string svg = fmt::format("<svg viewBox=\"0 0 {} {}\" role=\"img\" aria-label=\"Curves of {}\">\n{}",
                                  width, height, escape_html(names), draw_axes(x, y));
    for (std::size_t i = 0; i < curves.size(); ++i) {
        const std::string colour = fmt::format("c{}", i % kChartColours);
        // A long curve is drawn faintly behind its running mean.
        const bool has_mean = has_running_mean(*curves[i]);
        svg += fmt::format("<g><title>{}</title>", escape_html(curves[i]->name));
        svg += draw_curve(*curves[i], x, y, has_mean ? colour + " faint" : colour);
        if (has_mean) svg += draw_curve(running_mean(*curves[i]), x, y, colour);
        svg += "</g>\n";
    }
    return svg + "</svg>\n";
}

}  // namespace relidar::report
