// SPDX-License-Identifier: Apache-2.0
#include "edit/edit_text.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include <relidar/run/run.hpp>
#include <relidar/simulate/assets.hpp>
#include "base/fail.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

// A larger offset or speed is probably a typing error.
constexpr double kFarOff_m = 1e6;

[[noreturn]] void fail_edit(const EditArgument& edit, const std::string& expected_value) {
    fail<UsageError>("{}: found \"{}\", expected {}", edit.option, edit.value, expected_value);
}

const EditOption& option_of(const EditArgument& edit) {
    return *std::ranges::find(edit_options(), edit.option, &EditOption::option);
}

const char* value_syntax(const EditArgument& edit) { return option_of(edit).form; }

/// Splits a text at its separator with index `at`. Throws an error if a part is empty.
std::pair<std::string, std::string> split_text(const EditArgument& edit, const std::string& text,
                                               std::size_t at) {
    if (at == std::string::npos || at == 0 || at + 1 == text.size()) fail_edit(edit, value_syntax(edit));
    return {text.substr(0, at), text.substr(at + 1)};
}

std::vector<double> parse_numbers(const EditArgument& edit, const std::string& text, std::size_t min_count,
                                  std::size_t max_count) {
    const std::vector<double> values = parse_list(edit.option, text);
    if (values.size() < min_count || values.size() > max_count) fail_edit(edit, value_syntax(edit));
    for (const double v : values)
        if (std::abs(v) > 1e9) fail_edit(edit, "numbers from -1e9 to 1e9");
    return values;
}

Pose make_pose(const std::vector<double>& xyz_yaw_pitch_roll) {
    const auto radians = [&](std::size_t index) {
        return index < xyz_yaw_pitch_roll.size() ? xyz_yaw_pitch_roll[index] * kPi / 180.0 : 0.0;
    };
    return {make_rotation(radians(3), radians(4), radians(5)),
            {xyz_yaw_pitch_roll[0], xyz_yaw_pitch_roll[1], xyz_yaw_pitch_roll[2]}};
}

/// Parses "x,y,ground[,yaw_deg]". Returns no value if the third field is not the word
/// "ground", because the text is then a full pose.
std::optional<GroundPlacement> parse_ground(const EditArgument& edit, const std::string& text) {
    constexpr std::string_view kGroundWord = ",ground";
    const std::size_t word = text.find(kGroundWord);
    if (word == std::string::npos) return {};
    const std::vector<double> xy = parse_numbers(edit, text.substr(0, word), 2, 2);
    GroundPlacement placement{{xy[0], xy[1]}};
    const std::string yaw_part = text.substr(word + kGroundWord.size());  // ",yaw_deg" or empty
    if (yaw_part.empty()) return placement;
    if (yaw_part[0] != ',') fail_edit(edit, value_syntax(edit));
    placement.yaw_rad = parse_numbers(edit, yaw_part.substr(1), 1, 1)[0] * kPi / 180.0;
    return placement;
}

struct ActorToInsert {
    const SceneWithLog& owner;  ///< Scene that contains the actor.
    const std::string& track;
    std::optional<double> clearance_m = {};  ///< Height of its box above the ground, if it is known.
};

/// Parses a start pose with an optional speed in m/s. The text has the form
/// "x,y,z,yaw_deg[,pitch_deg,roll_deg][:speed]" or "x,y,ground[,yaw_deg][:speed]".
NewActorMotion parse_motion(const EditArgument& edit, const std::string& text, const SceneWithLog& edited,
                            const ActorToInsert& actor) {
    const std::size_t colon = text.find(':');
    const bool has_speed = colon != std::string::npos;
    const double speed_mps = has_speed ? parse_numbers(edit, text.substr(colon + 1), 1, 1)[0] : 0.0;
    if (std::abs(speed_mps) > kFarOff_m) fail_edit(edit, "a speed from -1e6 to 1e6 m/s");
    const std::string position_text = text.substr(0, colon);
    if (std::optional<GroundPlacement> ground = parse_ground(edit, position_text)) {
        ground->speed_mps = speed_mps;
        ground->clearance_m = actor.clearance_m;
        return stand_on_ground({edited.scene, edited.log}, *ground, {actor.owner.scene, actor.owner.log},
                               actor.track);
    }
    const std::vector<double> numbers = parse_numbers(edit, position_text, 4, 6);
    if (numbers.size() == 5) fail_edit(edit, value_syntax(edit));  // pitch without roll
    const Pose start = make_pose(numbers);
    if (!(glm::distance(start.translation, edited.log.world_offset_m) < kFarOff_m))
        fail_edit(edit, "a position less than 1e6 m from the log");
    return {start, speed_mps};
}

