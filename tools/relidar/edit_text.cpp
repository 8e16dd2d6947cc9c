// SPDX-License-Identifier: Apache-2.0
#include "edit_text.hpp"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "options.hpp"
#include <relidar/assets.hpp>
#include <relidar/error.hpp>
#include <relidar/run.hpp>

namespace relidar::cli {
namespace {

constexpr double kFarOff_m = 1e6;   // beyond it an offset or a speed is a slip

[[noreturn]] void refuse(const TypedEdit& edit, const std::string& expected) {
    throw UsageError(fmt::format("{}: found \"{}\", expected {}", edit.option, edit.value, expected));
}

const char* form_of(const TypedEdit& edit) {
    const auto& known = edit_options();
    return std::find_if(known.begin(), known.end(), [&](const EditOption& o) { return edit.option == o.option; })->form;
}

/// The parts before and after a separator, neither of them empty.
std::pair<std::string, std::string> cut(const TypedEdit& edit, const std::string& text, std::size_t at) {
    if (at == std::string::npos || at == 0 || at + 1 == text.size()) refuse(edit, form_of(edit));
    return {text.substr(0, at), text.substr(at + 1)};
}

std::vector<double> numbers(const TypedEdit& edit, const std::string& text, std::size_t least, std::size_t most) {
    const std::vector<double> values = parse_list(edit.option, text);
    if (values.size() < least || values.size() > most) refuse(edit, form_of(edit));
    for (const double v : values)
        if (std::abs(v) > 1e9) refuse(edit, "numbers below 1e9");
    return values;
}

/// x, y, z and, as far as they are there, yaw, pitch and roll in degrees.
Pose pose_of(const std::vector<double>& v) {
    const auto radians = [&](std::size_t i) { return i < v.size() ? v[i] * kPi / 180.0 : 0.0; };
    return {rotation_of(radians(3), radians(4), radians(5)), {v[0], v[1], v[2]}};
}

/// "x,y,ground[,yaw_deg]"; nothing where the third is not that word.
std::optional<GroundPlace> ground_place(const TypedEdit& edit, const std::string& text) {
    constexpr std::string_view kWord = ",ground";
    const std::size_t at = text.find(kWord);
    if (at == std::string::npos) return {};
    const std::vector<double> xy = numbers(edit, text.substr(0, at), 2, 2);
    GroundPlace place{{xy[0], xy[1]}};
    const std::string rest = text.substr(at + kWord.size());
    if (!rest.empty() && rest[0] != ',') refuse(edit, form_of(edit));
    if (!rest.empty()) place.yaw_rad = numbers(edit, rest.substr(1), 1, 1)[0] * kPi / 180.0;
    return place;
}

/// An actor, and the scene that has it.
struct OwnedActor {
    const DrivingScene& owner;
    const std::string& track;
    std::optional<double> clearance_m;   ///< above the ground, where it is known
};

/// "x,y,z,yaw_deg[,pitch_deg,roll_deg][:speed]" or "x,y,ground[,yaw_deg][:speed]"
Start start_of(const TypedEdit& edit, const std::string& text, const DrivingScene& driving, const OwnedActor& actor) {
    const std::size_t colon = text.find(':');
    const double speed_mps = colon == std::string::npos ? 0.0 : numbers(edit, text.substr(colon + 1), 1, 1)[0];
    if (std::abs(speed_mps) > kFarOff_m) refuse(edit, "a speed in m/s");
    const std::string place = text.substr(0, colon);
    if (std::optional<GroundPlace> ground = ground_place(edit, place)) {
        ground->speed_mps = speed_mps;
        ground->clearance_m = actor.clearance_m;
        return start_on_ground({driving.scene, driving.sequence}, *ground, {actor.owner.scene, actor.owner.sequence}, actor.track);
    }
    const std::vector<double> pose = numbers(edit, place, 4, 6);
    if (pose.size() == 5) refuse(edit, form_of(edit));
    return {pose_of(pose), speed_mps};
}

/// Where an actor stands, for one that was put on the ground: nothing was typed of its height.
std::string standing(const Start& start, const std::string& typed) {
    if (typed.find(",ground") == std::string::npos) return "";
    const glm::dvec3& p = start.dataset_from_box.translation;
    const double tilt_deg = std::acos(std::clamp((start.dataset_from_box.rotation * glm::dvec3(0, 0, 1)).z, -1.0, 1.0)) * 180.0 / kPi;
    return fmt::format(", on the ground at {:.2f},{:.2f},{:.2f}, tilted by {:.1f} degrees", p.x, p.y, p.z, tilt_deg);
}

const std::string& last_track(const DrivingScene& driving) { return driving.scene.instances.back().track; }

AppliedEdit remove_one(DrivingScene driving, const TypedEdit& edit) {
    return {remove_track(std::move(driving), edit.value), "removed " + edit.value, ""};
}

AppliedEdit move(DrivingScene driving, const TypedEdit& edit) {
    const auto [track, offset] = cut(edit, edit.value, edit.value.rfind(':'));
    return {move_track(std::move(driving), track, pose_of(numbers(edit, offset, 3, 4))), "moved " + track, ""};
}

/// Whether an actor is there at any frame of the log.
bool is_ever_present(const DrivingScene& driving, const std::string& track) {
    return std::any_of(driving.sequence.boxes.begin(), driving.sequence.boxes.end(), [&](const BoxTrack& b) {
        return b.id == track && std::any_of(driving.sequence.frames.begin(), driving.sequence.frames.end(),
                                            [&](const Frame& f) { return b.present(f.time_s); });
    });
}

std::string absence_note(const DrivingScene& driving, const std::string& track) {
    return is_ever_present(driving, track) ? ""
                                           : fmt::format("track {} is there at no frame of the log now: its times lie outside it", track);
}

AppliedEdit retime(DrivingScene driving, const TypedEdit& edit) {
    const auto [track, seconds] = cut(edit, edit.value, edit.value.rfind(':'));
    driving = retime_track(std::move(driving), track, numbers(edit, seconds, 1, 1)[0]);
    const std::string note = absence_note(driving, track);
    return {std::move(driving), fmt::format("retimed {} by {} s", track, seconds), note};
}

AppliedEdit trajectory(DrivingScene driving, const TypedEdit& edit) {
    const auto [track, file] = cut(edit, edit.value, edit.value.find(':'));
    driving = replace_trajectory(std::move(driving), track, read_trajectory(file));
    const std::string note = absence_note(driving, track);
    return {std::move(driving), fmt::format("{} follows {}", track, file), note};
}

AppliedEdit copy(DrivingScene driving, const TypedEdit& edit) {
    const auto [track, place] = cut(edit, edit.value, edit.value.rfind('@'));
    const Start start = start_of(edit, place, driving, {driving, track, {}});
    driving = copy_track(std::move(driving), track, start);
    return {driving, fmt::format("copied {} as {}{}", track, last_track(driving), standing(start, place)), ""};
}

AppliedEdit insert(DrivingScene driving, const TypedEdit& edit) {
    const auto [what, place] = cut(edit, edit.value, edit.value.rfind('@'));
    const bool named = what.find('#') != std::string::npos;
    const auto [folder, named_track] = named ? cut(edit, what, what.rfind('#')) : std::pair(what, std::string());
    const Run other = load_run(folder);
    const std::string track = named ? named_track : only_track(other);
    const DrivingScene owner = other.driving();
    const Start start = start_of(edit, place, driving, {owner, track, asset_clearance(other)});
    const SpinningSensor &theirs = other.sequence.lidars[0].sensor, &ours = driving.sequence.lidars[0].sensor;
    const bool same = theirs.name == ours.name && theirs.beams.size() == ours.beams.size();
    const std::string note = same ? ""
                                  : fmt::format(
                                        "{} was recorded by another sensor ({}, {} beams; here {}, {} beams): shape and motion of {} are "
                                        "right, its intensities and ray-drop are those of that sensor",
                                        folder, theirs.name, theirs.beams.size(), ours.name, ours.beams.size(), track);
    driving = insert_track(std::move(driving), owner, track, start);
    return {driving, fmt::format("inserted {} of {} as {}{}", track, folder, last_track(driving), standing(start, place)), note};
}

AppliedEdit keep(DrivingScene driving, const TypedEdit& edit) {
    if (edit.value == "background") return {keep_background(std::move(driving)), "kept the background alone", ""};
    if (edit.value == "actors") return {keep_actors(std::move(driving)), "kept the actors alone", ""};
    refuse(edit, "background or actors");
}

}  // namespace

const std::vector<EditOption>& edit_options() {
    static const std::vector<EditOption> options{
        {"--remove", "TRACK", "take an actor out; rays continue to what is behind it"},
        {"--move", "TRACK:dx,dy,dz[,yaw_deg]", "shift an actor in its own frame (forward, left, up) and turn it left, on all its path"},
        {"--retime", "TRACK:seconds", "let everything it does happen so much later"},
        {"--trajectory", "TRACK:FILE.csv", "give it other poses: lines of time_s,x,y,z,yaw_deg[,pitch_deg,roll_deg]"},
        {"--copy",
         "TRACK@x,y,z,yaw_deg[,pitch_deg,roll_deg][:speed] or TRACK@x,y,ground[,yaw_deg][:speed]",
         "place its model once more, driving straight ahead at speed m/s; ground: height and tilt from the surface below"},
        {"--insert",
         "RUN#TRACK@PLACE|ASSET@PLACE",
         "the same with an actor of another run, or an asset of `relidar assets`; PLACE as of --copy"},
        {"--keep", "background|actors", "drop the other"}};
    return options;
}

AppliedEdit apply(DrivingScene driving, const TypedEdit& edit) {
    using Apply = AppliedEdit (*)(DrivingScene, const TypedEdit&);
    static const std::vector<std::pair<std::string, Apply>> functions{
        {"--remove", remove_one}, {"--move", move},     {"--retime", retime}, {"--trajectory", trajectory},
        {"--copy", copy},         {"--insert", insert}, {"--keep", keep}};
    const auto function = std::find_if(functions.begin(), functions.end(), [&](const auto& f) { return f.first == edit.option; });
    try {
        return function->second(std::move(driving), edit);
    } catch (const UsageError& error) {   // which of several edits it was
        const std::string message = error.what();
        throw UsageError(message.starts_with(edit.option) ? message : fmt::format("{} {}: {}", edit.option, edit.value, message));
    }
}

}  // namespace relidar::cli
