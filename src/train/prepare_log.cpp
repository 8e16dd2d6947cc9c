// SPDX-License-Identifier: Apache-2.0
// What is estimated from a log before a scene is trained on it.
#include <relidar/train.hpp>

#include <fmt/format.h>

namespace relidar {

std::vector<std::string> prepare_log(Sequence& sequence, const Split& split, const Config& config) {
    std::vector<std::string> lines;
    if (config.sensor.calibrate_intensity && sequence.sensor.beams.size() > 1) {
        const IntensityCalibration found = calibrate_intensity(sequence, split.train);
        lines.push_back(fmt::format("lasers  {} compared on {:.1f} million returns of shared places: intensity differs by {:.3f} rms, {:.3f} with a gain and offset each",
                                    sequence.sensor.beams.size(), double(found.returns) * 1e-6, found.rms_before, found.rms_after));
    }
    return lines;
}

}  // namespace relidar
