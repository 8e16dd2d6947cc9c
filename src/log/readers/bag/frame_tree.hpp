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
enum class LogClock {
    stamps,  ///< time stamps in the message headers, which are the times of measurement
    /// Times at which the recorder received the messages. Used if the clocks of sensors
    /// and poses are not synchronised.
    recorder
};

/// A pose with the time stamp in its message and the time of recording.
struct StampedPose {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Pose pose;

    std::int64_t get_time_ns(LogClock clock) const { return clock == LogClock::stamps ? stamp_ns : log_ns; }
};

/// Pose of a frame in one of its ancestor frames as a function of time. It is the product
/// of all transforms in between.
class TransformChain {
public:
    void append_constant_child_transform(Pose transform) { links_.push_back({{0.0}, {transform}}); }
    /// Appends a transform that changes over time. The samples can be in any order.
    /// @param time_origin_ns  time in nanoseconds at which the time of the log is 0 s
    void append_sampled_child_transform(const std::vector<StampedPose>& pose_samples, LogClock clock,
                                        std::int64_t time_origin_ns);
    Pose compute_pose_at(double t_s) const;
    /// Returns true if every transform in this chain is known at `t_s`. A moving
    /// transform is known from 0.1 s before its first sample to 0.1 s after its last
    /// sample.
    bool covers_time(double t_s) const;
    bool is_moving() const;

private:
    /// Transforms of this chain, from the ancestor frame down to the child frame. A
    /// constant transform has a single sample.
    std::vector<PoseTrack> links_;
};

/// Pose of coordinate frame "from" in coordinate frame "to" as a function of time. Stores
/// the poses of both in "above", their nearest common ancestor in the frame tree.
struct RelativeFramePose {
    TransformChain above_from_to, above_from_from;

    Pose compute_pose_at(double t_s) const {
        return inverse(above_from_to.compute_pose_at(t_s)) * above_from_from.compute_pose_at(t_s);
    }
    bool covers_time(double t_s) const {
        return above_from_to.covers_time(t_s) && above_from_from.covers_time(t_s);
    }
};

class FrameTree {
public:
    void add_transform(const TransformMessage& transform, std::int64_t recording_time_ns, bool is_static);
    bool empty() const { return parents_.empty(); }
    /// Returns the names of a frame and of all its ancestors, up to the root of the tree.
    std::vector<std::string> list_frames_to_root(const std::string& start_frame) const;
    /// Returns true if the pose of a frame in its parent frame changes over time.
    bool is_frame_moving(const std::string& frame) const;
    /// Returns the pose of frame `source_frame` in frame `target_frame`. Returns nothing
    /// if a transform between the frames is missing or changes over time.
    std::optional<Pose> find_constant_transform(const std::string& target_frame,
                                                const std::string& source_frame) const;
    /// Returns the pose of a frame in its ancestor frame `ancestor_frame` as a function
    /// of time.
    TransformChain make_transform_chain_to_ancestor(const std::string& ancestor_frame,
                                                    const std::string& child_frame, LogClock clock,
                                                    std::int64_t time_origin_ns) const;
    /// Returns the pose of frame `source_frame` in frame `target_frame` as a function of
    /// time. Returns nothing if no transforms connect the two frames.
    std::optional<RelativeFramePose> find_pose_function_between_frames(const std::string& target_frame,
                                                                       const std::string& source_frame,
                                                                       LogClock clock,
                                                                       std::int64_t time_origin_ns) const;
    /// Returns the samples of the moving transform with the most samples between a frame
    /// and its ancestor frame. Returns null if no transform moves.
    const std::vector<StampedPose>* find_fastest_samples(const std::string& ancestor_frame,
                                                         const std::string& child_frame) const;
    /// Returns the coordinate frames that have several parent frames in the bag. This
    /// class uses the parent with the most transforms.
    std::vector<std::string> list_frames_with_several_parents() const;

private:
    struct FrameTreeEdge {
        std::vector<StampedPose> samples;
        bool is_static = false;  ///< from /tf_static
        /// True if the samples differ. If all samples are equal, the transform is
        /// constant, even if it was published on the topic /tf for moving frames.
        bool changes = false;
    };
    std::map<std::string, std::map<std::string, FrameTreeEdge>> parents_;  ///< by frame, then by parent

    const std::pair<const std::string, FrameTreeEdge>* find_parent_with_most_transforms(
        const std::string& frame) const;
};

}  // namespace relidar::bag
