// SPDX-License-Identifier: Apache-2.0
// Tree of the frames of a recording, from /tf and /tf_static.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

#include "log/readers/bag/messages.hpp"

namespace relidar::bag {

/// Clock that defines the times of a log.
enum class Clock {
    stamps,  ///< stamps in the headers of messages: times of measurement
    /// Recording times. Used if the stamps of sensors and poses come from clocks that are
    /// not synchronised.
    recorder
};

/// A pose with its time on both clocks.
struct PoseSample {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Pose pose;

    std::int64_t time_ns(Clock clock) const { return clock == Clock::stamps ? stamp_ns : log_ns; }
};

/// Poses of one frame in another, composed of the transforms between them.
class PosePath {
public:
    void add(Pose fixed) { links_.push_back({{0.0}, {fixed}}); }
    /// Adds samples in any order.
    /// @param zero_ns  time that is 0 s
    void add(const std::vector<PoseSample>& samples, Clock clock, std::int64_t zero_ns);
    Pose at(double t_s) const;
    /// Returns true if all moving transforms are known at a time, or within a tenth of a
    /// second of it.
    bool covers(double t_s) const;
    bool moves() const;

private:
    /// from the outermost frame inwards; a single entry is a fixed transform
    std::vector<PoseTrack> links_;
};

/// Poses of one frame in another, through their nearest common ancestor.
struct FramesApart {
    PosePath above_from_to, above_from_from;

    Pose at(double t_s) const { return inverse(above_from_to.at(t_s)) * above_from_from.at(t_s); }
    bool covers(double t_s) const { return above_from_to.covers(t_s) && above_from_from.covers(t_s); }
};

class FrameTree {
public:
    void add(const Transform& transform, std::int64_t log_ns, bool is_static);
    bool empty() const { return parents_.empty(); }
    /// Returns a frame, its parent, and so on up to the root.
    std::vector<std::string> way_up(const std::string& frame) const;
    /// Returns true if a frame moves relative to its parent.
    bool moves(const std::string& frame) const;
    /// Returns the fixed pose to_from_from, or nothing if a transform between the frames
    /// moves or is unknown.
    std::optional<Pose> fixed(const std::string& to, const std::string& from) const;
    /// Returns the path outer_from_frame, where `outer` is an ancestor of the frame.
    PosePath path(const std::string& outer, const std::string& frame, Clock clock,
                  std::int64_t zero_ns) const;
    /// Returns the poses to_from_from, or nothing if the frames are not connected.
    std::optional<FramesApart> apart(const std::string& to, const std::string& from, Clock clock,
                                     std::int64_t zero_ns) const;
    /// Returns the frames that have more than one parent. The parent with the most
    /// transforms is used.
    std::vector<std::string> disputed() const;

private:
    struct Link {
        std::vector<PoseSample> samples;
        bool is_static = false;  ///< from /tf_static
        /// true if the samples differ; static transforms are often repeated on /tf
        bool changes = false;
    };
    std::map<std::string, std::map<std::string, Link>> parents_;  ///< by frame, then by parent

    const std::pair<const std::string, Link>* link(const std::string& frame) const;
};

}  // namespace relidar::bag
