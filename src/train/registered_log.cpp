// SPDX-License-Identifier: Apache-2.0
#include "train/registered_log.hpp"

#include <algorithm>
#include <iterator>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/error.hpp>
#include <relidar/registration.hpp>

namespace relidar {
namespace {

constexpr const char* kStartPoses = "poses/start";   // [poses*7] of the sensor, then of every box: translation, quaternion w x y z

/// @param track [poses] of the log, and as registered
std::string corrections_text(const PoseTrack& from, const PoseTrack& to) {
    std::vector<double> metres;
    for (std::size_t k = 0; k < from.pose.size(); ++k) metres.push_back(glm::length(to.pose[k].translation - from.pose[k].translation));
    std::sort(metres.begin(), metres.end());
    return fmt::format("corrections of {:.3f} m (median) to {:.3f} m", metres[metres.size() / 2], metres.back());
}

void stop_if(bool stopped) {
    if (stopped) throw Error(ExitCode::interrupted, "interrupted while scans were registered: nothing is trained yet");
}

void register_sensor(Sequence& log, const Split& split, const RegisterOptions& options, const TrainSession& session) {
    const Registration found = register_scans(log, split, options);
    stop_if(found.stopped);
    if (found.rounds.empty()) return;
    if (session.note)
        session.note(fmt::format("scans registered: {:.3f} m from common planes at first, {:.3f} m now; {}", found.rounds.front().residual_m, found.rounds.back().residual_m,
                                 corrections_text(log.world_from_sensor, found.world_from_sensor)));
    if (!found.lost.empty() && session.note) {
        std::vector<int> frames;
        for (const std::size_t k : found.lost) frames.push_back(log.frames[k].index);
        session.note(fmt::format("frames {}: their scans did not find their place within {} m, their poses are corrected as those of their neighbours", fmt::join(frames, ", "), options.largest_m));
    }
    set_sensor_poses(log, found.world_from_sensor);
}

/// Every pose of a log in a fixed order.
template <class Poses, class Visit>
void visit_poses(Poses& poses, const Visit& visit) {
    for (auto& pose : poses.world_from_sensor.pose) visit(pose);
    for (auto& box : poses.boxes)
        for (auto& pose : box.world_from_box.pose) visit(pose);
}

}  // namespace

std::optional<Sequence> registered_log(const Sequence& sequence, const Split& split, const Config& config, const TrainSession& session) {
    if (!config.train.pose_register || config.train.refine_poses.find("sensor") == std::string::npos) return std::nullopt;
    Sequence log = sequence;
    if (session.start) {
        RefinedPoses poses = read_start_poses(*session.start, sequence);
        log.world_from_sensor = std::move(poses.world_from_sensor);
        log.boxes = std::move(poses.boxes);
        return log;
    }
    RegisterOptions options{config.train.pose_largest_m, {}, config.init.actor_margin_m, session.stop};
    std::ranges::copy_if(log.boxes, std::back_inserter(options.movers), [&](const BoxTrack& box) { return box.mean_step_m() > config.init.actor_min_step_m; });
    register_sensor(log, split, options, session);
    return log;
}

void write_start_poses(StateWriter& write, const RefinedPoses& poses) {
    std::vector<double> values;
    visit_poses(poses, [&](const Pose& p) { values.insert(values.end(), {p.translation.x, p.translation.y, p.translation.z, p.rotation.w, p.rotation.x, p.rotation.y, p.rotation.z}); });
    write(kStartPoses, values);
}

RefinedPoses read_start_poses(const Checkpoint& checkpoint, const Sequence& sequence) {
    RefinedPoses poses{sequence.world_from_sensor, sequence.boxes};
    std::size_t n = 0;
    visit_poses(poses, [&](const Pose&) { n += 7; });
    std::vector<double> values;
    const StateReader read(checkpoint);
    read(kStartPoses, values);
    if (values.size() != n) throw DataError(fmt::format("resuming from iteration {}: {}: found {} numbers, expected {} for the poses of this log", checkpoint.iteration, kStartPoses, values.size(), n));
    std::size_t at = 0;
    visit_poses(poses, [&](Pose& p) {
        const double* v = values.data() + at;
        p = {glm::dquat(v[3], v[4], v[5], v[6]), {v[0], v[1], v[2]}};
        at += 7;
    });
    return poses;
}

}  // namespace relidar
