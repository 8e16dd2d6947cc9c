// SPDX-License-Identifier: Apache-2.0
// Copies the reports of iterations from the device to the host, and sums their losses.
#include "train/iteration_reports.hpp"

#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "train/readback_lag.hpp"

namespace relidar {

IterationReports::Slot::Slot(Device& device)
    : terms(device, kRows * kLossTerms * sizeof(float), "loss terms"),
      pass_cap(device, sizeof(std::uint32_t), "pass cap count"),
      most_hits(device, sizeof(std::uint32_t), "most hits"),
      overfull(device, sizeof(std::uint32_t), "rays with more hits than are kept") {}

IterationReports::IterationReports(Device& device)
    : terms_(device, std::vector<float>(kRows * kLossTerms, 0.0f), "loss terms"), sums_(kLossTerms, 0.0) {
    while (slots_.size() < kReadbackLag) slots_.emplace_back(device);
}

void IterationReports::close(Stream& stream, const DeviceCounts& counts, const std::optional<LogLine>& line) {
    if (iterations_.empty()) return;
    Slot& slot = slots_[std::size_t(iterations_.back().step) % kReadbackLag];
    const auto take = [&](Readback& readback, const Buffer& source, std::size_t n_bytes) {
        readback.record(stream, source, n_bytes);
        stream.fill(source);
    };
    take(slot.terms, terms_.buffer(), iterations_.size() * kLossTerms * sizeof(float));
    take(slot.pass_cap, counts.pass_cap->buffer(), sizeof(std::uint32_t));
    if (counts.most_hits) take(slot.most_hits, counts.most_hits->buffer(), sizeof(std::uint32_t));
    take(slot.overfull, counts.overfull->buffer(), sizeof(std::uint32_t));
    closed_.push_back({std::exchange(iterations_, {}), counts.most_hits != nullptr, counts.hit_capacity,
                       counts.kept_hits, line});
}

std::optional<IterationReports::Report> IterationReports::take(Stream& stream, int last) {
    if (closed_.empty() || closed_.front().iterations.back().step > last) return std::nullopt;
    const Closed report = std::move(closed_.front());
    closed_.pop_front();
    const int first_step = report.iterations.front().step, last_step = report.iterations.back().step;
    Slot& slot = slots_[std::size_t(last_step) % kReadbackLag];
    const auto count = [&](Readback& readback) {
        return *static_cast<const std::uint32_t*>(readback.wait(stream));
    };
    add_report_terms(report, static_cast<const float*>(slot.terms.wait(stream)));
    if (report.line) complete_log_line(*report.line);
    return Report{.first_step = first_step,
                  .last_step = last_step,
                  .pass_cap = count(slot.pass_cap),
                  .most_hits = report.counts_hits ? count(slot.most_hits) : 0u,
                  .overfull = count(slot.overfull),
                  .hit_capacity = report.hit_capacity,
                  .kept_hits = report.kept_hits};
}

void IterationReports::add_report_terms(const Closed& report, const float* terms) {
    for (const auto& [step, frame] : report.iterations) {
        for (std::size_t k = 0; k < kLossTerms; ++k) {
            const float term = *terms++;
            if (!std::isfinite(term))
                throw DataError(fmt::format(
                    "training failed at iteration {}, frame {}: the {} loss is {}, expected a finite number",
                    step, frame, kLossTermNames[k], term));
            sums_[k] += term;
        }
    }
    n_summed_ += report.iterations.size();
}

void IterationReports::complete_log_line(LogLine line) {
    for (std::size_t k = 0; k < kLossTerms; ++k)
        line.terms[k] = std::exchange(sums_[k], 0.0) / static_cast<double>(n_summed_);
    n_summed_ = 0;
    lines_.push_back(std::move(line));
}

}  // namespace relidar
