// SPDX-License-Identifier: Apache-2.0
// The actors of a run with the edits of one browser tab.
#pragma once

#include <map>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include <relidar/scene/scene.hpp>

#include "request.hpp"

namespace relidar {
struct Run;
}

namespace relidar::view {

/// Runs whose actors can be inserted, by the names that the page uses.
using OtherRuns = std::map<std::string, Run>;

/// Adds copies of actors of this run and of other runs to a scene. Moves and removals
/// need no change of the scene, because they change no surfel.
/// @throws UsageError for an unknown run or track
DrivingScene with_copies(DrivingScene driving, const OtherRuns& others,
                         const std::vector<ActorEdits::Copy>& copies);

/// Returns the copy of an actor on the ground at a clicked position.
/// @throws UsageError if no ground is found, as start_on_ground()
ActorEdits::Copy copy_on_ground(const Run& run, const OtherRuns& others, const GroundWish& wish);

/// The traffic of a run after some edits. Reads only tracks and instances, never surfels.
class Traffic {
public:
    /// Applies the edits to the tracks of a run.
    /// @throws UsageError for an unknown track, as the functions of
    /// <relidar/run/edit.hpp>
    Traffic(const Run& run, const OtherRuns& others, const ActorEdits& edits);

    const ActorEdits& edits() const { return edits_; }
    const std::vector<Instance>& instances() const { return driving_.scene.instances; }
    /// Returns the poses of visible actors at a time in the dataset's world frame, see
    /// ScanRequest::dataset_from_actor.
    ActorPoses placed(double time_s) const;
    /// Returns all actors, visible or not, as [{track, category, size, present, pose}].
    nlohmann::json describe(double time_s) const;

private:
    bool is_shown(const BoxTrack& box) const {
        return !edits_.removed.contains(box.id) && !edits_.hidden.contains(box.id);
    }

    DrivingScene driving_;  ///< Scene and tracks after the edits, without surfels.
    ActorEdits edits_;
};

/// Returns the run with all edits except hiding. Its history lists the edits.
Run edited_run(const Run& run, const OtherRuns& others, const ActorEdits& edits);

}  // namespace relidar::view
