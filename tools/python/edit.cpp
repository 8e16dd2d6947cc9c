// SPDX-License-Identifier: Apache-2.0
// Edits a run with chained Python calls: run.edit().remove("0").move("1",
// pose).save("edited").

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <relidar/run/edit.hpp>
#include "base/fail.hpp"
#include "conversions.hpp"
#include "module.hpp"
#include "run.hpp"

namespace relidar::python {
namespace {

namespace fs = std::filesystem;

struct EditedRun {
    Run run;               ///< the run before all edits, with the history of the edits
    SceneWithLog driving;  ///< the edited scene and tracks
    SharedDevice device;
    std::string origin;

    explicit EditedRun(const LoadedRun& start)
        : run(start.run), driving(run.driving_scene()), device(start.device) {
        if (!run.folder.empty()) origin = fs::absolute(run.folder).lexically_normal().string();
        run.folder.clear();
    }

    /// Applies an edit and adds it to the history. The edit works on a copy, so that the
    /// run does not change if the edit fails.
    template <class Edit, class... Arguments>
    EditedRun& apply(const std::string& entry, Edit edit, const Arguments&... arguments) {
        driving = edit(driving, arguments...);
        run.edits.push_back({origin, entry});
        return *this;
    }

    /// Applies an edit that can change the times at which an actor is present. Warns if
    /// the actor is then missing in more frames of the log.
    template <class Edit, class Argument>
    EditedRun& apply_in_time(const std::string& entry, Edit edit, const std::string& track,
                             const Argument& argument) {
        const BoxTrack* box = find_box(driving.log, track);
        const BoxTrack before = box ? *box : BoxTrack{};
        apply(entry, edit, track, argument);
        if (const std::string note = describe_absence(before, driving.log); !note.empty()) show_warning(note);
        return *this;
    }

