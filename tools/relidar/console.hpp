// SPDX-License-Identifier: Apache-2.0
// Text output for the terminal: tables, durations, sizes and a progress line. Results go
// to stdout, progress goes to stderr. On a terminal the progress line overwrites itself.
// Otherwise a plain line is printed after two seconds and then every ten seconds.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>

namespace relidar::cli {

/// Formats rows of cells as aligned columns, two spaces apart. The first row is the
/// header. Columns of numbers are right-aligned.
std::string table(const std::vector<std::vector<std::string>>& rows);

std::string duration(double seconds);          ///< For example "0:42" or "1:54:00".
std::string byte_size(std::uint64_t n_bytes);  ///< For example "512 B" or "1.3 GiB".
std::string number(double value);              ///< Formats a number with four significant digits.
std::string one_line(std::string text);  ///< Replaces line breaks and other control characters by spaces.
std::string shell_word(const std::string& word);  ///< Quotes a word if a shell would require quotes.

/// Writes to stdout.
void print(const std::string& text);

/// Prints a one-line warning on stderr. The command continues.
void note(const std::string& text);

/// Ends the current progress line on the terminal with a line break.
void end_progress_line();

class Progress {
public:
    explicit Progress(bool quiet);
    ~Progress() { end_progress_line(); }
    Progress(const Progress&) = delete;
    Progress& operator=(const Progress&) = delete;

    /// Shows a progress text, unless the previous text was shown too recently.
    /// @param now shows the text in any case
    void show(const std::string& text, bool now = false);

    /// Shows "what 3/10  2.1/s  eta 0:03", the progress of `total` equal work items.
    void count(const std::string& what, std::size_t done, std::size_t total);

private:
    using Clock = std::chrono::steady_clock;
    bool quiet_;
    bool terminal_;
    Clock::time_point start_ = Clock::now();
    Clock::time_point last_{};
};

/// Returns a callback that shows the progress of library functions as "what 30 %".
relidar::Progress shown_by(Progress& progress);

}  // namespace relidar::cli
