// SPDX-License-Identifier: Apache-2.0
#include "edit/edit_text.hpp"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>
#include <string_view>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/run/run.hpp>
#include <relidar/simulate/assets.hpp>
#include "options.hpp"

namespace relidar::cli {
namespace {

// Maximum offset or speed. A larger value is probably a typing error, so it is rejected.
constexpr double kFarOff_m = 1e6;

[[noreturn]] void throw_edit_error(const TypedEdit& edit, const std::string& expected) {
    throw UsageError(fmt::format("{}: found \"{}\", expected {}", edit.option, edit.value, expected));
}

const char* get_form(const TypedEdit& edit) {
    const auto& options = list_edit_options();
    return std::find_if(options.begin(), options.end(),
                        [&](const EditOption& o) { return edit.option == o.option; })
        ->form;
}

/// Splits a text at `position` and leaves out the character there. Throws an error if a
/// part is empty.
std::pair<std::string, std::string> split_at(const TypedEdit& edit, const std::string& text,
                                             std::size_t position) {
    if (position == std::string::npos || position == 0 || position + 1 == text.size())
        throw_edit_error(edit, get_form(edit));
    return {text.substr(0, position), text.substr(position + 1)};
}

std::vector<double> parse_edit_numbers(const TypedEdit& edit, const std::string& text, std::size_t min_count,
                                       std::size_t max_count) {
    const std::vector<double> values = parse_list(edit.option, text);
    if (values.size() < min_count || values.size() > max_count) throw_edit_error(edit, get_form(edit));
    for (const double v : values)
        if (std::abs(v) > 1e9) throw_edit_error(edit, "numbers below 1e9");
    return values;
}

/// Converts numbers to a pose. The numbers are x, y and z in metres, and optionally yaw,
/// pitch and roll in degrees.
Pose make_pose(const std::vector<double>& values) {
    const auto radians = [&](std::size_t index) {
        return index < values.size() ? values[index] * kPi / 180.0 : 0.0;
    };
    return {make_rotation(radians(3), radians(4), radians(5)), {values[0], values[1], values[2]}};
}

/// Parses a place on the ground, "x,y,ground[,yaw_deg]". Returns no value if the third
/// field is a number, so that the text is a full pose.
std::optional<GroundPlace> parse_ground_place(const TypedEdit& edit, const std::string& text) {
    constexpr std::string_view kWord = ",ground";
    const std::size_t at = text.find(kWord);
    if (at == std::string::npos) return {};
    const std::vector<double> xy = parse_edit_numbers(edit, text.substr(0, at), 2, 2);
    GroundPlace place{{xy[0], xy[1]}};
    const std::string rest = text.substr(at + kWord.size());
    if (!rest.empty() && rest[0] != ',') throw_edit_error(edit, get_form(edit));
    if (!rest.empty()) place.yaw_rad = parse_edit_numbers(edit, rest.substr(1), 1, 1)[0] * kPi / 180.0;
    return place;
}

/// An actor to insert or move, and the scene that contains this actor.
struct SourceActor {
    const DrivingScene& owner;
    const std::string& track;
    /// height of the bottom of the actor's box above the ground; no value if unknown
    std::optional<double> clearance_m;
};

/// Parses a start pose with an optional speed. The text is
/// "x,y,z,yaw_deg[,pitch_deg,roll_deg][:speed]" or "x,y,ground[,yaw_deg][:speed]".
Start parse_start_pose(const TypedEdit& edit, const std::string& text, const DrivingScene& driving,
                       const SourceActor& actor) {
    const std::size_t colon = text.find(':');
    const double speed_mps =
        colon == std::string::npos ? 0.0 : parse_edit_numbers(edit, text.substr(colon + 1), 1, 1)[0];
    if (std::abs(speed_mps) > kFarOff_m) throw_edit_error(edit, "a speed in m/s");
    const std::string place = text.substr(0, colon);
    if (std::optional<GroundPlace> ground = parse_ground_place(edit, place)) {
        ground->speed_mps = speed_mps;
        ground->clearance_m = actor.clearance_m;
        return compute_start_on_ground({driving.scene, driving.sequence}, *ground,
                                       {actor.owner.scene, actor.owner.sequence}, actor.track);
    }
    const std::vector<double> pose = parse_edit_numbers(edit, place, 4, 6);
    if (pose.size() == 5) throw_edit_error(edit, get_form(edit));
    return {make_pose(pose), speed_mps};
}

/// Describes height and tilt of an actor that was placed on the ground, because the
/// program computed them. Returns an empty text for other actors.
std::string describe_ground_contact(const Start& start, const std::string& typed) {
    if (typed.find(",ground") == std::string::npos) return "";
    const glm::dvec3& p = start.dataset_from_box.translation;
    const double tilt_deg =
        std::acos(std::clamp((start.dataset_from_box.rotation * glm::dvec3(0, 0, 1)).z, -1.0, 1.0)) * 180.0 /
        kPi;
    return fmt::format(", on the ground at {:.2f},{:.2f},{:.2f}, tilted by {:.1f} degrees", p.x, p.y, p.z,
                       tilt_deg);
}

/// Returns a warning if the actor moves over ground that the log has not observed. The
/// height of such ground is a guess.
std::string describe_unseen_ground(const Start& start, const std::string& track) {
    if (start.unseen_m == 0.0) return "";
    return fmt::format(
        "track {}: the log has not seen the ground below {:.0f} m of its path, so the height there is a "
        "guess: the actor keeps the mean slope of its path",
        track, start.unseen_m);
}

/// Returns a note on the sides of an actor that the log has not observed. Completed sides
/// are mirror images. The remaining sides have no surfels, so rays pass through them.
std::string describe_unseen_sides(const DrivingScene& driving, const std::string& track) {
    const auto actor = std::ranges::find(driving.scene.instances, track, &Instance::track);
    const std::optional<BoxSurface>& surface = driving.scene.models[actor->model].surface;
    if (!surface) return "";
    std::vector<std::string> parts;
    for (std::size_t s = 0; s < kBoxSides; ++s) {
        const double share = surface->mirrored(BoxSide(s));
        if (surface->is_completed && share >= double(kUnseenSide))
            parts.push_back(fmt::format("{:.0f} % of the {}", 100.0 * share, get_name(BoxSide(s))));
    }
    const std::string unseen = list_unseen_sides(surface->known());
    std::string text;
    if (!parts.empty())
        text = fmt::format(
            "track {}: not seen by the log and completed by the mirror image of the other "
            "side: {}",
            track, fmt::join(parts, ", "));
    if (!unseen.empty())
        text += fmt::format("{}track {}: the log has not seen these sides of it: {}; rays pass through them",
                            text.empty() ? "" : "; ", track, unseen);
    return text;
}

std::string join_notes(const std::vector<std::string>& notes) {
    std::string text;
    for (const std::string& note : notes)
        if (!note.empty()) text += (text.empty() ? "" : "; ") + note;
    return text;
}

const std::string& get_last_track(const DrivingScene& driving) {
    return driving.scene.instances.back().track;
}

AppliedEdit remove_one(DrivingScene driving, const TypedEdit& edit) {
    return {remove_track(std::move(driving), edit.value), "removed " + edit.value, ""};
}

AppliedEdit apply_move(DrivingScene driving, const TypedEdit& edit) {
    const auto [track, offset] = split_at(edit, edit.value, edit.value.rfind(':'));
    driving = move_track(std::move(driving), track, make_pose(parse_edit_numbers(edit, offset, 3, 4)));
    const std::string note = describe_unseen_sides(driving, track);
    return {std::move(driving), "moved " + track, note};
}

/// Returns true if the actor is present in at least one frame of the log.
bool is_present_in_any_frame(const DrivingScene& driving, const std::string& track) {
    const BoxTrack* box = find_box(driving.sequence, track);
    return box && std::ranges::any_of(driving.sequence.frames,
                                      [&](const Frame& f) { return box->is_present(f.time_s); });
}

/// Returns a warning if an edit removes an actor from frames of the log, for example
/// because its motion is delayed.
/// @param original_box track of the actor before the edit; null for a new actor
std::string describe_absence(const DrivingScene& driving, const std::string& track,
                             const BoxTrack* original_box) {
    if (!is_present_in_any_frame(driving, track))
        return fmt::format(
            "track {} is not visible in any frame, because all its times are outside the log's time", track);
    return original_box ? describe_lost_frames(*original_box, driving.sequence) : "";
}

BoxTrack copy_actor_box(const DrivingScene& driving, const std::string& track) {
    const BoxTrack* box = find_box(driving.sequence, track);
    // Returns an empty track if the actor is unknown. The edit itself reports this error
    // later.
    return box ? *box : BoxTrack{};
}

AppliedEdit apply_retime(DrivingScene driving, const TypedEdit& edit) {
    const auto [track, seconds] = split_at(edit, edit.value, edit.value.rfind(':'));
    const BoxTrack before = copy_actor_box(driving, track);
    driving = retime_track(std::move(driving), track, parse_edit_numbers(edit, seconds, 1, 1)[0]);
    const std::string note =
        join_notes({describe_absence(driving, track, &before), describe_unseen_sides(driving, track)});
    return {std::move(driving), fmt::format("delayed the motion of {} by {} s", track, seconds), note};
}

AppliedEdit apply_trajectory(DrivingScene driving, const TypedEdit& edit) {
    const auto [track, file] = split_at(edit, edit.value, edit.value.find(':'));
    const BoxTrack before = copy_actor_box(driving, track);
    driving = replace_trajectory(std::move(driving), track, read_trajectory(file));
    const std::string note =
        join_notes({describe_absence(driving, track, &before), describe_unseen_sides(driving, track)});
    return {std::move(driving), fmt::format("{} follows {}", track, file), note};
}

AppliedEdit apply_copy(DrivingScene driving, const TypedEdit& edit) {
    const auto [track, place] = split_at(edit, edit.value, edit.value.rfind('@'));
    const Start start = parse_start_pose(edit, place, driving, {driving, track, {}});
    driving = copy_track(std::move(driving), track, start);
    return {driving,
            fmt::format("copied {} as {}{}", track, get_last_track(driving),
                        describe_ground_contact(start, place)),
            join_notes({describe_unseen_ground(start, get_last_track(driving)),
                        describe_unseen_sides(driving, get_last_track(driving))})};
}

/// An actor that is inserted from another run or from an asset.
struct ExternalActor {
    std::string folder, track;
    Run run;
    DrivingScene owner;
};

/// Loads an actor from a folder. The text is "RUN#TRACK" or "ASSET".
ExternalActor load_external_actor(const TypedEdit& edit, const std::string& description) {
    const bool named = description.find('#') != std::string::npos;
    const auto [folder, named_track] =
        named ? split_at(edit, description, description.rfind('#')) : std::pair(description, std::string());
    Run run = load_run(folder);
    const std::string track = named ? named_track : find_only_track(run);
    DrivingScene owner = run.driving();
    return {folder, track, std::move(run), std::move(owner)};
}

/// Returns a warning if the actor was recorded with another type of sensor than this run.
std::string describe_sensor_of_actor(const ExternalActor& actor, const DrivingScene& driving) {
    const SpinningSensor &actor_sensor = actor.run.sequence.lidars[0].sensor,
                         &run_sensor = driving.sequence.lidars[0].sensor;
    if (actor_sensor.name == run_sensor.name && actor_sensor.beams.size() == run_sensor.beams.size())
        return "";
    return fmt::format(
        "{} was recorded by another sensor ({} with {} beams; this run has {} with {} beams): "
        "the shape and motion of {} are correct, but its intensities and dropped rays look like "
        "those of the other sensor",
        actor.folder, actor_sensor.name, actor_sensor.beams.size(), run_sensor.name, run_sensor.beams.size(),
        actor.track);
}

AppliedEdit apply_insert(DrivingScene driving, const TypedEdit& edit) {
    const auto [what, place] = split_at(edit, edit.value, edit.value.rfind('@'));
    const ExternalActor actor = load_external_actor(edit, what);
    const Start start = parse_start_pose(edit, place, driving,
                                         {actor.owner, actor.track, measure_asset_clearance(actor.run)});
    const std::string sensor = describe_sensor_of_actor(actor, driving);
    driving = insert_track(std::move(driving), actor.owner, actor.track, start);
    const std::string note = join_notes({sensor, describe_unseen_ground(start, get_last_track(driving)),
                                         describe_unseen_sides(driving, get_last_track(driving))});
    const std::string placed = describe_ground_contact(start, place);
    return {
        driving,
        fmt::format("inserted {} of {} as {}{}", actor.track, actor.folder, get_last_track(driving), placed),
        note};
}

bool has_track(const DrivingScene& driving, const std::string& track) {
    return std::ranges::any_of(driving.scene.instances,
                               [&](const Instance& i) { return !track.empty() && i.track == track; });
}

glm::dvec3 get_size_of_track(const DrivingScene& driving, const std::string& track) {
    const auto box = std::ranges::find(driving.sequence.boxes, track, &BoxTrack::id);
    return box == driving.sequence.boxes.end() ? glm::dvec3(0.0) : box->size_m;
}

/// Parses "ENTITY=ACTOR,ENTITY=ACTOR". Each pair assigns an actor to an entity of an
/// OpenSCENARIO file.
std::map<std::string, std::string> parse_roles(const TypedEdit& edit, const std::string& text) {
    std::map<std::string, std::string> roles;
    std::istringstream words(text);
    for (std::string word; std::getline(words, word, ',');) {
        auto [entity, actor] = split_at(edit, word, word.find('='));
        if (!roles.emplace(entity, actor).second) throw_edit_error(edit, fmt::format("{} once", entity));
    }
    return roles;
}

void append_note(std::string& note, const std::string& more) {
    if (!more.empty()) note += (note.empty() ? "" : "; ") + more;
}

/// Moves an actor along the trajectory of an entity of an OpenSCENARIO file. If the run
/// does not contain the actor, inserts it from another run or an asset.
void apply_entity_trajectory(const TypedEdit& edit, const ScenarioEntity& entity,
                             const std::string& description, AppliedEdit& applied) {
    DrivingScene& driving = applied.driving;
    std::string track = description;
    const bool is_known = has_track(driving, description);
    const BoxTrack before = copy_actor_box(driving, description);
    if (!is_known) {
        if (description.find('#') == std::string::npos && !std::filesystem::exists(description))
            throw_edit_error(edit, fmt::format("{}=TRACK of the run, RUN#TRACK or ASSET", entity.name));
        const ExternalActor actor = load_external_actor(edit, description);
        append_note(applied.note, describe_sensor_of_actor(actor, driving));
        driving = insert_track(std::move(driving), actor.owner, actor.track, {});
        track = get_last_track(driving);
    }
    const double begin_s = driving.sequence.frames.front().time_s;
    driving = replace_trajectory(std::move(driving), track,
                                 make_box_track(entity, begin_s, get_size_of_track(driving, track)));
    applied.said += fmt::format("{}{} follows {} of {}", applied.said.empty() ? "" : "\n", track, entity.name,
                                edit.value.substr(0, edit.value.find('@')));
    append_note(applied.note, describe_absence(driving, track, is_known ? &before : nullptr));
    append_note(applied.note, describe_unseen_sides(driving, track));
    if (!entity.ignored.empty())
        append_note(applied.note, fmt::format("the element {} of entity {} is not supported and is ignored",
                                              fmt::join(entity.ignored, ", "), entity.name));
}

AppliedEdit apply_scenario(DrivingScene driving, const TypedEdit& edit) {
    const std::size_t at = edit.value.find('@');
    const std::string file = edit.value.substr(0, at);
    std::map<std::string, std::string> roles;
    if (at != std::string::npos) roles = parse_roles(edit, split_at(edit, edit.value, at).second);
    AppliedEdit applied{std::move(driving), "", ""};
    for (const ScenarioEntity& entity : read_scenario(file)) {
        const auto role = roles.extract(entity.name);
        const bool follows = !entity.world_from_reference.pose.empty();
        const std::string what = role                                      ? role.mapped()
                                 : has_track(applied.driving, entity.name) ? entity.name
                                                                           : "";
        if (role && what != "-" && !follows)
            throw_edit_error(
                edit, fmt::format("an entity with a trajectory, but {} has no trajectory", entity.name));
        if (what.empty() && follows)
            throw_edit_error(
                edit, fmt::format("also {0}=TRACK, {0}=RUN#TRACK, {0}=ASSET or {0}=-, because the run has "
                                  "no actor of that name",
                                  entity.name));
        if (follows && what != "-") apply_entity_trajectory(edit, entity, what, applied);
        else
            append_note(applied.note,
                        fmt::format("{} {}", entity.name, follows ? "is ignored" : "has no trajectory"));
    }
    if (!roles.empty())
        throw_edit_error(edit,
                         fmt::format("entities of the file; {} is not in the file", roles.begin()->first));
    if (applied.said.empty())
        throw_edit_error(edit, "a scenario with at least one entity that follows a trajectory");
    return applied;
}

AppliedEdit apply_keep(DrivingScene driving, const TypedEdit& edit) {
    if (edit.value == "background")
        return {keep_background(std::move(driving)), "kept only the background", ""};
    if (edit.value == "actors") return {keep_actors(std::move(driving)), "kept only the actors", ""};
    throw_edit_error(edit, "background or actors");
}

}  // namespace

const std::vector<EditOption>& list_edit_options() {
    static const std::vector<EditOption> options{
        {"--remove", "TRACK", "remove an actor; rays then hit the surfaces behind it"},
        {"--move", "TRACK:dx,dy,dz[,yaw_deg]",
         "shift an actor along its full path, in the frame of its box (forward, left, up), and "
         "turn it to the left by yaw_deg"},
        {"--retime", "TRACK:seconds", "delay all motion of an actor by this time"},
        {"--trajectory", "TRACK:FILE.csv",
         "replace the poses of an actor: lines of time_s,x,y,z,yaw_deg[,pitch_deg,roll_deg]; an "
         "optional header line names the columns in any order, and names that end in _rad are in "
         "radians"},
        {"--copy", "TRACK@x,y,z,yaw_deg[,pitch_deg,roll_deg][:speed] or TRACK@x,y,ground[,yaw_deg][:speed]",
         "add a copy of an actor that drives straight ahead at speed m/s; ground: take height and tilt from "
         "the surface below"},
        {"--insert", "RUN#TRACK@PLACE|ASSET@PLACE",
         "add an actor of another run, or an asset of `relidar assets`; PLACE has the same form as in "
         "--copy"},
        {"--scenario", "FILE.xosc[@ENTITY=TRACK,ENTITY=RUN#TRACK,ENTITY=ASSET,ENTITY=-]",
         "move actors along the timed polylines of the entities of an OpenSCENARIO file. An entity moves the "
         "actor of the same name, the actor given here, or an inserted actor; -: ignore the entity"},
        {"--keep", "background|actors", "keep only the background or only the actors"}};
    return options;
}

AppliedEdit apply(DrivingScene driving, const TypedEdit& edit) {
    using Apply = AppliedEdit (*)(DrivingScene, const TypedEdit&);
    static const std::vector<std::pair<std::string, Apply>> functions{
        {"--remove", remove_one},           {"--move", apply_move}, {"--retime", apply_retime},
        {"--trajectory", apply_trajectory}, {"--copy", apply_copy}, {"--insert", apply_insert},
        {"--scenario", apply_scenario},     {"--keep", apply_keep}};
    const auto function = std::find_if(functions.begin(), functions.end(),
                                       [&](const auto& f) { return f.first == edit.option; });
    try {
        return function->second(std::move(driving), edit);
    } catch (const UsageError& error) {
        // Adds the option and its value to the error message, so that the user knows
        // which of several edits failed.
        const std::string message = error.what();
        throw UsageError(message.starts_with(edit.option)
                             ? message
                             : fmt::format("{} {}: {}", edit.option, edit.value, message));
    }
}

}  // namespace relidar::cli
