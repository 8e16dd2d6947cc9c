// SPDX-License-Identifier: Apache-2.0
// Counting ray-drop by beam and azimuth.
#include "train/sensor_drop.hpp"

#include <algorithm>

namespace relidar {
namespace {

constexpr int kColumnsPerBin = 3;
constexpr int kNeighbours = 2;              // bins to either side that a bin is expected to be like
constexpr double kPriorRays = 8.0;          // returns assumed before anything was seen, and what the expectation counts in a bin

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
    ++rays_[slot];
    drops_[slot] += !(frame.scan.range_m[ray] > 0.0f);
}

DropTable DropCounts::frequency(int min_rays) const {
    DropTable table = index_;
    for (std::size_t i = 0; i < rays_.size(); ++i)
        table.probability.push_back(rays_[i] >= static_cast<std::uint32_t>(min_rays) ? float(drops_[i]) / float(std::max(rays_[i], 1u))
                                                                                     : 0.0f);
    return table;
}

double DropCounts::expected(int channel, int bin) const {
    double rays = kPriorRays, drops = 0.0;
    for (int b = bin - kNeighbours; b <= bin + kNeighbours; ++b) {
        const auto i = std::size_t(channel) * std::size_t(index_.bins) + std::size_t((b + index_.bins) % index_.bins);
        rays += double(rays_[i]);
        drops += double(drops_[i]);
    }
    return drops / rays;
}

DropTable DropCounts::shrunk() const {
    DropTable table = index_;
    for (int channel = 0; channel < index_.channels; ++channel)
        for (int bin = 0; bin < index_.bins; ++bin) {
            const auto i = std::size_t(channel) * std::size_t(index_.bins) + std::size_t(bin);
            const double drops = double(drops_[i]) + kPriorRays * expected(channel, bin);
            table.probability.push_back(static_cast<float>(drops / (double(rays_[i]) + kPriorRays)));
        }
    return table;
}

DropTable observed_drops(const Sequence& sequence, const std::vector<int>& positions) {
    DropCounts counts(sequence);
    for (const int position : positions) {
        const Frame& frame = sequence.frames[std::size_t(position)];
        for (std::size_t i = 0; i < frame.scan.range_m.size(); ++i) counts.add(frame, i);
    }
    return counts.frequency(static_cast<int>(positions.size()));
}

}  // namespace relidar
