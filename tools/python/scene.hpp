// SPDX-License-Identifier: Apache-2.0
// Converts surfels and scenes to Python dicts of arrays, and such dicts to surfels. The
// arrays have the same layout as the class Surfels.
#pragma once

#include <pybind11/pybind11.h>

#include <relidar/scene/scene.hpp>

namespace relidar::python {

/// Creates surfels from float32 arrays: mean [n,3], rotation [n,4], log_scale [n,2],
/// opacity_logit [n], sh [n,3,16]. 3D Gaussians also need log_scale_w [n].
/// @throws DataError if an array is missing or has a wrong shape
/// @throws UsageError if a name is unknown
Surfels read_surfels(const pybind11::dict& arrays);

pybind11::dict to_array_dict(Surfels&& surfels);

}  // namespace relidar::python
