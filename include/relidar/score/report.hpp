// SPDX-License-Identifier: Apache-2.0
// Writes a self-contained HTML report about a training or an result.
#pragma once

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/base/images.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar {

/// the real image, the rendered image and their difference
struct ReportFigure {
    std::string title;
    std::vector<std::pair<std::string, Image>> images;  ///< caption and image
};
struct ReportCurve {
    /// For example "loss/total". Curves with the same text before '/' are drawn in one
    /// chart.
    std::string name;
    std::vector<double> x, y;
};
struct ReportCloud {
    std::string name;  ///< name, for example "real"
    /// [n] sensor frame: x forward, y left, z up, metres. Points beyond 300 m are left
    /// out.
    std::vector<glm::vec3> position_m;
    std::vector<float> intensity;  ///< [n] 0..1
    std::vector<float> error_m;    ///< [n] range error; NaN if unknown
};
/// Point clouds that are drawn side by side in 3D. All clouds rotate together. Large
/// clouds are subsampled so that the page has at most 8 MB.
struct ReportView {
    std::string title;
    std::vector<ReportCloud> clouds;
};
/// each row shows fractions that sum to 1
struct ReportBars {
    struct Row {
        std::string name;           ///< name, for example "0 to 10 m"
        double count = 0.0;         ///< Number of samples in the row. A row without samples is left out.
        std::vector<double> share;  ///< [bands] fractions, 0..1
    };
    std::string title;
    std::string note;                ///< One line of text that explains the chart.
    std::vector<std::string> bands;  ///< Names of at most 5 bands, ordered from good to bad.
    std::vector<Row> rows;
};
/// The first column is aligned to the left.
struct ReportTable {
    std::string title;
    std::string note;  ///< One line of text that explains the table.
    /// [rows][columns] the first row contains the titles
    std::vector<std::vector<std::string>> rows;
};
struct ReportKeyMetric {
    std::string metric;  ///< name of the metric, for example "strict/depth_medae_m"
    std::string name;    ///< name in the report, for example "Typical range error, m"
    std::string hint;    ///< a line that explains the metric
};
/// The summary, views, figures, curves, bars, tables and key metrics come first. All
/// other parts are collapsed at the end. The page contains a script only if it has views.
struct Report {
    std::string title;
    /// One sentence: what was done, the quality of the result and the duration.
    std::string summary;
    std::vector<ReportView> views;
    std::vector<ReportBars> bars;
    /// A table without rows below the titles is left out.
    std::vector<ReportTable> tables;
    /// A metric that is not in `metrics` is left out.
    std::vector<ReportKeyMetric> key_metrics;
    std::vector<std::pair<std::string, std::string>> facts;  ///< device, sizes, times
    /// Logarithmic if all values are positive and span more than a factor of 4.
    std::vector<ReportCurve> curves;
    /// Otherwise the columns cannot be compared, so the report does not highlight the
    /// best one.
    bool same_scans = true;
    /// Title of the column and its values, grouped by the part of their name before '/'.
    std::vector<std::pair<std::string, MetricValues>> metrics;
    /// Title of the table and milliseconds of each kernel. Percentages refer to the entry
    /// "total" or, if it is missing, to the sum.
    std::vector<std::pair<std::string, MetricValues>> timings_ms;
    std::vector<ReportFigure> figures;
};
/// Writes the report as an HTML page.
/// @throws DataError if x and y of a curve differ in length, and like write_atomically()
void write_report(const std::filesystem::path& path, const Report& report);

}  // namespace relidar
