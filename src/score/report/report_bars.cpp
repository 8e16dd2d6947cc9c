// SPDX-License-Identifier: Apache-2.0
#include "report_parts.hpp"

#include <algorithm>

#include <fmt/format.h>

#include "html.hpp"

namespace relidar::report_detail {

std::string make_stacked_bars_html(const ReportBars& bars) {
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
    return fmt::format(
        "<div "
        "class=\"scroll\"><table>\n<thead><tr>{}<th>rays</th></tr></thead>\n<tbody>\n{}</tbody></table></"
        "div>\n"
        "<p class=\"note\">{}</p>\n",
        head, rows, escape_html(bars.note));
}

}  // namespace relidar::report_detail
