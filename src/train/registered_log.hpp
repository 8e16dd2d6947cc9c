// SPDX-License-Identifier: Apache-2.0
// The log with the poses that training starts from (train.pose_register). Private to train.
#pragma once

#include <optional>

#include <relidar/checkpoint.hpp>
#include <relidar/train.hpp>

namespace relidar {

/// A copy of the log whose sensor was registered, its boxes going along, or read back from the session's checkpoint; nothing where none are.
/// Tells through session.note what it has done. @throws Error with exit code 130 where the session was stopped meanwhile; DataError as register_scans
std::optional<Sequence> registered_log(const Sequence& sequence, const Split& split, const Config& config, const TrainSession& session);

/// Poses of a log into a checkpoint and back. @throws DataError where they are not those of this log
void write_start_poses(StateWriter& write, const RefinedPoses& poses);
RefinedPoses read_start_poses(const Checkpoint& checkpoint, const Sequence& sequence);

}  // namespace relidar
