// SPDX-License-Identifier: Apache-2.0
// relidar edit: writes a run as another run with its actors removed, moved, retimed or
// copied, with actors of other runs, or with surfels read from a PLY file.
#include <algorithm>
#include <filesystem>
#include <memory>

#include <fmt/format.h>
#include <CLI/CLI.hpp>

#include <relidar/run/run.hpp>
#include <relidar/scene/surfel_ply.hpp>
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
    std::string ply;               ///< surfels that replace those of the run; empty: none
    std::vector<TypedEdit> edits;  ///< in the order typed
    bool force = false;
    bool quiet = false;
};

void check_other_folder(const EditOptions& options) {
    std::error_code failed;
    if (std::filesystem::equivalent(options.run, options.out, failed))
        throw UsageError(
            fmt::format("--out {}: found the run that is edited, expected another folder", options.out));
}

bool is_same(const PoseTrack& a, const PoseTrack& b) {
    const auto same = [](const Pose& p, const Pose& q) {
        return p.translation == q.translation && p.rotation == q.rotation;
    };
    return a.time_s == b.time_s && std::ranges::equal(a.pose, b.pose, same);
}

/// Tracks of actors that were not there before, or elsewhere.
std::vector<std::string> placed_tracks(const DrivingScene& driving, const Sequence& before) {
    std::vector<std::string> placed;
    for (const Instance& instance : driving.scene.instances) {
        const BoxTrack *now = find_box(driving.sequence, instance.track),
                       *then = find_box(before, instance.track);
        if (now && (!then || !is_same(now->world_from_box, then->world_from_box)))
            placed.push_back(instance.track);
    }
    return placed;
}

/// Which of the actors that were placed are too coarse for where they stand, a line each.
std::string sparse_actors(const DrivingScene& driving, const Sequence& before) {
    std::string text;
    for (const std::string& track : placed_tracks(driving, before)) {
        const ActorDetail detail = actor_detail(driving, track);
        if (!detail.is_sparse()) continue;
        text += fmt::format(
            "note: actor {} comes within {:.1f} m of the sensor at {:.2f} s, where {} rays meet its box, but "
            "it has {} "
            "surfels: it was learnt from farther away and will show holes\n",
            track, detail.nearest_m, detail.time_s, detail.rays, detail.surfels);
    }
    return text;
}

void run_edit(const EditOptions& options) {
    if (options.edits.empty() && options.ply.empty())
        throw UsageError(
            "found no edit, expected --remove, --move, --retime, --trajectory, --copy, --insert, --scenario, "
            "--keep or --from-ply (see "
            "`relidar edit --help`)");
    check_other_folder(options);
    const NewRun edited(options.out, options.force);
    Run run = load_run(options.run);
    if (!options.ply.empty())
        run.scene = read_surfel_ply(options.ply, whole_scene(run.scene), run.config.image.primitive);
    const std::string origin = absolute_path(options.run);
    DrivingScene driving{std::move(run.scene), std::move(run.sequence)};
    const Sequence before = without_frames(driving.sequence);
    std::string text;
    for (const TypedEdit& edit : options.edits) {
        AppliedEdit applied = apply(std::move(driving), edit);
        driving = std::move(applied.driving);
        run.edits.push_back({origin, fmt::format("{} {}", edit.option, edit.value)});
        text += applied.said + "\n" + (applied.note.empty() ? "" : "note: " + applied.note + "\n");
    }
    text += sparse_actors(driving, before);
    run.replace(std::move(driving));
    edited.save(run);
    if (!options.quiet)
        print(text + fmt::format("{} instances of {} models, {} surfels in {}\n", run.scene.instances.size(),
                                 run.scene.models.size(), count_surfels(run.scene), options.out));
}

}  // namespace

void add_edit(CLI::App& app, Call& call) {
    CLI::App* command =
        app.add_subcommand("edit", "remove, move, copy and insert actors; read surfels back from a PLY");
    const auto options = std::make_shared<EditOptions>();
    command->add_option("RUN", options->run, "run folder of `relidar train` or `relidar edit`")->required();
    command->add_option("--out", options->out, "folder for the edited run")->required()->type_name("DIR");
    for (const EditOption& edit : edit_options()) {
        const auto take = [options, option = std::string(edit.option)](const std::string& value) {
            options->edits.push_back({option, value});
        };
        command->add_option_function<std::string>(edit.option, take, edit.help)
            ->type_name(edit.form)
            ->trigger_on_parse()
            ->allow_extra_args(false)
            ->multi_option_policy(CLI::MultiOptionPolicy::TakeLast);
    }
    command
        ->add_option("--from-ply", options->ply,
                     "before all edits, replace the surfels by those of a PLY file that `relidar export` "
                     "wrote and another tool edited")
        ->type_name("FILE.ply");
    command->add_flag("--force", options->force, "overwrite the run in DIR");
    command->add_flag("--quiet", options->quiet, "print errors only");
    command->footer(
        "Edits are repeatable and applied in the order given; `relidar info RUN` lists tracks, with their "
        "start as --copy takes it. DIR is "
        "a run like\n"
        "any other: it holds its own surfels (a model once, however often it is placed), moves without RUN, "
        "and scene.json tells its "
        "edits.\n"
        "Places are box centres in the dataset's world, metres; copies and inserted actors start there at "
        "the log's first frame and become "
        "TRACK-copy-1, ...\n"
        "With `ground` for z, x and y are of that world too; height and tilt come from the surface of the "
        "background below the box, and "
        "without yaw_deg\n"
        "the actor faces as the log's vehicle did where it came nearest. It drives on along the slope on "
        "which it starts.\n"
        "A trajectory's times are those of the log; poses between its lines are interpolated, position "
        "linearly, rotation by slerp; actors "
        "are absent\n"
        "outside their interval. Actors may overlap: rays meet whichever surface comes first.\n"
        "Of an OpenSCENARIO (XML 1.x) are read: FollowTrajectoryActions of Init and of a Story's events, "
        "their Polyline of vertices with "
        "time and\n"
        "WorldPosition (x, y, z, h, p, r), Timing absolute or relative (scale, offset), "
        "SimulationTimeConditions that start acts and "
        "events, $parameters\n"
        "and BoundingBoxes; a trajectory with anything else is refused, all other actions are named and left "
        "out. Its world is the "
        "dataset's, its time 0\n"
        "the log's first frame; an actor stands where the entity's box does, on the same ground.\n"
        "Examples:\n"
        "  relidar edit run --out empty --remove 0\n"
        "  relidar edit run --out lane --move 0:0,3.5,0 --retime 1:-0.5\n"
        "  relidar edit run --out more --copy 0@12,3.5,0.9,180:8 --insert other#3@30,0,0.8,0:10\n"
        "  relidar edit run --out parked --copy 0@12,3.5,ground\n"
        "  relidar edit run --out cleaned --from-ply scene.ply\n"
        "  relidar edit run --out cut_in --scenario cut_in.xosc@Ego=-,Car1=0,Van=assets/van-0");
    command->callback([&call, options] { call.run = [options] { run_edit(*options); }; });
}

}  // namespace relidar::cli
