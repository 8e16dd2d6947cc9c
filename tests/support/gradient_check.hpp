// SPDX-License-Identifier: Apache-2.0
// Compares gradients with central differences, row by row. A row is a parameter of a
// surfel (mean [3], rotation [4], ...). The error of a row is |difference - analytic|
// divided by the row's norm (docs/architecture.md section 9).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "tolerances.hpp"

namespace relidar::test {

/// Expected and actual gradients of a parameter group.
struct GradientGroup {
    std::vector<std::vector<double>> expected;  ///< [rows][components]
    std::vector<std::vector<double>> actual;

    static double norm(const std::vector<double>& row) {
        double sum = 0.0;
        for (double x : row) sum += x * x;
        return std::sqrt(sum);
    }
    double find_largest_row() const {
        double largest = 0.0;
        for (const auto& row : expected) largest = std::max(largest, norm(row));
        return largest;
    }
    std::size_t count_nonzero_rows() const {
        return std::size_t(
            std::count_if(expected.begin(), expected.end(), [](const auto& row) { return norm(row) > 0.0; }));
    }
    /// Counts the rows whose expected gradient exceeds the bound for small rows, but
    /// whose actual gradient is zero.
    std::size_t count_missing_rows() const {
        const double bound = kSmallRow * find_largest_row();
        std::size_t missing = 0;
        for (std::size_t i = 0; i < expected.size(); ++i)
            missing += norm(expected[i]) > bound && norm(actual[i]) == 0.0;
        return missing;
    }
    /// Returns the largest |actual - expected| / max(|expected|, bound for small rows),
    /// or infinity if a value is not finite.
    double compute_worst_error() const {
        const double bound = kSmallRow * find_largest_row();
        double worst = 0.0;
        for (std::size_t i = 0; i < expected.size(); ++i) {
            std::vector<double> difference = expected[i];
            for (std::size_t k = 0; k < difference.size(); ++k) difference[k] -= actual[i][k];
            const double error = norm(difference), scale = std::max(norm(expected[i]), bound);
            if (!std::isfinite(error)) return HUGE_VAL;
            if (error > 0.0) worst = std::max(worst, scale > 0.0 ? error / scale : HUGE_VAL);
        }
        return worst;
    }
};

/// Collects gradient rows in groups by name, and prints a table of the groups at the end.
class GradientTable {
public:
    void add_row(const std::string& group, std::vector<double> expected, std::vector<double> actual) {
        groups_[group].expected.push_back(std::move(expected));
        groups_[group].actual.push_back(std::move(actual));
    }
    void add_table(const GradientTable& other) {
        for (const auto& [name, group] : other.groups_)
            for (std::size_t i = 0; i < group.expected.size(); ++i)
                add_row(name, group.expected[i], group.actual[i]);
    }
    const std::map<std::string, GradientGroup>& groups() const { return groups_; }
    double compute_worst_error() const {
        double worst = 0.0;
        for (const auto& [name, group] : groups_) worst = std::max(worst, group.compute_worst_error());
        return worst;
    }
    void print(const std::string& title) const {
        std::printf("%s\n  %-16s %8s %8s %8s %14s %14s\n", title.c_str(), "group", "rows", "nonzero",
                    "missing", "largest row", "worst rel.");
        for (const auto& [name, g] : groups_)
            std::printf("  %-16s %8zu %8zu %8zu %14.4e %14.3e\n", name.c_str(), g.expected.size(),
                        g.count_nonzero_rows(), g.count_missing_rows(), g.find_largest_row(),
                        g.compute_worst_error());
        std::fflush(stdout);
    }

private:
    std::map<std::string, GradientGroup> groups_;
};

/// Computes d(sum of terms)/d(component) by central differences. Each term is differenced
/// before the sum, so that the cancellation error is the error of a single term.
/// @param set set(k, offset) adds the offset to the original value of component k. It is
/// called with h, -h and 0.
/// @param terms computes the loss as a list of terms at the current parameters
inline std::vector<double> compute_central_differences(int components,
                                                       const std::function<void(int, double)>& set,
                                                       const std::function<std::vector<double>()>& terms,
                                                       double h = kDifferenceStep) {
    std::vector<double> result;
    for (int k = 0; k < components; ++k) {
        set(k, h);
        const std::vector<double> above = terms();
        set(k, -h);
        const std::vector<double> below = terms();
        set(k, 0.0);
        double sum = 0.0;
        for (std::size_t i = 0; i < above.size(); ++i) sum += above[i] - below[i];
        result.push_back(sum / (2.0 * h));
    }
    return result;
}

/// Computes central differences with respect to a parameter that is stored as consecutive
/// doubles.
inline std::vector<double> compute_central_differences(double* parameter, int components,
                                                       const std::function<std::vector<double>()>& terms,
                                                       double h = kDifferenceStep) {
    const std::vector<double> start(parameter, parameter + components);
    return compute_central_differences(
        components, [&](int k, double offset) { parameter[k] = start[std::size_t(k)] + offset; }, terms, h);
}

/// Adds a row that compares a derivative with central differences.
/// @param parameter,derivative [components]
inline void add_differences(GradientTable& table, const std::string& group, double* parameter,
                            const double* derivative, int components,
                            const std::function<std::vector<double>()>& terms, double h = kDifferenceStep) {
    table.add_row(group, compute_central_differences(parameter, components, terms, h),
                  {derivative, derivative + components});
}

}  // namespace relidar::test
