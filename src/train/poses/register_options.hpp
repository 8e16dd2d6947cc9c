// SPDX-License-Identifier: Apache-2.0
// What the settings say of registration. Private to train.
#pragma once

#include <relidar/log/registration.hpp>
#include <relidar/run/config.hpp>

namespace relidar {

inline bool registers_sensor(const TrainConfig& config) {
    return config.pose_register && config.refines("sensor");
}

/// Without what a session adds: stop, progress and group.
RegisterOptions register_options(const Sequence& sequence, const Config& config);

}  // namespace relidar
