// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <relidar/registration/registration.hpp>
#include <relidar/run/config.hpp>

namespace relidar {

inline bool should_register_sensor_poses(const TrainConfig& config) {
    return config.pose_register && config.is_pose_refinement_enabled_for("sensor");
}

/// The caller must set RegistrationOptions::stop, progress and group.
RegistrationOptions make_registration_options(const LidarSequence& sequence, const Config& config);

}  // namespace relidar
