// SPDX-License-Identifier: Apache-2.0
// Prints tables, durations, sizes and a progress line. Results go to stdout. Progress
// goes to stderr. On a terminal, each progress line overwrites the previous progress
// line. If stderr is a file, a progress line is printed after two seconds and then every
// ten seconds.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>

namespace relidar::cli {

using TableRows = std::vector<std::vector<std::string>>;
/// Aligned columns; columns of numbers to the right. The first row is the header.
std::string format_table(const TableRows& rows);

std::string format_duration(double seconds);  ///< For example "0:42" or "1:54:00".
std::string format_bytes(std::uint64_t n_bytes);
std::string format_number(double value);  ///< Formats a number with four significant digits.
std::string make_one_line(std::string text);
std::string quote_for_shell(const std::string& word);

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point start);
inline double ms_since(Clock::time_point start) { return 1e3 * seconds_since(start); }

void print(const std::string& text);

/// One line on stderr. A warning says that a result is probably not what the user
/// expects.
void print_note(const std::string& text);
void print_warning(const std::string& text);
void set_quiet(bool hide_notes, bool hide_warnings = false);

/// Other output then starts on a new line.
void end_progress();

class TerminalProgress {
public:
    explicit TerminalProgress(bool quiet);
    ~TerminalProgress() { end_progress(); }
    TerminalProgress(const TerminalProgress&) = delete;
    TerminalProgress& operator=(const TerminalProgress&) = delete;

    /// Shows a text, unless the previous text was shown only a short time ago. A terminal
    /// overwrites the line, and a file receives a new line.
    void show_text(const std::string& text, bool ignore_rate_limit = false);

    /// Shows "what 3/10  2.1/s  remaining 0:03".
    void show_step(const std::string& description, std::size_t n_done, std::size_t n_total);

private:
    bool quiet_;
    bool terminal_;
    Clock::time_point start_ = Clock::now();
    Clock::time_point last_{};
};

relidar::Progress progress_callback(TerminalProgress& terminal_progress);
/// After Ctrl-C, the callback throws an Error with exit code 130.
relidar::Progress interruptible_progress(TerminalProgress& terminal_progress);

}  // namespace relidar::cli
