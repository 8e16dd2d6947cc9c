// SPDX-License-Identifier: Apache-2.0
// Converts settings to options of the scan registration. Private to train.
#pragma once

#include <relidar/log/registration.hpp>
#include <relidar/run/config.hpp>

namespace relidar {

inline bool should_register_sensor(const TrainConfig& config) {
    return config.pose_register && config.refines("sensor");
}

/// Returns the registration options that follow from the settings. The caller must set
/// `stop`, `progress` and `group`.
RegisterOptions make_register_options(const Sequence& sequence, const Config& config);

}  // namespace relidar
