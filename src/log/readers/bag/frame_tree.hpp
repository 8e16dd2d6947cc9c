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

/// The clock that is used for all times of a log.
enum class Clock {
    stamps,  ///< stamps in the headers of messages: times of measurement
    /// Times at which the messages were recorded. Used if the sensors and the poses have
    /// clocks that are not synchronised.
    recorder
};

/// A pose with its message stamp and its recording time.
struct PoseSample {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Pose pose;

    std::int64_t time_ns(Clock clock) const { return clock == Clock::stamps ? stamp_ns : log_ns; }
};

/// The pose of one frame in another frame over time. It is the product of all transforms
/// between the two frames.
class PosePath {
public:
    void add(Pose fixed) { links_.push_back({{0.0}, {fixed}}); }
    /// Adds a transform that changes over time. The samples can be in any order.
    /// @param zero_ns  time in nanoseconds that becomes 0 s
    void add(const std::vector<PoseSample>& samples, Clock clock, std::int64_t zero_ns);
    Pose at(double t_s) const;
    /// Returns true if every changing transform has samples around a time. A distance of
    /// a tenth of a second from the first or last sample is allowed.
    bool covers(double t_s) const;
    bool moves() const;

private:
    /// transforms from the outermost frame inwards; a transform with a single entry is
    /// constant
    std::vector<PoseTrack> links_;
};

/// The pose of frame `from` in frame `to` over time. It is computed with the nearest
/// common ancestor of both frames.
struct FramesApart {
    PosePath above_from_to, above_from_from;

    Pose at(double t_s) const { return inverse(above_from_to.at(t_s)) * above_from_from.at(t_s); }
    bool covers(double t_s) const { return above_from_to.covers(t_s) && above_from_from.covers(t_s); }
};

class FrameTree {
public:
    void add(const Transform& transform, std::int64_t log_ns, bool is_static);
    bool empty() const { return parents_.empty(); }
    /// Returns a frame followed by its ancestors, up to the root of the tree.
    std::vector<std::string> path_to_root(const std::string& frame) const;
    /// Returns true if the pose of a frame in its parent frame changes over time.
    bool moves(const std::string& frame) const;
    /// Returns the constant pose of frame `from` in frame `to`. Returns nothing if a
    /// transform between them changes over time or is unknown.
    std::optional<Pose> fixed(const std::string& to, const std::string& from) const;
    /// Returns the poses of a frame in one of its ancestors, `outer`.
    PosePath path(const std::string& outer, const std::string& frame, Clock clock,
                  std::int64_t zero_ns) const;
    /// Returns the poses of frame `from` in frame `to`. Returns nothing if no transforms
    /// connect the frames.
    std::optional<FramesApart> apart(const std::string& to, const std::string& from, Clock clock,
                                     std::int64_t zero_ns) const;
    /// Returns the frames for which the recording has transforms to more than one parent.
    /// The parent with the most transforms is used for such a frame.
    std::vector<std::string> disputed() const;

private:
    struct Link {
        std::vector<PoseSample> samples;
        bool is_static = false;  ///< from /tf_static
        /// True if the samples have different values. Drivers often repeat constant
        /// transforms on /tf, so several samples do not mean that the frame moves.
        bool changes = false;
    };
    std::map<std::string, std::map<std::string, Link>> parents_;  ///< by frame, then by parent

    const std::pair<const std::string, Link>* link(const std::string& frame) const;
};

}  // namespace relidar::bag
