// SPDX-License-Identifier: Apache-2.0
#include "train/reports/iteration_reports.hpp"

#include <cmath>

#include "base/fail.hpp"

namespace relidar {

IterationReports::ReportBuffers::ReportBuffers(Device& device)
    : terms(device, kMaxLossRows * kLossTerms * sizeof(float), "loss terms"),
      n_truncated_rays(device, sizeof(std::uint32_t), "number of truncated rays"),
      n_overflowed_rays(device, sizeof(std::uint32_t), "number of rays with more hits than are stored"),
      max_hits(device, sizeof(std::uint32_t), "largest number of hits") {}

IterationReports::IterationReports(Device& device)
    : terms_(device, std::vector<float>(kMaxLossRows * kLossTerms, 0.0f), "loss terms"),
      sums_(kLossTerms, 0.0) {
    while (int(buffers_.size()) < kReadbackLag) buffers_.emplace_back(device);
}

/// Returns the host buffers of a report. No other unread report uses them, because a
/// report is read kReadbackLag iterations after its last iteration.
IterationReports::ReportBuffers& IterationReports::buffers_of(const std::vector<Iteration>& iterations) {
    return buffers_[std::size_t(iterations.back().step) % kReadbackLag];
}

void IterationReports::record_copy(Stream& stream, const DeviceHitCounters& counters, const HitLimits& limits,
                                   const std::optional<TrainLogLine>& line) {
    if (iterations_.empty()) return;  // nothing new since the last report
    ReportBuffers& host = buffers_of(iterations_);
    // Clears the device counters, so the next report starts with zeros.
    const auto record_and_clear = [&](ReadbackBuffer& readback, const Buffer& source, std::size_t n_bytes) {
        readback.record_copy(stream, source, n_bytes);
        stream.fill(source);
    };
    record_and_clear(host.terms, terms_.buffer(), iterations_.size() * kLossTerms * sizeof(float));
    record_and_clear(host.n_truncated_rays, counters.n_truncated_rays.buffer(), sizeof(std::uint32_t));
    record_and_clear(host.n_overflowed_rays, counters.n_overflowed_rays.buffer(), sizeof(std::uint32_t));
    if (counters.max_hits)
        record_and_clear(host.max_hits, counters.max_hits->buffer(), sizeof(std::uint32_t));
    pending_.push_back({std::exchange(iterations_, {}), limits, line});
}

std::optional<IterationReport> IterationReports::take_oldest(Stream& stream, int max_step) {
    if (pending_.empty() || pending_.front().iterations.back().step > max_step) return std::nullopt;
    const PendingReport pending = std::move(pending_.front());
    pending_.pop_front();
    ReportBuffers& host = buffers_of(pending.iterations);
    add_loss_terms(pending.iterations, static_cast<const float*>(host.terms.wait_for_bytes(stream)));
    if (pending.line) store_log_line(*pending.line);  // the report ends a log interval
    const auto read_counter = [&](ReadbackBuffer& readback) {
        return *static_cast<const std::uint32_t*>(readback.wait_for_bytes(stream));
    };
    return IterationReport{.first_step = pending.iterations.front().step,
                           .last_step = pending.iterations.back().step,
                           .limits = pending.limits,
                           .n_truncated_rays = read_counter(host.n_truncated_rays),
                           .n_overflowed_rays = read_counter(host.n_overflowed_rays),
                           // copied only by a deterministic training
                           .max_hits = host.max_hits.is_pending() ? read_counter(host.max_hits) : 0u};
}

/// Adds the losses of a report to the sums of the current log interval. Stops the
/// training at the first loss that is not finite, and names its iteration.
/// @param loss_terms [iterations, kLossTerms]
void IterationReports::add_loss_terms(const std::vector<Iteration>& iterations, const float* loss_terms) {
    for (std::size_t i = 0; i < iterations.size(); ++i)
        for (std::size_t k = 0; k < kLossTerms; ++k) {
            const float term = loss_terms[i * kLossTerms + k];
            if (!std::isfinite(term))
                fail("training failed at iteration {}, frame {}: the {} loss is {}, expected a finite number",
                     iterations[i].step, iterations[i].frame, kLossTermNames[k], term);
            sums_[k] += term;
        }
    n_summed_ += iterations.size();
}

void IterationReports::store_log_line(TrainLogLine log_line) {
    for (std::size_t k = 0; k < kLossTerms; ++k)
        log_line.terms[k] = std::exchange(sums_[k], 0.0) / static_cast<double>(n_summed_);
    n_summed_ = 0;
    lines_.push_back(std::move(log_line));
}

}  // namespace relidar
