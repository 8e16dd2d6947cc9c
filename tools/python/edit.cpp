// SPDX-License-Identifier: Apache-2.0
// Edits a run with chained Python calls: run.edit().remove("0").move("1",
// pose).save("edited").
#include <filesystem>
#include <functional>

#include <pybind11/stl.h>
#include <pybind11/stl/filesystem.h>

#include <fmt/format.h>

#include <relidar/base/error.hpp>
#include <relidar/run/edit.hpp>
#include "config.hpp"
#include "module.hpp"
#include "poses.hpp"
#include "run.hpp"

namespace relidar::python {
namespace {

namespace fs = std::filesystem;

/// A copy of a run to which edits are applied one after the other.
struct Edits {
    Run run;
    SharedDevice device;
    /// Absolute path of the original run. Empty if the run was not loaded from a folder.
    std::string origin;

    explicit Edits(const LoadedRun& start) : run(start.run), device(start.device) {
        if (!run.folder.empty()) origin = fs::absolute(run.folder).lexically_normal().string();
        run.folder.clear();
    }

    /// Applies an edit to the run and adds it to the history of the run.
    /// @param description text that describes the edit in scene.json
    Edits& apply(const std::string& description, const std::function<DrivingScene(DrivingScene)>& edit) {
        // Applies the edit to a copy, so that the run does not change if the edit fails.
        run.replace(edit(run.driving()));
        run.edits.push_back({origin, description});
        return *this;
    }

    /// Applies an edit that can change the times at which an actor is present. Warns if
    /// the actor is then missing in more frames of the log.
    Edits& apply_times(const std::string& description, const std::string& track,
                       const std::function<DrivingScene(DrivingScene)>& edit) {
        const BoxTrack* box = find_box(run.sequence, track);
        const BoxTrack before = box ? *box : BoxTrack{};
        apply(description, edit);
        if (const std::string note = describe_lost_frames(before, run.sequence); !note.empty()) warn(note);
        return *this;
    }

    std::unique_ptr<LoadedRun> finished() const { return std::make_unique<LoadedRun>(run, device); }
};

std::string format_vector(const glm::dvec3& vector) {
    return fmt::format("{:.6g},{:.6g},{:.6g}", vector.x, vector.y, vector.z);
}

Edits& keep(Edits& edits, const std::string& description) {
    if (description == "background") return edits.apply("keep background", keep_background);
    if (description == "actors") return edits.apply("keep actors", keep_actors);
    throw UsageError(fmt::format("keep: found \"{}\", expected background or actors", description));
}

Edits& move(Edits& edits, const std::string& track, const py::object& pose) {
    const Pose box_from_moved = convert_to_pose(pose, "pose");
    return edits.apply(
        fmt::format("move {}:{}", track, format_vector(box_from_moved.translation)),
        [&](DrivingScene driving) { return move_track(std::move(driving), track, box_from_moved); });
}

Edits& follow(Edits& edits, const std::string& track, const py::object& trajectory) {
    const PoseTrack poses = read_pose_track(trajectory, "trajectory", 0.0);
    return edits.apply_times(
        fmt::format("follow {}: {} poses", track, poses.pose.size()), track,
        [&](DrivingScene driving) { return replace_trajectory(std::move(driving), track, poses); });
}

Edits& copy(Edits& edits, const std::string& track, const py::object& pose, double speed_mps) {
    const Start start{convert_to_pose(pose, "pose"), speed_mps};
    return edits.apply(
        fmt::format("copy {}@{}:{:.6g}", track, format_vector(start.dataset_from_box.translation), speed_mps),
        [&](DrivingScene driving) { return copy_track(std::move(driving), track, start); });
}

Edits& insert(Edits& edits, const LoadedRun& other, const std::string& track, const py::object& pose,
              double speed_mps) {
    const Start start{convert_to_pose(pose, "pose"), speed_mps};
    const std::string said = fmt::format("insert {}#{}@{}:{:.6g}", other.run.folder.string(), track,
                                         format_vector(start.dataset_from_box.translation), speed_mps);
    return edits.apply(said, [&](DrivingScene driving) {
        return insert_track(std::move(driving), other.run.driving(), track, start);
    });
}

std::unique_ptr<LoadedRun> save(const Edits& edits, const fs::path& folder, bool overwrite) {
    auto loaded = edits.finished();
    save_to(loaded->run, folder, overwrite);
    return loaded;
}

}  // namespace

void add_edit(py::module_& module) {
    // Returns the same Python object after each edit, so that edits can be chained.
    const auto same = py::return_value_policy::reference;
    py::class_<Edits>(
        module, "Edit",
        "A copy of a run that is being edited. Each edit returns the same object, so that calls "
        "can be chained. run() or save() finishes the edits. Raises UsageError for an unknown "
        "track.")
        .def(
            "remove",
            [](Edits& edits, const std::string& track) -> Edits& {
                return edits.apply("remove " + track, [&](DrivingScene driving) {
                    return remove_track(std::move(driving), track);
                });
            },
            py::arg("track"), same, "Removes an actor. Rays then hit the surfaces behind it.")
        .def("move", &move, py::arg("track"), py::arg("pose"), same,
             "Moves an actor along its full trajectory, in the frame of its box (forward, left, up).\n\n"
             "pose: [4,4] float64, box from moved box, for example from relidar.pose()")
        .def(
            "retime",
            [](Edits& edits, const std::string& track, double seconds) -> Edits& {
                return edits.apply_times(
                    fmt::format("retime {}:{:.6g}", track, seconds), track,
                    [&](DrivingScene driving) { return retime_track(std::move(driving), track, seconds); });
            },
            py::arg("track"), py::arg("seconds"), same,
            "Delays all motion of an actor by this time in seconds.")
        .def("follow", &follow, py::arg("track"), py::arg("trajectory"), same,
             "Replaces the trajectory of an actor.\n\n"
             "trajectory: (times [n], poses [n,4,4]) of the centre of its box in the dataset's world, "
             "n >= 2")
        .def("copy", &copy, py::arg("track"), py::arg("pose"), py::arg("speed_mps") = 0.0, same,
             "Adds a copy of an actor with the name TRACK-copy-1.\n\n"
             "pose: pose of the centre of its box in the dataset's world at the first frame; from "
             "there it drives straight ahead")
        .def("insert", &insert, py::arg("other"), py::arg("track"), py::arg("pose"),
             py::arg("speed_mps") = 0.0, same, "Adds a copy of an actor of another run, like copy().")
        .def("keep", &keep, py::arg("what"), same, "Keeps only the \"background\" or only the \"actors\".")
        .def("run", &Edits::finished, "Returns the edited run.")
        .def("save", &save, py::arg("folder"), py::kw_only(), py::arg("overwrite") = false,
             "Writes the edited run to a folder and returns it.");
    const auto run = py::reinterpret_borrow<py::class_<LoadedRun>>(module.attr("Run"));
    py::class_<LoadedRun>(run).def(
        "edit", [](const LoadedRun& loaded) { return Edits(loaded); },
        "Returns a copy of the run that can be edited.");
}

}  // namespace relidar::python
