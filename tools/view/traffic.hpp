// SPDX-License-Identifier: Apache-2.0
// Applies the edits of one browser tab to the actors of a run.
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

/// Other runs whose actors can be inserted. The key is the name of the run on the page.
using OtherRuns = std::map<std::string, Run>;

/// Adds copies of actors to a scene. The actors belong to this run or to other runs.
/// Moves and removals are not applied here, because they do not change the surfels.
/// @throws UsageError if a run or track is unknown
DrivingScene with_copies(DrivingScene driving, const OtherRuns& others,
                         const std::vector<ActorEdits::Copy>& copies);

/// Returns a copy of an actor that stands on the ground at the clicked position.
/// @throws UsageError if there is no ground at this position
ActorEdits::Copy copy_on_ground(const Run& run, const OtherRuns& others, const GroundRequest& wish);

/// The actors of a run after some edits. Uses only tracks and instances, not surfels.
class Traffic {
public:
    /// Applies the edits to the tracks of a run.
    /// @throws UsageError if a track is unknown, like the functions of
    /// <relidar/run/edit.hpp>
    Traffic(const Run& run, const OtherRuns& others, const ActorEdits& edits);

    const ActorEdits& edits() const { return edits_; }
    const std::vector<Instance>& instances() const { return driving_.scene.instances; }
    /// Returns the poses of all visible actors at a time, in the dataset's world frame.
    /// They have the format of ScanRequest::dataset_from_actor.
    ActorPoses placed(double time_s) const;
    /// Returns a JSON list of all actors, including hidden ones: [{track, category, size,
    /// present, pose}].
    nlohmann::json describe(double time_s) const;

private:
    bool is_shown(const BoxTrack& box) const {
        return !edits_.removed.contains(box.id) && !edits_.hidden.contains(box.id);
    }

    DrivingScene driving_;  ///< Scene and tracks after the edits. The scene has no surfels.
    ActorEdits edits_;
};

/// Returns the run after all edits. Hidden actors are not removed. The history of the new
/// run lists the edits.
Run edited_run(const Run& run, const OtherRuns& others, const ActorEdits& edits);

}  // namespace relidar::view
