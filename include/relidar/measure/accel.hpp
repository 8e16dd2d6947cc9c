// SPDX-License-Identifier: Apache-2.0
// What tests ask of an acceleration structure. Not installed.
#pragma once

#include <relidar/stages/accel.hpp>

namespace relidar {

/// Refits of the structure since it was built.
int refits_since_build(const Accel& accel);

}  // namespace relidar
