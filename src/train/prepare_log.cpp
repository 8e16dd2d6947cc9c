// SPDX-License-Identifier: Apache-2.0
// What is estimated from a log before a scene is trained on it.
#include <relidar/train.hpp>

#include <fmt/format.h>

namespace relidar {

std::vector<std::string> prepare_log(Sequence& sequence, const Split& split, const Config& config) {
    std::vector<std::string> lines;
    const std::size_t n = sequence.sensor.beams.size();
    if (config.sensor.calibrate_range && n > 1) {
        const LaserCalibration found = calibrate_ranges(sequence, split.train);
        lines.push_back(fmt::format("ranges  of {} lasers compared on {:.1f} million returns: {:.1f} mm rms off their planes, {:.1f} mm with an offset each", n,
                                    double(found.returns) * 1e-6, found.rms_before * 1e3, found.rms_after * 1e3));
    }
    if (config.sensor.calibrate_intensity && n > 1) {
        const LaserCalibration found = calibrate_intensity(sequence, split.train);
        lines.push_back(fmt::format("intensities of {} lasers compared on {:.1f} million returns: {:.3f} rms apart, {:.3f} with a gain and offset each", n,
                                    double(found.returns) * 1e-6, found.rms_before, found.rms_after));
    }
    return lines;
}

}  // namespace relidar
