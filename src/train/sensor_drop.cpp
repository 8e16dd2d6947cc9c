// SPDX-License-Identifier: Apache-2.0
// Counting ray-drop by beam and azimuth.
#include "train/sensor_drop.hpp"

#include <algorithm>

namespace relidar {

namespace {

constexpr int kColumnsPerBin = 3;
constexpr std::uint32_t kPriorRays = 8;   ///< returns assumed before anything was seen

int channels_of(const Sequence& sequence) {
    int channels = 0;
    for (const Frame& frame : sequence.frames)
        for (const std::uint16_t c : frame.scan.rays.channel) channels = std::max(channels, c + 1);
    return channels;
}

}  // namespace

DropCounts::DropCounts(const Sequence& sequence)
    : index_{channels_of(sequence), std::max(1, sequence.sensor.columns / kColumnsPerBin), {}},
      rays_(std::size_t(index_.channels) * std::size_t(index_.bins), 0),
      drops_(rays_.size(), 0) {}

void DropCounts::add(std::uint16_t channel, const glm::vec3& direction, bool dropped) {
    if (channel >= index_.channels) return;
    const std::size_t slot = index_.index(channel, direction);
    ++rays_[slot];
    drops_[slot] += dropped;
}

DropTable DropCounts::frequency(int min_rays) const {
    DropTable table = index_;
    for (std::size_t i = 0; i < rays_.size(); ++i)
        table.probability.push_back(rays_[i] >= static_cast<std::uint32_t>(min_rays) ? float(drops_[i]) / float(std::max(rays_[i], 1u)) : 0.0f);
    return table;
}

DropTable DropCounts::shrunk() const {
    DropTable table = index_;
    for (std::size_t i = 0; i < rays_.size(); ++i) table.probability.push_back(float(drops_[i]) / float(rays_[i] + kPriorRays));
    return table;
}

DropTable observed_drops(const Sequence& sequence, const std::vector<int>& positions) {
    DropCounts counts(sequence);
    for (const int position : positions) {
        const Scan& scan = sequence.frames[std::size_t(position)].scan;
        for (std::size_t i = 0; i < scan.range_m.size(); ++i) counts.add(scan.rays.channel[i], scan.rays.direction[i], !(scan.range_m[i] > 0.0f));
    }
    return counts.frequency(static_cast<int>(positions.size()));
}

}  // namespace relidar