    /// Returns the edited run. Warns if changed actors float or overlap something.
    std::unique_ptr<LoadedRun> copy_run() const {
        Run edited = run;
        edited.set_driving_scene(driving);
        const SceneWithLogView view{edited.scene, edited.log};
        for (const Note& note : check_placement(view, list_changed_tracks(view, run.log.boxes)))
            show_warning(note.text);
        return std::make_unique<LoadedRun>(std::move(edited), device);
    }
};

std::string format_vector(const glm::dvec3& vector) {
    return fmt::format("{:.6g},{:.6g},{:.6g}", vector.x, vector.y, vector.z);
}

EditedRun& keep_part(EditedRun& edited, const std::string& kept_part_name) {
    if (kept_part_name == "background") return edited.apply("keep background", remove_actors);
    if (kept_part_name == "actors") return edited.apply("keep actors", remove_background);
    fail<UsageError>("keep(): found \"{}\", expected background or actors", kept_part_name);
}

EditedRun& move_actor(EditedRun& edited, const std::string& track, const py::object& pose) {
    const Pose box_from_moved = to_pose(pose, "pose");
    return edited.apply(fmt::format("move {}:{}", track, format_vector(box_from_moved.translation)),
                        move_track, track, box_from_moved);
}

EditedRun& follow_trajectory(EditedRun& edited, const std::string& track, const py::object& trajectory) {
    const PoseTrack poses = to_track(trajectory, "trajectory", 0.0);
    return edited.apply_in_time(fmt::format("follow {}: {} poses", track, poses.pose.size()), replace_track,
                                track, poses);
}

EditedRun& copy_actor(EditedRun& edited, const std::string& track, const py::object& pose, double speed_mps) {
    const NewActorMotion start{to_pose(pose, "pose"), speed_mps};
    return edited.apply(
        fmt::format("copy {}@{}:{:.6g}", track, format_vector(start.dataset_from_box.translation), speed_mps),
        copy_track, track, start);
}

EditedRun& insert_actor(EditedRun& edited, const LoadedRun& other, const std::string& track,
                        const py::object& pose, double speed_mps) {
    const NewActorMotion start{to_pose(pose, "pose"), speed_mps};
    const std::string entry = fmt::format("insert {}#{}@{}:{:.6g}", other.run.folder.string(), track,
                                          format_vector(start.dataset_from_box.translation), speed_mps);
    return edited.apply(entry, insert_track, other.run.driving_scene(), track, start);
}

std::unique_ptr<LoadedRun> save_edited_run(const EditedRun& edited, const fs::path& folder, bool overwrite) {
    auto loaded = edited.copy_run();
    save_run_in(*loaded, folder, overwrite);
    return loaded;
}

}  // namespace

void bind_edit_class(py::module_& module) {
    // Returns the same Python object after each edit, so that edits can be chained.
    const auto same = py::return_value_policy::reference;
    py::class_<EditedRun>(
        module, "Edit",
        "A copy of a run that is being edited. Each edit returns the same object, so that calls can be "
        "chained. run() or save() finishes the edits, and warns about changed actors above the ground, or "
        "inside other objects or the background. Raises UsageError for an unknown track.")
        .def(
            "remove",
            [](EditedRun& edits, const std::string& track) -> EditedRun& {
                return edits.apply("remove " + track, remove_track, track);
            },
            py::arg("track"), same, "Removes an actor. Rays then hit the surfaces behind it.")
        .def("move", &move_actor, py::arg("track"), py::arg("pose"), same,
             "Shifts the full trajectory of an actor by a constant pose in the frame of its box (forward, "
             "left, up).\n\n"
             "pose: [4,4] float64, pose of the moved box in the frame of the old box, for example from "
             "relidar.pose()")
        .def(
            "classify",
            [](EditedRun& edits, const std::string& track, const std::string& name) -> EditedRun& {
                return edits.apply(fmt::format("class {}={}", track, name), classify_track, track, name);
            },
            py::arg("track"), py::arg("name"), same,
            "Sets the class of an actor, or of a labelled object in the background, in all labels.")
        .def(
            "retime",
            [](EditedRun& edits, const std::string& track, double seconds) -> EditedRun& {
                return edits.apply_in_time(fmt::format("retime {}:{:.6g}", track, seconds), delay_track,
                                           track, seconds);
            },
            py::arg("track"), py::arg("seconds"), same,
            "Delays all motion of an actor by this time in seconds.")
        .def(
            "speed",
            [](EditedRun& edits, const std::string& track, double factor) -> EditedRun& {
                return edits.apply_in_time(fmt::format("speed {}={:.6g}", track, factor), scale_speed, track,
                                           factor);
            },
            py::arg("track"), py::arg("factor"), same,
            "Multiplies the speed of an actor along its path, which begins at the same time.")
        .def("follow", &follow_trajectory, py::arg("track"), py::arg("trajectory"), same,
             "Replaces the trajectory of an actor.\n\n"
             "trajectory: (times [n], poses [n,4,4]) of the centre of its box in the dataset's world, n >= 2")
        .def("copy", &copy_actor, py::arg("track"), py::arg("pose"), py::arg("speed_mps") = 0.0, same,
             "Adds a copy of an actor with the name TRACK-copy-1.\n\n"
             "pose: pose of the centre of its box in the dataset's world at the first frame; from there it "
             "drives straight ahead")
        .def("insert", &insert_actor, py::arg("other"), py::arg("track"), py::arg("pose"),
             py::arg("speed_mps") = 0.0, same, "Adds a copy of an actor of another run, like copy().")
        .def("keep", &keep_part, py::arg("what"), same,
             "Keeps only the \"background\" or only the \"actors\".")
        .def("run", &EditedRun::copy_run, "Returns the edited run.")
        .def("save", &save_edited_run, py::arg("folder"), py::kw_only(), py::arg("overwrite") = false,
             "Writes the edited run to a folder and returns it.");
    const auto run = py::reinterpret_borrow<py::class_<LoadedRun>>(module.attr("Run"));
    py::class_<LoadedRun>(run).def(
        "edit", [](const LoadedRun& loaded) { return EditedRun(loaded); },
        "Returns a copy of the run that can be edited.");
}

}  // namespace relidar::python
