// SPDX-License-Identifier: Apache-2.0
// What iterations tell: losses, and counts of what must not happen. Rows of losses
// collect on the device; a report of up to 64 iterations is read back without a wait and
// looked at a few iterations later (readback_lag.hpp).
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

/// A line of the log.
struct LogLine {
    int step = 0;
    std::array<double, kLossTerms> terms{};  ///< means over the iterations since the last line
    std::uint32_t n_surfels = 0;             ///< after this step, as the next
    DensifyReport densified;                 ///< since the last line
};

/// Counts on the device: each is read and set to 0 with a report.
struct DeviceCounts {
    const Array<std::uint32_t>* pass_cap = nullptr;  ///< [1] ForwardPass::pass_cap_count
    /// [1] BackwardPass::most_hits; null where nobody asks
    const Array<std::uint32_t>* most_hits = nullptr;
    std::uint64_t hit_capacity = 0;
    const Array<std::uint32_t>* overfull = nullptr;  ///< [1] ForwardPass::overfull_count
    std::uint32_t kept_hits = 0;                     ///< of a ray
};

class IterationReports {
public:
    explicit IterationReports(Device& device);

    /// Where the iteration being recorded adds its losses.
    TermRow row() const { return {terms_, static_cast<std::uint32_t>(iterations_.size())}; }
    /// That iteration is recorded. @param frame  the dataset's own number
    void add(int step, int frame) { iterations_.push_back({step, frame}); }
    bool is_full() const { return iterations_.size() == kRows; }
    /// Records a report of the iterations since the last one: at most one an iteration,
    /// after add(). @param line  that ends with them
    void close(Stream& stream, const DeviceCounts& counts, const std::optional<LogLine>& line);

    /// A report as the device left it.
    struct Report {
        int first_step, last_step;
        std::uint32_t pass_cap, most_hits, overfull;
        std::uint64_t hit_capacity;  ///< when it was recorded, as the next
        std::uint32_t kept_hits;
    };
    /// The oldest report not looked at, where it ends at iteration `last` or before.
    /// Waits where it is not done.
    /// @throws DataError naming iteration, frame and term where a loss is not finite
    std::optional<Report> take(Stream& stream, int last);
    /// Lines of the reports taken.
    std::vector<LogLine> take_lines() { return std::exchange(lines_, {}); }

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("term_sums", sums_);
        visit("n_summed", n_summed_);
    }
    /// Whether what was read back can be gone on with.
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

    Array<float> terms_;                 ///< [kRows, kLossTerms] of iterations_
    std::vector<Iteration> iterations_;  ///< since the last report
    std::vector<Slot> slots_;            ///< [kReadbackLag] by iteration
    std::deque<Closed> closed_;          ///< oldest first
    std::vector<double> sums_;           ///< [kLossTerms] of the reports taken since the last line
    std::uint64_t n_summed_ = 0;         ///< iterations in them
    std::vector<LogLine> lines_;

    void add_up(const Closed& report, const float* terms);
    void end_line(LogLine line);
};

}  // namespace relidar