/// Returns a text with position and tilt of an actor that the program has placed on the
/// ground, because the user did not type them. Returns an empty text for other actors.
std::string describe_ground(const NewActorMotion& start, const std::string& placement_text) {
    if (placement_text.find(",ground") == std::string::npos) return "";
    const glm::dvec3& p = start.dataset_from_box.translation;
    const double cos_tilt = (start.dataset_from_box.rotation * glm::dvec3(0, 0, 1)).z;
    const double tilt_deg = std::acos(std::clamp(cos_tilt, -1.0, 1.0)) * 180.0 / kPi;
    return fmt::format(", on the ground at {:.2f},{:.2f},{:.2f}, tilted by {:.1f} degrees", p.x, p.y, p.z,
                       tilt_deg);
}

std::string warn_unobserved(const NewActorMotion& start, const std::string& track_id) {
    if (start.unseen_m == 0.0) return "";
    return fmt::format(
        "actor {}: the log did not record the ground below {:.0f} m of its path, so the height there is only "
        "estimated from the rest of the path",
        track_id, start.unseen_m);
}

std::string join_notes(const std::vector<std::string>& notes) {
    std::string text;
    for (const std::string& note : notes)
        if (!note.empty()) text += (text.empty() ? "" : "; ") + note;
    return text;
}

const std::string& last_track_id(const SceneWithLog& edited) { return edited.scene.instances.back().track; }

EditResult apply_remove(SceneWithLog edited, const EditArgument& edit) {
    return {remove_track(std::move(edited), edit.value), "removed " + edit.value, ""};
}

EditResult apply_move_edit(SceneWithLog edited, const EditArgument& edit) {
    const auto [track, offset] = split_text(edit, edit.value, edit.value.rfind(':'));
    edited = move_track(std::move(edited), track, make_pose(parse_numbers(edit, offset, 3, 4)));
    return {std::move(edited), "moved " + track, ""};
}

/// Sets the class of an actor or object. Notes a class that has no standard kind
/// (vehicle, cyclist or person).
EditResult apply_class(SceneWithLog edited, const EditArgument& edit) {
    const auto [track, name] = split_text(edit, edit.value, edit.value.rfind('='));
    edited = classify_track(std::move(edited), track, name);
    std::string note;
    if (parse_kind(name) == ObjectKind::other)
        note =
            fmt::format("the class {} is no vehicle, cyclist or person, so labels have the kind other", name);
    return {std::move(edited), fmt::format("set the class of {} to {}", track, name), note};
}

/// Returns a warning if an edited actor is absent in all frames of the log, or in frames
/// in which it was present before. Otherwise, returns an empty text.
std::string warn_absent(const SceneWithLog& edited, const std::string& id, const BoxTrack& before) {
    const BoxTrack* box = find_box(edited.log, id);
    const auto is_present = [&](const Frame& frame) { return box && box->is_observed(frame.time_s); };
    if (std::ranges::any_of(edited.log.frames, is_present))
        return describe_absence(before, edited.log);  // lists the frames that the edit has lost
    return fmt::format(
        "actor {} is not visible in any frame, because all times of its trajectory are outside the time of "
        "the log",
        id);
}

BoxTrack find_box_track(const SceneWithLog& edited, const std::string& track_id) {
    const BoxTrack* box = find_box(edited.log, track_id);
    // The function that edits an unknown actor reports the error.
    return box ? *box : BoxTrack{};
}

EditResult apply_delay(SceneWithLog edited, const EditArgument& edit) {
    const auto [track, seconds] = split_text(edit, edit.value, edit.value.rfind('='));
    const BoxTrack before = find_box_track(edited, track);
    edited = delay_track(std::move(edited), track, parse_numbers(edit, seconds, 1, 1)[0]);
    const std::string note = warn_absent(edited, track, before);
    return {std::move(edited), fmt::format("delayed the motion of {} by {} s", track, seconds), note};
}

