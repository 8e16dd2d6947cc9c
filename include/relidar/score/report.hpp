// SPDX-License-Identifier: Apache-2.0
// A self-contained HTML page about a training or an evaluation.
#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/base/images.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar {

/// One picture row of the report: real, rendered, error.
struct ReportFigure {
    std::string title;
    std::vector<std::pair<std::string, Image>> images;  ///< caption, picture
};
struct ReportCurve {
    /// curves whose names share the part before '/' ("loss/total", "loss/depth") share a
    /// chart
    std::string name;
    std::vector<double> x, y;
};
/// Points of a scan in a view of the report.
struct ReportCloud {
    std::string name;  ///< "real"
    /// [n] about the sensor: x forward, y left, z up; those beyond 300 m are left out
    std::vector<glm::vec3> position_m;
    std::vector<float> intensity;  ///< [n] 0..1
    std::vector<float> error_m;    ///< [n] of the range, NaN where it is not known
};
/// Clouds side by side that the reader turns together. Of large ones every n-th point is
/// kept, so that a page has at most 8 MB.
struct ReportView {
    std::string title;
    std::vector<ReportCloud> clouds;
};
/// How something is spread over bands: a row a class, all its shares together 1.
struct ReportBars {
    struct Row {
        std::string name;           ///< "0 to 10 m"
        double count = 0.0;         ///< of what the shares are of; a row without is left out
        std::vector<double> share;  ///< [bands] 0..1
    };
    std::string title;
    std::string note;                ///< one line
    std::vector<std::string> bands;  ///< at most 5, from good to bad
    std::vector<Row> rows;
};
/// A metric that matters most, as a person calls it.
struct ReportKeyMetric {
    std::string metric;  ///< "strict/depth_medae_m"
    std::string name;    ///< "Typical range error, m"
    std::string hint;    ///< one line: what it says
};
/// A self-contained HTML page: no file or network beside it. First what a person wants to
/// see: summary, views, figures, curves, bars, key metrics; everything else is folded. It
/// holds script where there are views, and only then.
struct Report {
    std::string title;
    std::string summary;  ///< one sentence: what, how good, how long
    std::vector<ReportView> views;
    std::vector<ReportBars> bars;
    std::vector<ReportKeyMetric> key_metrics;  ///< those that no column of metrics has are left out
    std::vector<std::pair<std::string, std::string>> facts;  ///< device, sizes, times
    std::vector<ReportCurve> curves;  ///< log scale where positive and spanning more than 4x
    /// the columns of metrics are scores of the same scans; false: none is better than
    /// another
    bool same_scans = true;
    /// column title -> values, grouped by the part before '/'
    std::vector<std::pair<std::string, MetricRow>> metrics;
    /// table title -> kernel -> ms; shares of "total" or the sum
    std::vector<std::pair<std::string, MetricRow>> timings_ms;
    std::vector<ReportFigure> figures;
};
/// Writes the page. @throws DataError where x and y of a curve differ in length, as for
/// write_atomically
void write_report(const std::filesystem::path& path, const Report& report);

}  // namespace relidar
