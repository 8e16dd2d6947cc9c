// SPDX-License-Identifier: Apache-2.0
#include <filesystem>
#include <memory>

#include <CLI/CLI.hpp>

#include <relidar/run/run.hpp>
#include <relidar/scene/surfel_ply.hpp>
#include "base/fail.hpp"
#include "command.hpp"
#include "console.hpp"
#include "edit/edit_text.hpp"
#include "options.hpp"
#include "output_folder.hpp"

namespace relidar::cli {
namespace {

struct EditOptions {
    std::string run;
    std::string out;
    /// empty to keep the surfels of the run
    std::string ply;
    std::vector<EditArgument> edits;  ///< Edits in the order in which the user typed them.
    bool force = false;
    bool quiet = false;
};

/// Returns notes about changed actors that may look wrong: above the ground, inside other
/// objects, with sides without observations, or with too few surfels for their distance.
std::string placement_notes(const SceneWithLog& driving_scene, const Log& original_log) {
    std::string text;
    const SceneWithLogView edited{driving_scene.scene, driving_scene.log};
    const std::vector<std::string> tracks = list_changed_tracks(edited, original_log.boxes);
    for (const Note& note : check_placement(edited, tracks)) text += fmt::format("note: {}\n", note.text);
    for (const std::string& track : tracks) {
        if (const std::string sides = describe_unseen(driving_scene.scene, track); !sides.empty())
            text += fmt::format("note: {}\n", sides);
        const ActorModelResolution detail = model_resolution(driving_scene, track);
        if (!detail.is_too_coarse()) continue;
        text += fmt::format(
            "note: actor {} is {:.1f} m from the sensor at {:.2f} s, where {} rays hit its box. It will show "
            "holes, because it has only {} surfels: the log recorded it from farther away\n",
            track, detail.nearest_m, detail.time_s, detail.rays, detail.surfels);
    }
    return text;
}

/// Applies the edits of the command line to a run, and saves it as a new run.
void run_edit(const EditOptions& options) {
    if (options.edits.empty() && options.ply.empty())
        throw UsageError(
            "no edit is given; expected at least one of --remove, --move, --class, --retime, --speed, "
            "--trajectory, --copy, --insert, --georeference, --keep and --from-ply (see `relidar edit "
            "--help`)");
    std::error_code failed;
    if (std::filesystem::equivalent(options.run, options.out, failed))
        fail<UsageError>("--out {}: this is the folder of the run to edit; expected a different folder",
                         options.out);
    const RunFolderWriter edited(options.out, options.force);
    Run run = load_run(options.run);
    std::string report, ply_note;
    if (!options.ply.empty())
        run.scene =
            read_surfel_ply(options.ply, with_all_blocks(run.scene), run.config.image.primitive, &ply_note);
    if (!ply_note.empty()) report += fmt::format("note: {}: {}\n", options.ply, ply_note);

    const std::string origin = absolute_path(options.run);
    SceneWithLog driving{std::move(run.scene), std::move(run.log)};
    // The boxes before all edits show later which actors have changed.
    const Log original_log = strip_frames(driving.log);
    for (const EditArgument& edit : options.edits) {
        EditResult applied = apply_edit(std::move(driving), edit);
        driving = std::move(applied.driving);
        run.edits.push_back({origin, fmt::format("{} {}", edit.option, edit.value)});
        report += applied.description + "\n";
        if (!applied.note.empty()) report += "note: " + applied.note + "\n";
    }
    driving = complete_actors(std::move(driving), original_log.boxes);
    report += placement_notes(driving, original_log);

    run.log.boxes = original_log.boxes;  // shows set_driving_scene() what has changed
    run.set_driving_scene(std::move(driving));
    edited.save_run_in(run);
    if (!options.quiet)
        print(report + fmt::format("saved {} instances of {} models with {} surfels in {}\n",
                                   run.scene.instances.size(), run.scene.models.size(),
                                   count_surfels(run.scene), options.out));
}

constexpr const char* kEditHelp =
    R"(Edits can be repeated. They are applied in the order given. `relidar info RUN` lists the tracks
with their start, in the form that --copy takes. DIR becomes a complete run: it has its own
surfels, it does not need RUN, and its scene.json lists the edits.
Positions are box centres in metres in the dataset's world. Copies and inserted actors are there
at the log's first frame. They are called TRACK-copy-1, and so on.
If z is `ground`, the surface below the box decides height and tilt. Without yaw_deg the actor
then faces as the log's vehicle did at its nearest point. A driving actor follows the ground.
The ground has no steps above 0.3 m, and parked cars are not ground.
A labelled object that stands still is part of the background. An edit that names it makes an
actor of it, and closes the ground below it. --speed needs an actor that moves.
A trajectory has the times of the log. Between its lines, positions are interpolated linearly and
rotations by slerp. Outside its times the actor is absent. Actors may overlap: a ray meets the
nearest surface.
Examples:
  relidar edit run --out empty --remove 0
  relidar edit run --out lane --move 0:0,3.5,0 --retime 1=-0.5 --speed 2=1.5
  relidar edit run --out more --copy 0@12,3.5,0.9,180:8 --insert other#3@30,0,0.8,0:10
  relidar edit run --out parked --copy 0@12,3.5,ground
  relidar edit run --out cleaned --from-ply scene.ply)";

}  // namespace

/// Adds the command `relidar edit` and its options to the parser.
void add_edit(CLI::App& app, ParsedCommand& call) {
    CLI::App* command =
        app.add_subcommand("edit", "remove, move, copy and insert actors; read surfels from a PLY file");
    const auto options = std::make_shared<EditOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train` or `relidar edit`")->required();
    add_option(*command, "--out DIR", options->out, "folder for the edited run")->required();
    for (const EditOption& edit : edit_options()) {
        // Each option appends an edit when it is parsed, so edits keep their order.
        const auto append_edit = [options, option = std::string(edit.option)](const std::string& value) {
            options->edits.push_back({option, value});
        };
        command->add_option_function<std::string>(std::string(edit.option), append_edit, edit.help)
            ->type_name(edit.form)
            ->trigger_on_parse()
            ->allow_extra_args(false)
            ->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
    }
    add_option(*command, "--from-ply FILE.ply", options->ply,
               "before all other edits, replace the surfels by those of a PLY file that `relidar export` "
               "wrote and that another program has changed; missing properties are taken from the surfels of "
               "RUN at the same positions");
    command->add_flag("--force", options->force, "overwrite the run in DIR");
    add_quiet_option(*command, options->quiet);
    command->footer(kEditHelp);
    run_after_parsing(*command, call, options, run_edit);
}

}  // namespace relidar::cli
