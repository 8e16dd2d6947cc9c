// SPDX-License-Identifier: Apache-2.0
// Text for people: tables, durations, sizes, and a progress line that rewrites itself on
// a terminal and comes as a plain line after two seconds and then every ten elsewhere.
// Results go to stdout, progress to stderr.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>

namespace relidar::cli {

/// Rows of cells with aligned columns, two blanks apart; the first row is the head.
/// Columns of numbers are right-aligned.
std::string table(const std::vector<std::vector<std::string>>& rows);

std::string duration(double seconds);             ///< "0:42", "1:54:00"
std::string byte_size(std::uint64_t n_bytes);     ///< "512 B", "1.3 GiB"
std::string number(double value);                 ///< four significant digits
std::string one_line(std::string text);           ///< line breaks and other control characters become blanks
std::string shell_word(const std::string& word);  ///< quoted where a shell would need it

/// Writes to stdout.
void print(const std::string& text);

/// One line on stderr about something that went wrong and does not end the command.
void note(const std::string& text);

/// Ends a progress line that is still open on the terminal.
void end_progress_line();

class Progress {
public:
    explicit Progress(bool quiet);
    ~Progress() { end_progress_line(); }
    Progress(const Progress&) = delete;
    Progress& operator=(const Progress&) = delete;

    /// @param now prints it whenever the last one was
    void show(const std::string& text, bool now = false);

    /// "what 3/10  2.1/s  eta 0:03" of n equal pieces of work.
    void count(const std::string& what, std::size_t done, std::size_t total);

private:
    using Clock = std::chrono::steady_clock;
    bool quiet_;
    bool terminal_;
    Clock::time_point start_ = Clock::now();
    Clock::time_point last_{};
};

/// What the library tells of its progress, shown as "what 30 %".
relidar::Progress shown_by(Progress& progress);

}  // namespace relidar::cli
