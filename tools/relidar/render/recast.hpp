// SPDX-License-Identifier: Apache-2.0
// The exact answer for an edited run of a synthetic street: the street cast again with
// its cars where the edits put them.
#pragma once

#include <vector>

#include <relidar/log/range_image.hpp>
#include <relidar/run/run.hpp>
#include <relidar/score/metrics.hpp>

namespace relidar::cli {

/// Whether a run was edited and its log can be cast again.
bool is_recastable(const Run& run);

/// Gives the held-out frames the scans of the edited street, without noise.
/// @return what the street itself would have given, one scan a held-out frame
/// @throws DataError where an actor has the model of no car of the street
std::vector<Scan> attach_recast(Run& run);

/// The pixels that an edit changes: those whose exact range is another one with the edit
/// than without. Its metrics are edited/*.
Region edited_region(const RangeImage& edited, const RangeImage& before);

}  // namespace relidar::cli
