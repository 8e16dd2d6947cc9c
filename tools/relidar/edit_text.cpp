// SPDX-License-Identifier: Apache-2.0
#include "edit_text.hpp"

#include <algorithm>
#include <cmath>
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

Pose pose_of(const std::vector<double>& v) {
    return {glm::angleAxis((v.size() > 3 ? v[3] : 0.0) * kPi / 180.0, glm::dvec3(0, 0, 1)), {v[0], v[1], v[2]}};
}

/// "x,y,z,yaw_deg[:speed]"
Start start_of(const TypedEdit& edit, const std::string& text) {
    const std::size_t colon = text.find(':');
    Start start{pose_of(numbers(edit, text.substr(0, colon), 4, 4))};
    if (colon != std::string::npos) start.speed_mps = numbers(edit, text.substr(colon + 1), 1, 1)[0];
    if (std::abs(start.speed_mps) > kFarOff_m) refuse(edit, "a speed in m/s");
    return start;
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
    driving = copy_track(std::move(driving), track, start_of(edit, place));
    return {driving, fmt::format("copied {} as {}", track, last_track(driving)), ""};
}

AppliedEdit insert(DrivingScene driving, const TypedEdit& edit) {
    const auto [what, place] = cut(edit, edit.value, edit.value.rfind('@'));
    const bool named = what.find('#') != std::string::npos;
    const auto [folder, named_track] = named ? cut(edit, what, what.rfind('#')) : std::pair(what, std::string());
    const Start start = start_of(edit, place);
    const Run other = load_run(folder);
    const std::string track = named ? named_track : only_track(other);
    const SpinningSensor &theirs = other.sequence.lidars[0].sensor, &ours = driving.sequence.lidars[0].sensor;
    const bool same = theirs.name == ours.name && theirs.beams.size() == ours.beams.size();
    const std::string note = same ? ""
                                  : fmt::format(
                                        "{} was recorded by another sensor ({}, {} beams; here {}, {} beams): shape and motion of {} are "
                                        "right, its intensities and ray-drop are those of that sensor",
                                        folder, theirs.name, theirs.beams.size(), ours.name, ours.beams.size(), track);
    driving = insert_track(std::move(driving), {other.scene, other.sequence}, track, start);
    return {driving, fmt::format("inserted {} of {} as {}", track, folder, last_track(driving)), note};
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
        {"--move", "TRACK:dx,dy,dz[,yaw_deg]", "shift an actor in its own frame (forward, left, up) and turn it left, all along its way"},
        {"--retime", "TRACK:seconds", "let everything it does happen so much later"},
        {"--trajectory", "TRACK:FILE.csv", "give it other poses: lines of time_s,x,y,z,yaw_deg[,pitch_deg,roll_deg]"},
        {"--copy", "TRACK@x,y,z,yaw_deg[:speed]", "place its model once more, driving straight ahead at speed m/s"},
        {"--insert", "RUN#TRACK|ASSET@x,y,z,yaw_deg[:speed]", "the same with an actor of another run, or an asset of `relidar assets`"},
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
