// SPDX-License-Identifier: Apache-2.0
// Casts rays into a synthetic street whose cars were moved by edits. The resulting scans
// are exact, so they can be compared with rendered scans of the edited run.
#pragma once

#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar::cli {

/// Returns true if exact scans of an edited run can be computed. This is possible only if
/// the log of the run is a synthetic street.
bool is_edited_synthetic_street_run(const TrainedRun& run);

/// Replaces the scans of the held-out frames by exact, noise-free scans of the edited
/// street.
/// @return exact scans of the street before the edits, one per held-out frame
/// @throws DataError if the model of an actor is not a car of the street
std::vector<Scan> replace_held_out_by_exact_scans(TrainedRun& run);

/// Returns the pixels that an edit changes, which are the pixels whose exact range
/// differs. Their metrics are named edited/*.
PixelRegion find_pixels_changed_by_edit(const RangeImage& edited_image, const RangeImage& original_image);

}  // namespace relidar::cli
