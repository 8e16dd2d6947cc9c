// SPDX-License-Identifier: Apache-2.0
// Applies the edits that a user has made in one browser tab to the actors of a run.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include <relidar/scene/scene.hpp>

#include "request.hpp"

namespace relidar {
struct Run;
}

namespace relidar::view {

/// By the name of the run on the web page.
using OtherRunsByName = std::map<std::string, Run>;

/// Makes actors of all standing objects that the edits name, in the order of their names.
/// @param notes  output: what the log has not observed of them
SceneWithLog release_edited(SceneWithLog scene, const ActorEdits& edits,
                            std::vector<std::string>* notes = nullptr);

/// @throws UsageError if a run or track is unknown
SceneWithLog add_copies(SceneWithLog scene, const OtherRunsByName& others,
                        const std::vector<ActorEdits::ActorCopy>& copies);

/// Returns a copy of an actor that stands on the ground where the user has clicked, with
/// its rotation as yaw, pitch and roll for the web page.
/// @throws UsageError if there is no ground
ActorEdits::ActorCopy copy_on_ground(const Run& run, const OtherRunsByName& others,
                                     const GroundPoseRequest& request);

/// The actors of a run after all edits of a browser tab, without surfels.
class EditedTraffic {
public:
    /// @throws UsageError if a track is unknown
    EditedTraffic(const Run& run, const OtherRunsByName& others, const ActorEdits& edits);

    const ActorEdits& edits() const { return edits_; }
    const std::vector<ModelInstance>& instances() const { return driving_.scene.instances; }
    /// In the world frame of the dataset, for ScanRequest::dataset_from_actor.
    ActorTracksByName visible_poses(double time_s) const;
    /// Including hidden actors and standing objects: [{track, category, size, present,
    /// standing, pose}].
    nlohmann::json actors_json(double time_s) const;

private:
    bool is_shown(const BoxTrack& box) const {
        return !edits_.removed.contains(box.id) && !edits_.hidden.contains(box.id);
    }

    SceneWithLog driving_;  ///< Scene and tracks after the edits. The scene has no surfels.
    ActorEdits edits_;
};

/// Returns the edited run, to save it. Hidden actors stay in the run. The history of the
/// new run contains the edits.
Run apply_edits(const Run& run, const OtherRunsByName& others, const ActorEdits& edits);

}  // namespace relidar::view
