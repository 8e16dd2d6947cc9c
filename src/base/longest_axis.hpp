// SPDX-License-Identifier: Apache-2.0
// Axis of the largest component of a vector.
#pragma once

namespace relidar {

/// Returns the axis (0, 1 or 2) with the largest component of a GLM vector. If two
/// components are equal, returns the first of their axes.
template <class Vector>
int find_longest_axis(const Vector& size) {
    if (size.x >= size.y && size.x >= size.z) return 0;
    return size.y >= size.z ? 1 : 2;
}

}  // namespace relidar
