// SPDX-License-Identifier: Apache-2.0
// Casts rays into an edited synthetic street, with its cars at their edited poses. The
// result is the exact answer for an edited run.
#pragma once

#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar::cli {

/// Returns true if a run was edited and its log is a synthetic street that can be cast
/// again.
bool is_recastable(const Run& run);

/// Replaces the scans of the held-out frames by scans of the edited street, without
/// noise.
/// @return scans of the unedited street, one per held-out frame
/// @throws DataError if the model of an actor is not a car of the street
std::vector<Scan> attach_recast(Run& run);

/// Returns the pixels that an edit changes: those whose exact range differs with and
/// without the edit. The metrics of this region are named edited/*.
Region edited_region(const RangeImage& edited, const RangeImage& before);

}  // namespace relidar::cli
