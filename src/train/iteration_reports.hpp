// SPDX-License-Identifier: Apache-2.0
// Copies the losses and the overflow counters of up to 64 iterations to the host, which
// reads them a few iterations later (kReadbackLag).
#pragma once

#include <array>
#include <deque>
#include <optional>
#include <utility>
#include <vector>

#include <relidar/diff/densify.hpp>
#include <relidar/diff/loss.hpp>
#include <relidar/gpu/stream.hpp>

#include "gpu/stream.hpp"

namespace relidar {

/// The host reads the report (losses and counters) of iteration i in iteration i +
/// kReadbackLag. The stream then waits for iteration i anyway, because it reuses its
/// command buffer. Constant, so that training is repeatable.
inline constexpr int kReadbackLag = static_cast<int>(Stream::Impl::kMaxPending);

struct TrainLogLine {
    int step = 0;
    std::array<double, kLossTerms> terms{};  ///< mean losses over the iterations since the last line
    std::uint32_t n_surfels = 0;             ///< number of surfels after this step
    DensifyReport densified;
};

/// Each report copies the counters and resets them to 0.
struct DeviceHitCounters {
    /// [1] number of rays whose traversal stopped at the maximum number of passes
    /// (ForwardPass::n_truncated_rays)
    const Array<std::uint32_t>* pass_cap = nullptr;
    /// [1] largest number of ray-surfel hits in one iteration
    /// (BackwardPass::max_hit_count); null if not needed
    const Array<std::uint32_t>* most_hits = nullptr;
    std::uint64_t hit_capacity = 0;
    /// [1] number of rays with more hits than can be stored
    /// (ForwardPass::n_overflowed_rays)
    const Array<std::uint32_t>* overfull = nullptr;
    std::uint32_t stored_hits_per_ray = 0;  ///< maximum number of stored hits per ray
};

class IterationReports {
public:
    explicit IterationReports(Device& device);

    LossTermRow loss_row() const { return {terms_, static_cast<std::uint32_t>(iterations_.size())}; }
    /// Called after the GPU commands of the iteration were recorded.
    /// @param frame_number  frame number of the dataset
    void add_iteration(int step, int frame_number) { iterations_.push_back({step, frame_number}); }
    bool is_full() const { return iterations_.size() == kMaxLossRows; }
    /// Records a copy of the losses and counters since the last call to the host. Does
    /// not wait. Call after add_iteration(), at most once per iteration.
    /// @param line  added to the training log when the report is read
    void record_copy(Stream& stream, const DeviceHitCounters& counters,
                     const std::optional<TrainLogLine>& line);

    struct IterationGroupReport {
        int first_step, last_step;
        std::uint32_t pass_cap, most_hits, overfull;
        /// values of DeviceHitCounters when record_copy() was called
        std::uint64_t hit_capacity;
        std::uint32_t stored_hits_per_ray;
    };
    /// Returns the oldest unread report if it ends at iteration `max_step` or earlier.
    /// Waits if the device has not finished the report.
    /// @throws DataError naming iteration, frame and term if a loss is not finite
    std::optional<IterationGroupReport> take_oldest(Stream& stream, int max_step);
    /// Of the reports that were read. Removes the lines from this object.
    std::vector<TrainLogLine> take_log_lines() { return std::exchange(lines_, {}); }

    template <class Visitor>
    void visit_state(Visitor&& visit) {
        visit("term_sums", sums_);
        visit("n_summed", n_summed_);
    }

private:
    static constexpr std::size_t kMaxLossRows = 64;

    struct Iteration {
        int step;
        int frame;
    };
    struct ClosedIterationGroup {
        std::vector<Iteration> iterations;
        bool counts_hits;
        std::uint64_t hit_capacity;
        std::uint32_t stored_hits_per_ray;
        std::optional<TrainLogLine> line;
    };
    struct ReportReadbackSlot {
        ReadbackBuffer terms, pass_cap, most_hits, overfull;
        explicit ReportReadbackSlot(Device& device);
    };

    Array<float> terms_;                 ///< [kMaxLossRows, kLossTerms] losses of iterations_
    std::vector<Iteration> iterations_;  ///< iterations since the last report
    /// [kReadbackLag] host buffers; iteration i uses buffer i modulo kReadbackLag
    std::vector<ReportReadbackSlot> slots_;
    std::deque<ClosedIterationGroup> closed_;  ///< reports that the host has not read yet, oldest first
    /// [kLossTerms] sum of each loss over the iterations since the last log line
    std::vector<double> sums_;
    std::uint64_t n_summed_ = 0;  ///< number of iterations in sums_
    std::vector<TrainLogLine> lines_;

    void add_loss_terms(const ClosedIterationGroup& group, const float* loss_terms);
    void store_log_line(TrainLogLine log_line);
};

}  // namespace relidar
