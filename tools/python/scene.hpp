// SPDX-License-Identifier: Apache-2.0
// Surfels as a dict of arrays in the layout of Surfels, and scenes of them.
#pragma once

#include <pybind11/pybind11.h>

#include <relidar/scene/scene.hpp>

namespace relidar::python {

/// mean [n,3], rotation [n,4], log_scale [n,2], opacity_logit [n], sh [n,3,16], and
/// log_scale_w [n] of 3D Gaussians, all float32.
/// @throws DataError for an array that is missing or misshapen, UsageError for an unknown
/// name
Surfels surfels_of(const pybind11::dict& arrays);

/// The same, moved into the arrays.
pybind11::dict to_dict(Surfels&& surfels);

}  // namespace relidar::python
