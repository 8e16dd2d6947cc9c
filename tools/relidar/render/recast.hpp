// SPDX-License-Identifier: Apache-2.0
// Casts rays into a synthetic street whose cars were moved by edits. The resulting scans
// are exact, so they can be compared with rendered scans of the edited run.
#pragma once

#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar::cli {

/// Returns true if a run was edited and its log is a synthetic street. Exact scans of the
/// edited street can then be computed.
bool is_edited_synthetic_street_run(const TrainedRun& run);

/// Replaces the scans of the held-out frames by exact scans of the edited synthetic
/// street, which are computed by ray casting without noise.
/// @return exact scans of the same frames in the street before the edits
/// @throws DataError if the model of an actor is not a car of the synthetic street
std::vector<Scan> set_noise_free_scans_and_get_unedited_scans(TrainedRun& run);

/// Returns the pixels whose range is changed by an edit. Both images must be exact scans
/// of the synthetic street. The metrics of these pixels are named edited/*.
PixelRegion find_pixels_changed_by_edit(const RangeImage& edited_image, const RangeImage& original_image);

}  // namespace relidar::cli
