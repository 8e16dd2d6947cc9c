// SPDX-License-Identifier: Apache-2.0
// The actors of a run as one tab of the browser has changed them.
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include <relidar/scene.hpp>

#include "request.hpp"

namespace relidar {
struct Run;
}

namespace relidar::view {

/// A scene with copies of its actors; what is moved or gone changes no surfel and so no scene.
DrivingScene with_copies(DrivingScene driving, const std::vector<ActorEdits::Copy>& copies);

/// The traffic of a run after some edits. It looks at tracks and instances alone, never at a surfel.
class Traffic {
public:
    /// @throws UsageError for a track that is not there, as the functions of <relidar/edit.hpp>
    Traffic(const Run& run, const ActorEdits& edits);

    const ActorEdits& edits() const { return edits_; }
    const std::vector<Instance>& instances() const { return driving_.scene.instances; }
    /// Where actors are that are there and shown, in the dataset's world: ScanRequest::dataset_from_actor.
    ActorPoses placed(double time_s) const;
    /// All of them, shown or not: [{track, category, size, present, pose}].
    nlohmann::json describe(double time_s) const;

private:
    bool is_shown(const BoxTrack& box) const { return !edits_.removed.contains(box.id) && !edits_.hidden.contains(box.id); }

    DrivingScene driving_;   ///< without surfels
    ActorEdits edits_;
};

/// The run with all edits but hiding, its history included.
Run edited_run(const Run& run, const ActorEdits& edits);

}  // namespace relidar::view
