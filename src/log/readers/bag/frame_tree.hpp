// SPDX-License-Identifier: Apache-2.0
// Stores the coordinate frames of a recording as a tree. The transforms are read from /tf
// and /tf_static.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

#include "log/readers/bag/messages.hpp"

namespace relidar::bag {

/// The clock that defines all times of a log.
enum class Clock {
    stamps,  ///< time stamps in the message headers, which are the times of measurement
    /// Times at which the recorder received the messages. Used if sensors and poses have
    /// clocks that are not synchronised.
    recorder
};

/// A pose with the time stamp in its message and the time of recording.
struct PoseSample {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Pose pose;

    std::int64_t time_ns(Clock clock) const { return clock == Clock::stamps ? stamp_ns : log_ns; }
};

/// Pose of a frame in one of its ancestor frames as a function of time: the product of
/// all transforms in between.
class PosePath {
public:
    void add(Pose fixed) { links_.push_back({{0.0}, {fixed}}); }
    /// Adds a transform that changes over time, given by samples in any order.
    /// @param zero_ns  time in nanoseconds that becomes 0 s
    void add(const std::vector<PoseSample>& samples, Clock clock, std::int64_t zero_ns);
    Pose at(double t_s) const;
    /// Returns true if all changing transforms have samples at a time. Times up to 0.1 s
    /// before the first or after the last sample are included.
    bool covers(double t_s) const;
    bool is_moving() const;

private:
    /// Transforms along the path in the tree, from the ancestor frame down. A constant
    /// transform has a single sample.
    std::vector<PoseTrack> links_;
};

/// Pose of frame `from` in frame `to` as a function of time. Stores the poses of both
/// frames in their nearest common ancestor.
struct FramesApart {
    PosePath above_from_to, above_from_from;

    Pose at(double t_s) const { return inverse(above_from_to.at(t_s)) * above_from_from.at(t_s); }
    bool covers(double t_s) const { return above_from_to.covers(t_s) && above_from_from.covers(t_s); }
};

class FrameTree {
public:
    void add(const Transform& transform, std::int64_t log_ns, bool is_static);
    bool empty() const { return parents_.empty(); }
    /// Returns the names of a frame and of all its ancestors, up to the root of the tree.
    std::vector<std::string> find_path_to_root(const std::string& frame) const;
    /// Returns true if the pose of a frame in its parent frame changes over time.
    bool is_moving(const std::string& frame) const;
    /// Returns the pose of frame `source_frame` in frame `target_frame`, if it is
    /// constant. Returns nothing if a transform between the frames is missing or changes
    /// over time.
    std::optional<Pose> find_constant_pose(const std::string& target_frame,
                                           const std::string& source_frame) const;
    /// Returns the pose of a frame in its ancestor frame `outer` as a function of time.
    PosePath path(const std::string& outer, const std::string& frame, Clock clock,
                  std::int64_t zero_ns) const;
    /// Returns the pose of frame `source_frame` in frame `target_frame` as a function of
    /// time. Returns nothing if no transforms connect the two frames.
    std::optional<FramesApart> find_relative_poses(const std::string& target_frame,
                                                   const std::string& source_frame, Clock clock,
                                                   std::int64_t zero_ns) const;
    /// Returns the frames for which the bag has several parent frames. The tree uses the
    /// parent with the most transforms.
    std::vector<std::string> list_disputed_frames() const;

private:
    struct Link {
        std::vector<PoseSample> samples;
        bool is_static = false;  ///< from /tf_static
        /// True if the samples differ. Drivers often repeat a constant transform on /tf,
        /// so several equal samples do not mean that the frame moves.
        bool changes = false;
    };
    std::map<std::string, std::map<std::string, Link>> parents_;  ///< by frame, then by parent

    const std::pair<const std::string, Link>* find_parent_link(const std::string& frame) const;
};

}  // namespace relidar::bag
