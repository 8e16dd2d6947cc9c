// SPDX-License-Identifier: Apache-2.0
// Counts dropped rays by beam and azimuth.
#include "train/drops/sensor_drop.hpp"

#include <algorithm>
#include <atomic>

#include "base/parallel.hpp"

namespace relidar {
namespace {

constexpr int kColumnsPerBin = 3;
// Number of neighbouring bins on each side that contribute to the expected drop rate of a
// bin.
constexpr int kNeighbours = 2;
// Minimum number of rays for a drop rate. With fewer rays, a blind spot of the sensor
// cannot be distinguished from a hole in the scene that a few sweeps have seen.
constexpr std::uint32_t kCertainRays = 60;
// Weight of the prior, as a number of rays. The expected drop rate includes this many
// returned rays. The drop rate of a bin includes this many rays with the expected rate.
constexpr double kPriorRays = 8.0;

int bins_of(const Sequence& sequence) {
    int columns = 0;
    for (const Lidar& lidar : sequence.lidars) columns = std::max(columns, lidar.sensor.columns);
    return std::max(1, columns / kColumnsPerBin);
}

}  // namespace

DropCounts::DropCounts(const Sequence& sequence)
    : sequence_(sequence),
      index_{int(sequence.count_beams()), bins_of(sequence), {}},
      rays_(std::size_t(index_.channels) * std::size_t(index_.bins), 0),
      drops_(rays_.size(), 0) {}

void DropCounts::add(const Frame& frame, std::size_t ray) {
    const auto beam = sequence_.beam_number(frame.lidar, frame.scan.rays.channel[ray]);
    if (!beam) return;
    const std::size_t slot = index_.index(*beam, frame.scan.rays.direction[ray]);
    std::atomic_ref(rays_[slot]).fetch_add(1, std::memory_order_relaxed);
    if (!(frame.scan.range_m[ray] > 0.0f))
        std::atomic_ref(drops_[slot]).fetch_add(1, std::memory_order_relaxed);
}

DropTable DropCounts::persistent() const {
    DropTable table = index_;
    table.probability.assign(rays_.size(), 0.0f);
    const auto share = [](std::uint32_t drops, std::uint32_t rays) { return float(drops) / float(rays); };
    for (int channel = 0; channel < index_.channels; ++channel)
        for (int first = 0; first < index_.bins; ++first) {
            std::uint32_t rays = 0, drops = 0;
            int end = first;
            for (; end < first + index_.bins && rays < kCertainRays; ++end)
                rays += rays_[slot(channel, end)], drops += drops_[slot(channel, end)];
            if (rays < kCertainRays) continue;
            for (int bin = first; bin < end; ++bin) {
                const std::size_t i = slot(channel, bin);
                const float bin_share = rays_[i] > 0 ? share(drops_[i], rays_[i]) : 1.0f;
                table.probability[i] =
                    std::max(table.probability[i], std::min(bin_share, share(drops, rays)));
            }
        }
    return table;
}

double DropCounts::expected(int channel, int bin) const {
    double rays = kPriorRays, drops = 0.0;
    for (int b = bin - kNeighbours; b <= bin + kNeighbours; ++b) {
        const std::size_t i = slot(channel, b);
        rays += double(rays_[i]);
        drops += double(drops_[i]);
    }
    return drops / rays;
}

DropTable DropCounts::shrunk() const {
    DropTable table = index_;
    for (int channel = 0; channel < index_.channels; ++channel)
        for (int bin = 0; bin < index_.bins; ++bin) {
            const std::size_t i = slot(channel, bin);
            const double drops = double(drops_[i]) + kPriorRays * expected(channel, bin);
            table.probability.push_back(static_cast<float>(drops / (double(rays_[i]) + kPriorRays)));
        }
    return table;
}

DropTable observed_drops(const Sequence& sequence, const std::vector<int>& positions) {
    DropCounts counts(sequence);
    parallel_for(static_cast<int>(positions.size()), [&](int k) {
        const Frame& frame = sequence.frames[std::size_t(positions[std::size_t(k)])];
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) counts.add(frame, i);
    });
    return counts.persistent();
}

bool is_blind(const DropTable& observed, const Sequence& sequence, const Frame& frame, std::size_t ray) {
    constexpr float kBlindFrequency = 0.95f;
    const auto beam = sequence.beam_number(frame.lidar, frame.scan.rays.channel[ray]);
    return beam && observed.at(*beam, frame.scan.rays.direction[ray]) >= kBlindFrequency;
}

}  // namespace relidar
