// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/registration/registration.hpp>
#include <relidar/run/config.hpp>

namespace relidar {

inline bool registers_sensors(const TrainConfig& config) {
    return config.pose_register && config.refines("sensor");
}

/// Returns the registration options that follow from the settings. The caller must set
/// RegistrationOptions::stop, progress and group.
RegistrationOptions registration_options(const Log& log, const Config& config);

}  // namespace relidar