EditResult apply_speed(SceneWithLog edited, const EditArgument& edit) {
    const auto [track, factor] = split_text(edit, edit.value, edit.value.rfind('='));
    const BoxTrack before = find_box_track(edited, track);
    edited = scale_speed(std::move(edited), track, parse_numbers(edit, factor, 1, 1)[0]);
    const std::string note = warn_absent(edited, track, before);
    return {std::move(edited), fmt::format("multiplied the speed of {} by {}", track, factor), note};
}

/// Replaces the poses of an actor by those of a CSV file. A file without heights places
/// the actor on the ground.
EditResult apply_trajectory(SceneWithLog edited, const EditArgument& edit) {
    const auto [track, file] = split_text(edit, edit.value, edit.value.find(':'));
    const BoxTrack before = find_box_track(edited, track);
    NewActorMotion motion{.dataset_from_box = {},
                          .dataset_path = read_actor_path(file, edited.log.georeference)};
    // NaN: the file has the word `ground` instead of heights.
    if (std::isnan(motion.dataset_path.pose.front().translation.z)) {
        // The actor and the ground are in the same scene. The actor keeps its clearance.
        const SceneWithLogView scene{edited.scene, edited.log};
        motion = follow_ground(scene, motion.dataset_path, /*clearance_m=*/{}, scene, track);
    }
    edited = replace_track(std::move(edited), track, motion.dataset_path);
    const std::string note = join_notes({warn_absent(edited, track, before), warn_unobserved(motion, track)});
    return {std::move(edited), fmt::format("{} follows {}", track, file), note};
}

EditResult apply_copy_edit(SceneWithLog edited, const EditArgument& edit) {
    const auto [track, place] = split_text(edit, edit.value, edit.value.rfind('@'));
    const NewActorMotion start = parse_motion(edit, place, edited, {.owner = edited, .track = track});
    edited = copy_track(std::move(edited), track, start);
    return {edited,
            fmt::format("copied {} as {}{}", track, last_track_id(edited), describe_ground(start, place)),
            warn_unobserved(start, last_track_id(edited))};
}

struct ExternalActor {
    std::string folder, track;
    Run run;
    SceneWithLog owner;
};

/// Loads an actor from RUN#TRACK (run folder and track name), or from an asset folder.
ExternalActor load_actor(const EditArgument& context, const std::string& source) {
    const bool named = source.find('#') != std::string::npos;
    const auto [folder, named_track] =
        named ? split_text(context, source, source.rfind('#')) : std::pair(source, std::string());
    Run run = load_run(folder);
    const std::string track = named ? named_track : only_track(run);
    SceneWithLog owner = run.driving_scene();
    return {folder, track, std::move(run), std::move(owner)};
}

/// Returns a warning if an actor was recorded with another sensor than the edited run.
std::string warn_other_sensor(const ExternalActor& actor, const SceneWithLog& edited) {
    const SpinningSensor &actor_sensor = actor.run.log.lidars[0].sensor,
                         &run_sensor = edited.log.lidars[0].sensor;
    if (actor_sensor.name == run_sensor.name && actor_sensor.beams.size() == run_sensor.beams.size())
        return "";
    return fmt::format(
        "{} was recorded with another sensor ({} with {} beams; this run has {} with {} beams); shape and "
        "motion of actor {} are correct, but its intensities and dropped rays look like those of the other "
        "sensor",
        actor.folder, actor_sensor.name, actor_sensor.beams.size(), run_sensor.name, run_sensor.beams.size(),
        actor.track);
}

/// Adds an actor to the scene, at the place after @: RUN#TRACK of a run, or an asset.
EditResult apply_insert(SceneWithLog edited, const EditArgument& edit) {
    const auto [what, place] = split_text(edit, edit.value, edit.value.rfind('@'));
    const ExternalActor actor = load_actor(edit, what);
    const NewActorMotion start =
        parse_motion(edit, place, edited, {actor.owner, actor.track, read_clearance(actor.run)});
    const std::string sensor_note = warn_other_sensor(actor, edited);
    edited = insert_track(std::move(edited), actor.owner, actor.track, start);
    const std::string& new_id = last_track_id(edited);
    return {edited,
            fmt::format("inserted {} of {} as {}{}", actor.track, actor.folder, new_id,
                        describe_ground(start, place)),
            join_notes({sensor_note, warn_unobserved(start, new_id)})};
}

