// SPDX-License-Identifier: Apache-2.0
// Writes the report as a single HTML page that needs no other file and no network.
// Escapes all text from outside the program. Adds a script only if the page has 3D views.
// Curves share a chart if their names have the same part before '/'. Metrics are grouped
// in the same way.
#include <relidar/base/files.hpp>
#include <relidar/score/metrics.hpp>
#include <relidar/score/report.hpp>

#include <algorithm>
#include <cmath>
#include <optional>
#include <set>

#include <fmt/format.h>

#include "base/parallel.hpp"
#include "score/report/report_parts.hpp"
#include "score/report/report_style.hpp"

namespace relidar {
namespace {

using report::escape_html;
using report::format_number;

// A wider image, for example 66 x 1030 pixels, is stretched vertically, so that its rows
// are visible.
constexpr double kMaxAspect = 10.0;

/// Returns nothing if the body is empty.
std::string section_html(const std::string& title, const std::string& body, bool is_collapsed = false) {
    if (body.empty()) return "";
    return fmt::format(fmt::runtime(is_collapsed ? "<details>\n<summary>{}</summary>\n{}</details>\n"
                                                 : "<section>\n<h2>{}</h2>\n{}</section>\n"),
                       escape_html(title), body);
}

std::string note_html(const std::string& text) { return "<p class=\"note\">" + text + "</p>\n"; }

/// scrolls horizontally on a narrow screen
std::string make_table_html(const std::string& header_cells, const std::string& rows) {
    return fmt::format(
        "<div class=\"scroll\"><table>\n<thead><tr>{}</tr></thead>\n<tbody>\n{}</tbody></table></div>\n",
        header_cells, rows);
}

/// Returns a table with the first row as header, or nothing without further rows.
std::string table_html(const ReportTable& table) {
    if (table.rows.size() < 2) return "";
    std::string head, rows;
    for (const std::string& cell : table.rows.front()) head += "<th>" + escape_html(cell) + "</th>";
    for (std::size_t r = 1; r < table.rows.size(); ++r) {
        std::string cells;
        for (const std::string& cell : table.rows[r])
            cells += fmt::format("<td{}>{}</td>", cells.empty() ? " class=\"name\"" : "", escape_html(cell));
        rows += "<tr>" + cells + "</tr>\n";
    }
    return make_table_html(head, rows) + note_html(escape_html(table.note));
}

/// Returns a table in which each row is a bar of stacked shares.
std::string bars_html(const ReportBars& bars) {
    std::string head = "<th>Where</th><th class=\"stack\">Shares</th>", rows;
    for (std::size_t b = 0; b < bars.bands.size(); ++b)
        head += fmt::format("<th><i class=\"b{}\"></i>{}</th>", b, escape_html(bars.bands[b]));
    for (const ReportBars::Row& row : bars.rows) {
        if (!(row.count > 0.0)) continue;
        std::string stack, cells;
        for (std::size_t b = 0; b < row.share.size(); ++b) {
            const double percent = 100.0 * std::clamp(row.share[b], 0.0, 1.0);
            stack += fmt::format("<div class=\"b{}\" style=\"width:{:.2f}%\"></div>", b, percent);
            cells += fmt::format("<td>{:.1f} %</td>", percent);
        }
        rows +=
            fmt::format("<tr><td class=\"name\">{}</td><td class=\"stack\">{}</td>{}<td>{:.0f}</td></tr>\n",
                        escape_html(row.name), stack, cells, row.count);
    }
    if (rows.empty()) return "";
    return make_table_html(head + "<th>rays</th>", rows) + note_html(escape_html(bars.note));
}

std::string make_facts_html(const Report& report) {
    if (report.facts.empty()) return "";
    std::string body;
    for (const auto& [name, value] : report.facts)
        body += fmt::format("<div><dt>{}</dt><dd>{}</dd></div>\n", escape_html(name), escape_html(value));
    return "<dl>\n" + body + "</dl>\n";
}

/// "peer/depth_rmse_m" gives "peer" and "depth_rmse_m". The group is empty without a '/'.
std::pair<std::string, std::string> split_metric(const std::string& metric_name) {
    const std::size_t slash = metric_name.find('/');
    if (slash == std::string::npos) return {"", metric_name};
    return {metric_name.substr(0, slash), metric_name.substr(slash + 1)};
}

/// Returns +1 if larger values of a metric are better, -1 if smaller ones, 0 if unknown.
int improvement_sign(const std::string& metric) {
    const auto has = [&](std::string_view part) { return metric.find(part) != std::string::npos; };
    for (const char* part : {"rmse", "mae", "medae", "cd_", "lpips"})
        if (has(part)) return -1;
    for (const char* part : {"psnr", "ssim", "f_", "f1", "accuracy", "precision", "recall"})
        if (has(part)) return 1;
    return 0;
}

std::optional<double> find_value(const MetricValues& row, const std::string& metric_name) {
    const auto it = row.find(metric_name);
    return it == row.end() ? std::nullopt : std::optional(it->second);
}

/// Returns the best value of a metric among all columns. Returns nothing if fewer than
/// two columns have it, or if it is unknown whether larger values are better.
std::optional<double> find_best_value(const Report& report, const std::string& metric_name) {
    const int direction = improvement_sign(metric_name);
    std::optional<double> best;
    int n_values = 0;
    for (const auto& [column, row] : report.metrics) {
        const std::optional<double> value = find_value(row, metric_name);
        if (!value || std::isnan(*value)) continue;
        ++n_values;
        if (!best || direction * (*value - *best) > 0.0) best = value;
    }
    const bool is_comparable = report.same_scans && direction != 0 && n_values > 1;
    return is_comparable ? best : std::nullopt;
}

/// Returns the cells of a metric, one for each column. The best value is highlighted.
std::string cells_html(const Report& report, const std::string& metric_name) {
    const std::optional<double> best = find_best_value(report, metric_name);
    std::string cells;
    for (const auto& [column, row] : report.metrics) {
        const auto value = find_value(row, metric_name);
        const char* style = value && best == value ? " class=\"best\"" : "";
        cells += fmt::format("<td{}>{}</td>", style, format_number(value.value_or(NAN)));
    }
    return cells;
}

/// Returns a table of all metrics, sorted by name, so that groups stay together.
std::string metrics_html(const Report& report) {
    std::set<std::string> names;
    for (const auto& [column, row] : report.metrics)
        for (const auto& [name, value] : row) names.insert(name);
    if (names.empty()) return "";
    constexpr double kValuesWidthPercent = 72.0;  // of all columns with values
    std::string head = "<th>Metric</th>", rows, group;
    for (const auto& [column, row] : report.metrics)
        head += fmt::format("<th style=\"width:{:.1f}%\">{}</th>",
                            kValuesWidthPercent / double(report.metrics.size()), escape_html(column));
    for (const std::string& name : names) {
        const auto [name_group, metric] = split_metric(name);
        if (name_group != group)
            rows += fmt::format("<tr class=\"group\"><td colspan=\"{}\">{}</td></tr>\n",
                                report.metrics.size() + 1, escape_html(name_group));
        group = name_group;
        rows += fmt::format("<tr><td class=\"name\">{}</td>{}</tr>\n", escape_html(metric),
                            cells_html(report, name));
    }
    const std::string table = make_table_html(head, rows);
    if (report.metrics.size() <= 1) return table;
    const std::string marks = report.same_scans
                                  ? "Green marks the best value of a row."
                                  : "The columns show different scans, so they cannot be compared.";
    return table + note_html(marks + " A dash means that a value is missing or undefined.");
}

/// Returns a table of the most important metrics with an explanation of each.
std::string key_metrics_html(const Report& report) {
    std::string head = "<th>What</th>", rows;
    for (const auto& [column, row] : report.metrics) head += fmt::format("<th>{}</th>", escape_html(column));
    for (const ReportKeyMetric& key : report.key_metrics) {
        const auto has_metric = [&](const auto& column) { return column.second.contains(key.metric); };
        if (std::ranges::none_of(report.metrics, has_metric)) continue;
        rows += fmt::format("<tr><td class=\"key\">{}<small>{}</small></td>{}</tr>\n", escape_html(key.name),
                            escape_html(key.hint), cells_html(report, key.metric));
    }
    return rows.empty() ? "" : make_table_html(head, rows);
}

/// Returns a chart of curves with a legend.
std::string make_chart_html(const std::string& title, const std::vector<const ReportCurve*>& lines,
                            int width) {
    std::string legend;
    // The chart uses the same order of colours for the curves.
    for (std::size_t i = 0; i < lines.size(); ++i)
        legend += fmt::format("<li><i class=\"c{}\"></i>{}</li>", i % report::kChartColours,
                              escape_html(split_metric(lines[i]->name).second));
    return fmt::format("<div>{}\n{}<ul class=\"legend\">{}</ul></div>\n",
                       title.empty() ? "" : "<h3>" + escape_html(title) + "</h3>",
                       report::draw_svg_chart(lines, width, 300), legend);
}

/// Returns one chart for each group of curves, in the order of the report.
std::string curves_html(const Report& report) {
    struct Chart {
        std::string title;
        std::vector<const ReportCurve*> curves;
    };
    std::vector<Chart> charts;
    bool has_means = false;
    for (const ReportCurve& curve : report.curves) {
        const std::string group = split_metric(curve.name).first;
        auto chart = std::ranges::find(charts, group, &Chart::title);
        if (chart == charts.end()) chart = charts.insert(charts.end(), {group, {}});
        chart->curves.push_back(&curve);
        has_means = has_means || report::has_running_mean(curve);
    }
    if (charts.empty()) return "";
    const int width = charts.size() > 1 ? 550 : 1130;  // two charts side by side, or one
    std::string body;
    for (const Chart& chart : charts) body += make_chart_html(chart.title, chart.curves, width);
    const char* note = "Faint line: all values. Solid line: running mean over one fortieth of the curve.";
    return "<div class=\"charts\">\n" + body + "</div>\n" + (has_means ? note_html(note) : "");
}

/// Returns table cells with the time of a kernel, its percentage of `total_ms`, and a
/// bar. The length of the bar is relative to `longest_ms`. No bar is drawn if that is 0.
std::string timing_cells_html(const std::string& kernel_name, double ms, double total_ms, double longest_ms) {
    const bool is_valid_time = std::isfinite(ms) && ms >= 0.0;
    const std::string share =
        is_valid_time && total_ms > 0.0 ? fmt::format("{:.1f} %", 100.0 * ms / total_ms) : "\u2013";
    const std::string bar = is_valid_time && longest_ms > 0.0
                                ? fmt::format("<div style=\"width:{:.2f}%\"></div>", 100.0 * ms / longest_ms)
                                : "";
    return fmt::format("<td class=\"name\">{}</td><td>{:.3f}</td><td>{}</td><td class=\"bar\">{}</td>",
                       escape_html(kernel_name), ms, share, bar);
}

/// Returns a table of kernel times, sorted from the longest to the shortest. The total is
/// the entry "total" or, if it is missing, the sum of all entries.
std::string timing_html(const MetricValues& kernel_times_ms) {
    std::vector<std::pair<std::string, double>> rows;
    double longest = 0.0, sum = 0.0;
    for (const auto& [name, ms] : kernel_times_ms) {
        if (name == "total") continue;
        rows.emplace_back(name, ms);
        if (std::isfinite(ms)) {
            longest = std::max(longest, ms);
            sum += ms;
        }
    }
    // Times that are not finite come last.
    const auto sort_key = [](const auto& row) { return std::isfinite(row.second) ? row.second : -1.0; };
    std::ranges::stable_sort(rows, std::greater{}, sort_key);
    const auto total = find_value(kernel_times_ms, "total");
    const double total_ms = total.value_or(sum);
    std::string body;
    for (const auto& [name, ms] : rows)
        body += "<tr>" + timing_cells_html(name, ms, total_ms, longest) + "</tr>\n";
    const std::string sums = timing_cells_html(total ? "total" : "sum", total_ms, total_ms, 0.0);
    body += "<tr class=\"total\">" + sums + "</tr>\n";
    return make_table_html(
        "<th style=\"width:26%\">Kernel</th><th style=\"width:12%\">ms</th><th "
        "style=\"width:12%\">share</th><th>of the longest</th>",
        body);
}

/// Returns the images of a figure with captions, as PNG in the page.
std::string figure_html(const ReportFigure& figure) {
    std::string body;
    for (const auto& [caption, image] : figure.images) {
        const double aspect = std::min(kMaxAspect, double(image.columns) / double(image.rows));
        body += fmt::format("<figure><figcaption>{}</figcaption>", escape_html(caption));
        body += fmt::format("<img alt=\"{}\" style=\"aspect-ratio:{:.4f}\" src=\"{}\"></figure>\n",
                            escape_html(caption), aspect, report::png_data_url(image));
    }
    return body;
}

/// Returns the complete page. Its order: 3D views, images, curves, tables, scores, and
/// collapsed details.
std::string page_html(const Report& report) {
    const bool is_collapsed = true;
    std::string html = "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n";
    html += "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n";
    html += fmt::format("<title>{}</title>\n<style>{}</style>\n</head>\n", escape_html(report.title),
                        report::kReportStyle);
    html += fmt::format("<body>\n<main>\n<h1>{}</h1>\n", escape_html(report.title));
    html += fmt::format("<p class=\"summary\">{}</p>\n", escape_html(report.summary));
    for (const ReportView& view : report.views)
        html += section_html(view.title, report::view_html(view, report.views.size()));
    std::vector<std::string> figures(report.figures.size());
    parallel_for(static_cast<int>(figures.size()), [&](int index) {
        figures[std::size_t(index)] = figure_html(report.figures[std::size_t(index)]);
    });
    for (std::size_t i = 0; i < figures.size(); ++i)
        html += section_html(report.figures[i].title, figures[i]);
    html += section_html("Curves", curves_html(report));
    for (const ReportBars& bars : report.bars) html += section_html(bars.title, bars_html(bars));
    for (const ReportTable& texts : report.tables) html += section_html(texts.title, table_html(texts));
    html += section_html("Scores", key_metrics_html(report));
    std::string timings;
    for (const auto& [title, row] : report.timings_ms)
        timings += fmt::format("<h3>{}</h3>\n{}", escape_html(title), timing_html(row));
    html += section_html("All metrics", metrics_html(report), is_collapsed);
    html += section_html("The run", make_facts_html(report), is_collapsed);
    html += section_html("Time by kernel", timings, is_collapsed);
    html += "<footer>Written by relidar</footer>\n</main>\n";
    if (!report.views.empty()) html += report::view_script();
    return html + "</body>\n</html>\n";
}

}  // namespace

void write_report(const std::filesystem::path& path, const Report& report) {
    write_text_file(path, page_html(report));
}

}  // namespace relidar
