// SPDX-License-Identifier: Apache-2.0
// Conversions of surfels and scenes to and from dicts of arrays, in the layout of
// Surfels.
#pragma once

#include <pybind11/pybind11.h>

#include <relidar/scene/scene.hpp>

namespace relidar::python {

/// Returns surfels from the float32 arrays mean [n,3], rotation [n,4], log_scale [n,2],
/// opacity_logit [n], sh [n,3,16], and log_scale_w [n] for 3D Gaussians.
/// @throws DataError if an array is missing or has a wrong shape; UsageError for an
/// unknown name
Surfels surfels_of(const pybind11::dict& arrays);

/// Moves the surfels into a dict of the same arrays.
pybind11::dict to_dict(Surfels&& surfels);

}  // namespace relidar::python
