// SPDX-License-Identifier: Apache-2.0
#include "train/iteration_reports.hpp"

#include <cmath>

#include "base/fail.hpp"

namespace relidar {

/// Allocates host memory for the losses and counters of one report.
IterationReports::ReportReadbackSlot::ReportReadbackSlot(Device& device)
    : terms(device, kMaxLossRows * kLossTerms * sizeof(float), "loss terms"),
      pass_cap(device, sizeof(std::uint32_t), "number of truncated rays"),
      most_hits(device, sizeof(std::uint32_t), "largest number of hits"),
      overfull(device, sizeof(std::uint32_t), "number of rays with more hits than are stored") {}

IterationReports::IterationReports(Device& device)
    : terms_(device, std::vector<float>(kMaxLossRows * kLossTerms, 0.0f), "loss terms"),
      sums_(kLossTerms, 0.0) {
    while (int(slots_.size()) < kReadbackLag) slots_.emplace_back(device);
}

void IterationReports::record_copy(Stream& stream, const DeviceHitCounters& counters,
                                   const std::optional<TrainLogLine>& line) {
    if (iterations_.empty()) return;  // nothing new since the last report
    // Host buffers. After kReadbackLag iterations, the host has read them: used again.
    ReportReadbackSlot& slot = slots_[std::size_t(iterations_.back().step) % kReadbackLag];
    // Clears the device counters, so the next report starts with zeros.
    const auto record_and_clear = [&](ReadbackBuffer& readback, const Buffer& source, std::size_t n_bytes) {
        readback.record_copy(stream, source, n_bytes);
        stream.fill(source);
    };
    record_and_clear(slot.terms, terms_.buffer(), iterations_.size() * kLossTerms * sizeof(float));
    record_and_clear(slot.pass_cap, counters.pass_cap->buffer(), sizeof(std::uint32_t));
    if (counters.most_hits)
        record_and_clear(slot.most_hits, counters.most_hits->buffer(), sizeof(std::uint32_t));
    record_and_clear(slot.overfull, counters.overfull->buffer(), sizeof(std::uint32_t));
    closed_.push_back({.iterations = std::exchange(iterations_, {}),
                       .counts_hits = counters.most_hits != nullptr,
                       .hit_capacity = counters.hit_capacity,
                       .stored_hits_per_ray = counters.stored_hits_per_ray,
                       .line = line});
}

std::optional<IterationReports::IterationGroupReport> IterationReports::take_oldest(Stream& stream,
                                                                                    int max_step) {
    if (closed_.empty() || closed_.front().iterations.back().step > max_step) return std::nullopt;
    const ClosedIterationGroup group = std::move(closed_.front());
    closed_.pop_front();
    const int first_step = group.iterations.front().step, last_step = group.iterations.back().step;
    // record_copy() selected the slot by the last step of the group.
    ReportReadbackSlot& slot = slots_[std::size_t(last_step) % kReadbackLag];
    const auto read_counter = [&](ReadbackBuffer& readback) {
        return *static_cast<const std::uint32_t*>(readback.wait_for_bytes(stream));
    };
    add_loss_terms(group, static_cast<const float*>(slot.terms.wait_for_bytes(stream)));
    if (group.line) store_log_line(*group.line);
    return IterationGroupReport{.first_step = first_step,
                                .last_step = last_step,
                                .pass_cap = read_counter(slot.pass_cap),
                                .most_hits = group.counts_hits ? read_counter(slot.most_hits) : 0u,
                                .overfull = read_counter(slot.overfull),
                                .hit_capacity = group.hit_capacity,
                                .stored_hits_per_ray = group.stored_hits_per_ray};
}

/// Adds the losses of a group to the sums of the current log interval. Stops the training
/// at the first loss that is not finite, and names its iteration.
/// @param loss_terms [iterations, kLossTerms]
void IterationReports::add_loss_terms(const ClosedIterationGroup& group, const float* loss_terms) {
    for (std::size_t i = 0; i < group.iterations.size(); ++i)
        for (std::size_t k = 0; k < kLossTerms; ++k) {
            const float term = loss_terms[i * kLossTerms + k];
            if (!std::isfinite(term))
                fail("training failed at iteration {}, frame {}: the {} loss is {}, expected a finite number",
                     group.iterations[i].step, group.iterations[i].frame, kLossTermNames[k], term);
            sums_[k] += term;
        }
    n_summed_ += group.iterations.size();
}

void IterationReports::store_log_line(TrainLogLine log_line) {
    for (std::size_t k = 0; k < kLossTerms; ++k)
        log_line.terms[k] = std::exchange(sums_[k], 0.0) / static_cast<double>(n_summed_);
    n_summed_ = 0;
    lines_.push_back(std::move(log_line));
}

}  // namespace relidar
