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

/// Counters of one element each. A report copies them and resets them to 0.
struct DeviceHitCounters {
    const Array<std::uint32_t>& n_truncated_rays;   ///< ForwardPass::n_truncated_rays()
    const Array<std::uint32_t>& n_overflowed_rays;  ///< ForwardPass::n_overflowed_rays()
    /// BackwardPass::max_hit_count(), hits of a batch; null if not needed
    const Array<std::uint32_t>* max_hits;
};

/// Capacities for hits. They are the same for all iterations of a report.
struct HitLimits {
    std::uint64_t hits_per_batch;  ///< BackwardPass::hit_capacity()
    std::uint32_t hits_per_ray;    ///< Renderer::stored_hits_per_ray()
};

/// Results of some consecutive iterations.
struct IterationReport {
    int first_step, last_step;
    HitLimits limits;
    std::uint32_t n_truncated_rays = 0, n_overflowed_rays = 0, max_hits = 0;
};

class IterationReports {
public:
    explicit IterationReports(Device& device);

    LossTermRow loss_row() const { return {terms_, static_cast<std::uint32_t>(iterations_.size())}; }
    /// Called after the GPU commands of the iteration were recorded.
    void add_iteration(int step, int frame_number) { iterations_.push_back({step, frame_number}); }
    bool is_full() const { return iterations_.size() == kMaxLossRows; }
    /// Ends a report: records a copy of the losses and counters since the last call to
    /// the host. Does not wait. Call after add_iteration(), at most once per iteration.
    /// @param line  added to the training log when the report is read
    void record_copy(Stream& stream, const DeviceHitCounters& counters, const HitLimits& limits,
                     const std::optional<TrainLogLine>& line);
    /// Returns the oldest unread report if it ends at iteration `max_step` or earlier.
    /// Waits if the device has not finished the report.
    /// @throws DataError naming iteration, frame and term if a loss is not finite
    std::optional<IterationReport> take_oldest(Stream& stream, int max_step);
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
    /// A report whose losses and counters are still in the host buffers.
    struct PendingReport {
        std::vector<Iteration> iterations;
        HitLimits limits;
        std::optional<TrainLogLine> line;
    };
    /// Host buffers for the losses and counters of one report.
    struct ReportBuffers {
        ReadbackBuffer terms, n_truncated_rays, n_overflowed_rays, max_hits;
        explicit ReportBuffers(Device& device);
    };

    Array<float> terms_;                  ///< [kMaxLossRows, kLossTerms] losses of iterations_
    std::vector<Iteration> iterations_;   ///< iterations since the last report
    std::vector<ReportBuffers> buffers_;  ///< [kReadbackLag]
    std::deque<PendingReport> pending_;   ///< oldest first
    /// [kLossTerms] sum of each loss over the iterations since the last log line
    std::vector<double> sums_;
    std::uint64_t n_summed_ = 0;  ///< number of iterations in sums_
    std::vector<TrainLogLine> lines_;

    ReportBuffers& buffers_of(const std::vector<Iteration>& iterations);
    void add_loss_terms(const std::vector<Iteration>& iterations, const float* loss_terms);
    void store_log_line(TrainLogLine log_line);
};

}  // namespace relidar
