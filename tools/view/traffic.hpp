// SPDX-License-Identifier: Apache-2.0
// The actors of a run as one tab of the browser has changed them.
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

/// Runs whose actors can be inserted, by the names that the page knows.
using OtherRuns = std::map<std::string, Run>;

/// A scene with copies of its actors and of those of other runs; what is moved or gone
/// changes no surfel and so no scene.
/// @throws UsageError for a run or a track that is not there
DrivingScene with_copies(DrivingScene driving, const OtherRuns& others,
                         const std::vector<ActorEdits::Copy>& copies);

/// The copy that somebody asks for by a click. @throws UsageError where it finds no
/// ground, as start_on_ground()
ActorEdits::Copy copy_on_ground(const Run& run, const OtherRuns& others, const GroundWish& wish);

/// The traffic of a run after some edits. It looks at tracks and instances alone, never
/// at a surfel.
class Traffic {
public:
    /// @throws UsageError for a track that is not there, as the functions of
    /// <relidar/run/edit.hpp>
    Traffic(const Run& run, const OtherRuns& others, const ActorEdits& edits);

    const ActorEdits& edits() const { return edits_; }
    const std::vector<Instance>& instances() const { return driving_.scene.instances; }
    /// Where actors are that are there and shown, in the dataset's world:
    /// ScanRequest::dataset_from_actor.
    ActorPoses placed(double time_s) const;
    /// All of them, shown or not: [{track, category, size, present, pose}].
    nlohmann::json describe(double time_s) const;

private:
    bool is_shown(const BoxTrack& box) const {
        return !edits_.removed.contains(box.id) && !edits_.hidden.contains(box.id);
    }

    DrivingScene driving_;  ///< without surfels
    ActorEdits edits_;
};

/// The run with all edits but hiding, its history included.
Run edited_run(const Run& run, const OtherRuns& others, const ActorEdits& edits);

}  // namespace relidar::view
