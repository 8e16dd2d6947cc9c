// SPDX-License-Identifier: Apache-2.0
// Axis of the largest component of a vector.
#pragma once

namespace relidar {

/// Axis (0, 1 or 2) of the largest component. The first one if two are equal.
template <class Vector>
int longest_axis(const Vector& size) {
    if (size.x >= size.y && size.x >= size.z) return 0;
    return size.y >= size.z ? 1 : 2;
}

}  // namespace relidar
