// SPDX-License-Identifier: Apache-2.0
// Where the frames of a recording are: what /tf and /tf_static say of them.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <relidar/log/sequence.hpp>

#include "log/readers/bag/messages.hpp"

namespace relidar::bag {

/// Which times a log is read by.
enum class Clock {
    stamps,  ///< of the messages' headers: when things were measured
    /// when messages were recorded: where stamps of sensors and poses are of clocks that
    /// do not go together
    recorder
};

/// A pose at a time by both clocks.
struct PoseSample {
    std::int64_t stamp_ns = 0, log_ns = 0;
    Pose pose;

    std::int64_t time_ns(Clock clock) const { return clock == Clock::stamps ? stamp_ns : log_ns; }
};

/// Poses of one frame in another, through the frames between them.
class PosePath {
public:
    void add(Pose fixed) { links_.push_back({{0.0}, {fixed}}); }
    /// Samples in any order. @param zero_ns  what counts as 0 s
    void add(const std::vector<PoseSample>& samples, Clock clock, std::int64_t zero_ns);
    Pose at(double t_s) const;
    /// Whether all that moves is known at a time, or a tenth of a second beside it.
    bool covers(double t_s) const;
    bool moves() const;

private:
    std::vector<PoseTrack> links_;  ///< from the outermost frame inwards; one entry: fixed
};

/// Poses of one frame in another through the nearest frame above both.
struct FramesApart {
    PosePath above_from_to, above_from_from;

    Pose at(double t_s) const { return inverse(above_from_to.at(t_s)) * above_from_from.at(t_s); }
    bool covers(double t_s) const { return above_from_to.covers(t_s) && above_from_from.covers(t_s); }
};

class FrameTree {
public:
    void add(const Transform& transform, std::int64_t log_ns, bool is_static);
    bool empty() const { return parents_.empty(); }
    /// A frame, its parent, and so on to the outermost.
    std::vector<std::string> way_up(const std::string& frame) const;
    /// Whether a frame moves in its parent.
    bool moves(const std::string& frame) const;
    /// Fixed pose to_from_from, nothing where something between the two frames moves or
    /// is not known.
    std::optional<Pose> fixed(const std::string& to, const std::string& from) const;
    /// Path outer_from_frame, where `outer` is on the way up.
    PosePath path(const std::string& outer, const std::string& frame, Clock clock,
                  std::int64_t zero_ns) const;
    /// Poses to_from_from, nothing where no transforms lead from one to the other.
    std::optional<FramesApart> apart(const std::string& to, const std::string& from, Clock clock,
                                     std::int64_t zero_ns) const;
    /// Frames that were seen in more than one parent: the one with the most transforms is
    /// taken.
    std::vector<std::string> disputed() const;

private:
    struct Link {
        std::vector<PoseSample> samples;
        bool is_static = false;  ///< of /tf_static
        bool changes = false;    ///< static transforms are often repeated on /tf
    };
    std::map<std::string, std::map<std::string, Link>> parents_;  ///< by frame, by parent

    const std::pair<const std::string, Link>* link(const std::string& frame) const;
};

}  // namespace relidar::bag
