// SPDX-License-Identifier: Apache-2.0
#include "console.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdio>

#include <sys/ioctl.h>
#include <unistd.h>

#include <fmt/format.h>

#include "interrupt.hpp"

namespace relidar::cli {
namespace {

// First progress line and interval. Work of less than two seconds prints no progress.
constexpr std::chrono::seconds kPlainFirst{2}, kPlainInterval{10};
constexpr std::chrono::milliseconds kTerminalInterval{100};

// true if the last output on the terminal is a progress line without a line break
bool line_open = false;

/// Assumes that each UTF-8 character needs one column.
std::size_t count_columns(const std::string& text) {
    return static_cast<std::size_t>(std::count_if(text.begin(), text.end(), [](char character) {
        return (static_cast<unsigned char>(character) & 0xC0) != 0x80;
    }));
}

bool is_digit(char character) { return std::isdigit(static_cast<unsigned char>(character)) != 0; }

/// Returns true for a number, also with a unit behind it, and for a missing value.
bool is_numeric_cell(const std::string& cell) {
    if (cell.empty() || cell == "-" || is_digit(cell.front())) return true;
    return cell.size() > 1 && cell.front() == '-' && is_digit(cell[1]);
}

}  // namespace

std::string format_table(const TableRows& rows) {
    // Finds the width of each column, and whether all cells below its title are numbers.
    std::vector<std::size_t> widths;
    std::vector<bool> is_numeric;
    for (std::size_t r = 0; r < rows.size(); ++r) {
        widths.resize(std::max(widths.size(), rows[r].size()), 0);
        is_numeric.resize(widths.size(), true);
        for (std::size_t c = 0; c < rows[r].size(); ++c) {
            widths[c] = std::max(widths[c], count_columns(rows[r][c]));
            const bool is_title = r == 0;
            if (!is_title && !is_numeric_cell(rows[r][c])) is_numeric[c] = false;
        }
    }

    // Numbers are aligned to the right. Spaces at the end of a line are removed.
    std::string text;
    for (const auto& row : rows) {
        std::string line;
        for (std::size_t c = 0; c < row.size(); ++c) {
            const std::string gap(widths[c] - count_columns(row[c]), ' ');
            if (c > 0) line += "  ";
            line += is_numeric[c] ? gap + row[c] : row[c] + gap;
        }
        text += line.substr(0, line.find_last_not_of(' ') + 1) + "\n";
    }
    return text;
}

std::string format_duration(double seconds) {
    if (!std::isfinite(seconds) || seconds > 3.6e8) return "unknown";
    const auto s = static_cast<long long>(std::llround(std::max(seconds, 0.0)));
    if (s < 3600) return fmt::format("{}:{:02}", s / 60, s % 60);
    return fmt::format("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60);
}

/// Formats a size in the largest unit in which it is at least 1, such as "1.3 GiB".
std::string format_bytes(std::uint64_t n_bytes) {
    constexpr const char* kByteUnits[] = {"B", "KiB", "MiB", "GiB", "TiB"};
    auto value = static_cast<double>(n_bytes);
    std::size_t unit = 0;
    while (value >= 1024.0 && unit + 1 < std::size(kByteUnits)) {
        value /= 1024.0;
        ++unit;
    }
    return unit == 0 ? fmt::format("{} B", n_bytes) : fmt::format("{:.1f} {}", value, kByteUnits[unit]);
}

std::string format_number(double value) { return fmt::format("{:.4g}", value); }

std::string make_one_line(std::string text) {
    std::replace_if(
        text.begin(), text.end(), [](unsigned char character) { return std::iscntrl(character) != 0; }, ' ');
    return text;
}

/// Encloses a word in single quotes unless all its characters are harmless.
std::string quote_for_shell(const std::string& word) {
    const bool plain = !word.empty() && std::all_of(word.begin(), word.end(), [](unsigned char character) {
        return std::isalnum(character) ||
               std::string("-_./=:,+%@").find(static_cast<char>(character)) != std::string::npos;
    });
    if (plain) return word;
    std::string quoted = "'";
    // The shell has no escape inside single quotes: ends the quoted text, adds \' and
    // begins a new quoted text.
    for (const char c : word) quoted += c == '\'' ? "'\\''" : std::string(1, c);
    return quoted + "'";
}

double seconds_since(Clock::time_point start) {
    return std::chrono::duration<double>(Clock::now() - start).count();
}

void print(const std::string& text) { std::fputs(text.c_str(), stdout); }

namespace {

bool notes_hidden = false, warnings_hidden = false;

void print_remark(bool hidden, const char* kind, const std::string& text) {
    if (hidden) return;
    end_progress();
    std::fputs(fmt::format("relidar: {}: {}\n", kind, make_one_line(text)).c_str(), stderr);
    std::fflush(stderr);
}

}  // namespace

void print_note(const std::string& text) { print_remark(notes_hidden, "note", text); }
void print_warning(const std::string& text) { print_remark(warnings_hidden, "warning", text); }

void set_quiet(bool hide_notes, bool hide_warnings) {
    notes_hidden = hide_notes;
    warnings_hidden = hide_warnings;
}

void end_progress() {
    if (line_open) std::fputs("\n", stderr);
    line_open = false;
}

TerminalProgress::TerminalProgress(bool quiet) : quiet_(quiet), terminal_(::isatty(STDERR_FILENO) == 1) {}

void TerminalProgress::show_text(const std::string& text, bool ignore_rate_limit) {
    const auto now = Clock::now();
    const bool is_first = last_ == Clock::time_point{};
    Clock::duration interval = is_first ? kPlainFirst : kPlainInterval;
    if (terminal_) interval = kTerminalInterval;
    const bool is_too_early = now - std::max(start_, last_) < interval;
    if (quiet_ || (is_too_early && !ignore_rate_limit)) return;
    last_ = now;
    std::string line = text + "\n";
    if (terminal_) {
        // Cuts the text to the width of the terminal, because the next progress line
        // cannot overwrite a line that wraps. "\r" goes to the start of the line, and
        // "\x1b[K" clears the rest of a longer previous line.
        winsize size{};
        const bool is_width_known = ::ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 1;
        line = "\r" + text.substr(0, is_width_known ? size.ws_col - 1u : std::string::npos) + "\x1b[K";
    }
    std::fputs(line.c_str(), stderr);
    std::fflush(stderr);
    line_open = terminal_;
}

void TerminalProgress::show_step(const std::string& description, std::size_t n_done, std::size_t n_total) {
    const double rate = static_cast<double>(n_done) / std::max(seconds_since(start_), 1e-9);
    show_text(fmt::format("{} {}/{}  {:.2f}/s  remaining {}", description, n_done, n_total, rate,
                          format_duration(static_cast<double>(n_total - n_done) / std::max(rate, 1e-9))),
              n_done == n_total);
}

relidar::Progress progress_callback(TerminalProgress& terminal_progress) {
    return [&terminal_progress](std::string_view description, double done) {
        terminal_progress.show_text(fmt::format("{} {:.0f} %", description, 100.0 * done));
    };
}

relidar::Progress interruptible_progress(TerminalProgress& terminal_progress) {
    return [show = progress_callback(terminal_progress)](std::string_view description, double done) {
        check_interrupt();
        show(description, done);
    };
}

}  // namespace relidar::cli