/// Sets the place of the log on the earth.
EditResult apply_georeference(SceneWithLog edited, const EditArgument& edit) {
    const GeoreferenceFit fit = read_georeference(edit.value, edited.log);
    if (!fit.georeference) fail("{}: {}", edit.value, fit.note);
    edited.log.georeference = fit.georeference;
    return {std::move(edited), "set the georeference to that of " + edit.value, fit.note};
}

/// Makes an actor of the standing object that an edit names, if any. Returns a note about
/// what the log has not observed of it.
std::string release_named(SceneWithLog& edited, const EditArgument& edit) {
    constexpr std::string_view kOtherOptions[] = {"--class", "--insert", "--georeference", "--keep"};
    if (std::ranges::count(kOtherOptions, edit.option) > 0) return "";
    const std::string track =
        edit.value.substr(0, edit.option == "--remove" ? std::string::npos : edit.value.find_first_of(":@="));
    if (!find_standing({edited.scene, edited.log}, track)) return "";
    ReleasedObject released = release_standing(std::move(edited), track);
    const std::string note = describe_release(released, track);
    edited = std::move(released.edited);
    return note;
}

EditResult apply_keep_only(SceneWithLog edited, const EditArgument& edit) {
    if (edit.value == "background") return {remove_actors(std::move(edited)), "kept only the background", ""};
    if (edit.value == "actors") return {remove_background(std::move(edited)), "kept only the actors", ""};
    fail_edit(edit, "background or actors");
}

}  // namespace

const std::vector<EditOption>& edit_options() {
    static const std::vector<EditOption> options{
        {"--remove", apply_remove, "TRACK",
         "remove an actor or a labelled object that stands still; rays then hit the surfaces behind it"},
        {"--move", apply_move_edit, "TRACK:dx,dy,dz[,yaw_deg]",
         "shift the full path of an actor by these metres in the frame of its box (forward, left, up), and "
         "turn the actor to the left by yaw_deg"},
        {"--class", apply_class, "TRACK=NAME",
         "set the class of an actor, or of a labelled object in the background, in all labels; vehicle, "
         "cyclist, person, or a class name of a dataset"},
        {"--retime", apply_delay, "TRACK=SECONDS",
         "delay all motion of an actor by this time in seconds; negative values make it earlier"},
        {"--speed", apply_speed, "TRACK=FACTOR",
         "multiply the speed of an actor along its path, which begins at the same time"},
        {"--trajectory", apply_trajectory, "TRACK:FILE.csv",
         "replace the poses of an actor: lines of time_s,x,y,z,yaw_deg[,pitch_deg,roll_deg]; an optional "
         "header line names the columns in any order, and names that end in _rad are in radians; with the "
         "word `ground` in the column z, the surface below gives height, pitch and roll"},
        {"--copy", apply_copy_edit,
         "TRACK@x,y,z,yaw_deg[,pitch_deg,roll_deg][:speed] or TRACK@x,y,ground[,yaw_deg][:speed]",
         "add a copy of an actor that starts at this pose and drives straight ahead at speed m/s; with "
         "`ground` instead of z, the surface below gives its height and tilt"},
        {"--insert", apply_insert, "RUN#TRACK@PLACE|ASSET@PLACE",
         "add an actor of another run, or an asset of `relidar assets`; PLACE has the same form as in "
         "--copy"},
        {"--georeference", apply_georeference, "FILE.json|FILE.csv",
         "set the place of the log on the earth: the georeference of a JSON file, or a fit of the path of "
         "the "
         "vehicle to GPS positions, lines of time_s,latitude_deg,longitude_deg,height_m"},
        {"--keep", apply_keep_only, "background|actors", "keep only the background or only the actors"}};
    return options;
}

EditResult apply_edit(SceneWithLog edited, const EditArgument& edit) {
    try {
        const std::string note = release_named(edited, edit);
        EditResult result = option_of(edit).apply(std::move(edited), edit);
        result.note = join_notes({note, result.note});
        return result;
    } catch (const UsageError& error) {
        // Adds the option and its value to the message, so that the user knows which of
        // several edits failed.
        const std::string message = error.what();
        throw UsageError(message.starts_with(edit.option)
                             ? message
                             : fmt::format("{} {}: {}", edit.option, edit.value, message));
    }
}

}  // namespace relidar::cli
