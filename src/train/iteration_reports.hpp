// SPDX-License-Identifier: Apache-2.0
// Reports of iterations: losses, and counts of overflows. The device collects a row of
// losses for each iteration. A report of up to 64 iterations is read back without waiting
// and evaluated a few iterations later (readback_lag.hpp).
#pragma once

#include <array>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include <relidar/diff/densify.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/gpu/stream.hpp>

namespace relidar {

/// A line of the training log.
struct LogLine {
    int step = 0;
    std::array<double, kLossTerms> terms{};  ///< means over the iterations since the last line
    std::uint32_t n_surfels = 0;             ///< number of surfels after this step
    DensifyReport densified;                 ///< changes by densification since the last line
};

/// Counters on the device. Each is read and reset to 0 with a report.
struct DeviceCounts {
    const Array<std::uint32_t>* pass_cap = nullptr;  ///< [1] see ForwardPass::pass_cap_count
    /// [1] see BackwardPass::most_hits. Null if it is not needed.
    const Array<std::uint32_t>* most_hits = nullptr;
    std::uint64_t hit_capacity = 0;
    const Array<std::uint32_t>* overfull = nullptr;  ///< [1] see ForwardPass::overfull_count
    std::uint32_t kept_hits = 0;                     ///< hits that are kept for each ray
};

class IterationReports {
public:
    explicit IterationReports(Device& device);

    /// Returns the row in which the current iteration accumulates its losses.
    TermRow row() const { return {terms_, static_cast<std::uint32_t>(iterations_.size())}; }
    /// Adds an iteration after it was recorded.
    /// @param frame  frame number of the dataset
    void add(int step, int frame) { iterations_.push_back({step, frame}); }
    bool is_full() const { return iterations_.size() == kRows; }
    /// Records a report of the iterations since the last one. Call it after add(), at
    /// most once for each iteration.
    /// @param line  log line that ends with these iterations, if any
    void close(Stream& stream, const DeviceCounts& counts, const std::optional<LogLine>& line);

    /// Contents of a report that was read back.
    struct Report {
        int first_step, last_step;
        std::uint32_t pass_cap, most_hits, overfull;
        /// hit_capacity and kept_hits have the values at the time of recording
        std::uint64_t hit_capacity;
        std::uint32_t kept_hits;
    };
    /// Returns the oldest report that was not returned yet, if it ends at iteration
    /// `last` or earlier. Waits if the device has not completed it.
    /// @throws DataError naming iteration, frame and term if a loss is not finite
    std::optional<Report> take(Stream& stream, int last);
    /// Returns the log lines of the reports that take() has returned, and clears them.
    std::vector<LogLine> take_lines() { return std::exchange(lines_, {}); }

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("term_sums", sums_);
        visit("n_summed", n_summed_);
    }
    /// Returns true if a state that was read from a checkpoint is valid.
    bool is_sound() const { return sums_.size() == kLossTerms; }

private:
    static constexpr std::size_t kRows = 64;

    struct Iteration {
        int step;
        int frame;
    };
    struct Closed {
        std::vector<Iteration> iterations;
        bool counts_hits;
        std::uint64_t hit_capacity;
        std::uint32_t kept_hits;
        std::optional<LogLine> line;
    };
    struct Slot {
        Readback terms, pass_cap, most_hits, overfull;
        explicit Slot(Device& device);
    };

    Array<float> terms_;                 ///< [kRows, kLossTerms] losses of iterations_
    std::vector<Iteration> iterations_;  ///< iterations since the last report
    std::vector<Slot> slots_;            ///< [kReadbackLag] used in turn by iterations
    std::deque<Closed> closed_;          ///< recorded reports, oldest first
    std::vector<double> sums_;           ///< [kLossTerms] sums over the reports since the last log line
    std::uint64_t n_summed_ = 0;         ///< number of iterations in sums_
    std::vector<LogLine> lines_;

    void add_up(const Closed& report, const float* terms);
    void end_line(LogLine line);
};

}  // namespace relidar
