// SPDX-License-Identifier: Apache-2.0
// Declares the first pass over a recording. It collects the content of each topic, the
// time and position of each cloud, and all poses.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <relidar/base/progress.hpp>
#include <relidar/log/log.hpp>

#include "read/bag/bag_file.hpp"
#include "read/bag/messages.hpp"
#include "read/packets/packet_log.hpp"

namespace relidar::bag {

enum class LogClock {
    stamps,  ///< time stamps in the message headers, which are the times of measurement
    /// Times at which the recorder received the messages. Used if the clocks of sensors
    /// and poses are not synchronised.
    recorder
};

/// Times of a message: its time stamp, and when it was recorded.
struct MessageTimes {
    std::int64_t stamp_ns = 0, log_ns = 0;

    std::int64_t time_ns(LogClock clock) const { return clock == LogClock::stamps ? stamp_ns : log_ns; }
};

struct StampedPose : MessageTimes {
    Pose pose;
};

/// A step between two samples of a pose that no vehicle can make.
struct PoseJump {
    double first_s, last_s;
    double distance_m;  ///< beyond the usual step
};

/// Pose of a frame in one of its ancestor frames as a function of time: the product of
/// all transforms in between.
class TransformChain {
public:
    void append_constant(Pose transform) { links_.push_back({{0.0}, {transform}}); }
    /// The recorded transforms are the inverse of the pose.
    void invert() { is_inverse_ = !is_inverse_; }
    /// Appends a transform that changes over time.
    /// @param pose_samples  in any order
    /// @param origin_ns  time in nanoseconds at which the time of the log is 0 s
    void append_samples(const std::vector<StampedPose>& pose_samples, LogClock clock, std::int64_t origin_ns);
    Pose compute_pose_at(double t_s) const;
    /// Returns true if every transform is known at `t_s`: a moving one from 0.1 s before
    /// its first sample to 0.1 s after its last.
    bool covers_time(double t_s) const;
    /// Returns the times between which a moving transform jumps: its position changes
    /// much more than before and after, as when a program for maps closes a loop.
    std::vector<PoseJump> find_jumps() const;

private:
    /// From the ancestor down to the child. A constant transform has a single sample.
    std::vector<PoseTrack> links_;
    bool is_inverse_ = false;
};

/// Pose of a source frame in a target frame as a function of time: the poses of both in
/// their nearest common ancestor.
struct FramePose {
    TransformChain ancestor_from_target, ancestor_from_source;

    Pose compute_pose_at(double t_s) const {
        return inverse(ancestor_from_target.compute_pose_at(t_s)) * ancestor_from_source.compute_pose_at(t_s);
    }
    bool covers_time(double t_s) const {
        return ancestor_from_target.covers_time(t_s) && ancestor_from_source.covers_time(t_s);
    }
};

/// Tree of coordinate frames, from the transforms of a recording.
class FrameTree {
public:
    /// Adds a sample of the transform between two frames.
    /// @param log_ns  time of recording
    /// @param is_static  true: the sample replaces earlier ones and holds for all times
    void add_transform(const TransformMessage& transform, std::int64_t log_ns, bool is_static);
    /// Returns a frame and all its ancestors, up to the root of the tree.
    std::vector<std::string> path_to_root(const std::string& start_frame) const;
    bool is_frame_moving(const std::string& frame) const;
    /// Returns the pose of frame `source` in frame `target`. Returns nothing
    /// if a transform between the frames is missing or changes over time.
    std::optional<Pose> find_constant(const std::string& target, const std::string& source) const;
    /// Returns the pose of a frame in one of its ancestor frames as a function of time.
    /// @param time_origin_ns  time on `clock` that is 0 s in the log
    TransformChain make_chain(const std::string& ancestor_frame, const std::string& child_frame,
                              LogClock clock, std::int64_t time_origin_ns) const;
    /// Returns the pose of a frame in any other frame as a function of time. Returns
    /// nothing if no transforms connect the two frames.
    std::optional<FramePose> find_chain(const std::string& target_frame, const std::string& source_frame,
                                        LogClock clock, std::int64_t time_origin_ns) const;
    /// Returns the samples of the moving transform with the most samples between a frame
    /// and its ancestor frame. Returns null if no transform moves.
    const std::vector<StampedPose>* densest_samples(const std::string& ancestor_frame,
                                                    const std::string& child_frame) const;
    /// Returns the frames that move relative to their parents.
    std::vector<std::string> moving_frames() const;
    /// Returns the frames that have several parents in the bag. This class uses the
    /// parent with the most transforms.
    std::vector<std::string> ambiguous_frames() const;

private:
    struct FrameTreeEdge {
        std::vector<StampedPose> samples;
        bool is_static = false;  ///< from /tf_static
        /// True if the samples differ. If all samples are equal, the transform is
        /// constant, even if it was published on the topic /tf for moving frames.
        bool changes = false;
    };
    std::map<std::string, std::map<std::string, FrameTreeEdge>> parents_;  ///< by frame, then by parent

    const std::pair<const std::string, FrameTreeEdge>* find_parent(const std::string& frame) const;
};

/// Interval of azimuths that contains a set of points.
struct AzimuthArc {
    float middle_rad = 0.0f, extent_rad = 0.0f;
};
/// Computes the azimuth range of a cloud, in steps of 6 degrees, from about 256 of its
/// points. Returns nothing if the cloud has no field x or y.
std::optional<AzimuthArc> azimuth_arc(const read::PointTable& cloud);

/// Counts of the messages of a topic.
struct TopicStatistics {
    std::size_t n = 0;                       ///< number of messages
    std::int64_t first_ns = 0, last_ns = 0;  ///< recording times of the first and the last message
    std::size_t n_broken = 0;                ///< messages that could not be read
    std::string broken;                      ///< error of the first of them
    std::size_t n_left_out = 0;              ///< transforms with an invalid pose
    std::string left_out;                    ///< text about the first of them

    double rate_hz() const {
        return n > 1 && last_ns > first_ns ? 1e9 * double(n - 1) / double(last_ns - first_ns) : 0.0;
    }
};

/// A cloud of a recording, without its points.
struct CloudEntry : MessageTimes {
    std::uint32_t n_points = 0;
    MessagePosition message_position;
    std::optional<AzimuthArc> arc = {};  ///< azimuths of the points; empty if unknown
    std::size_t revolution_index = 0;    ///< index in packets.revolutions(), for a topic of packets
    /// Clouds from which this cloud was composed. Empty for a recorded full revolution.
    std::vector<CloudEntry> parts = {};
    /// Time stamp in the message minus `stamp_ns`, if the LiDAR's clock was set.
    std::int64_t correction_ns = 0;
};

/// Full revolutions, composed of clouds.
struct JoinedRevolutions {
    /// Clouds of each full revolution, sorted by time. Empty if none need to be joined.
    std::vector<std::vector<CloudEntry>> revolutions;
    std::size_t n_left_out = 0;  ///< clouds of incomplete revolutions
    std::string note;            ///< text about the clouds for the user
};
/// Joins clouds that are parts of a revolution. Joins nothing if the clouds are full
/// revolutions, or if the LiDAR scans a window and does not rotate.
/// @param clouds  all clouds of a topic. Ignores clouds with unknown azimuths
JoinedRevolutions join_clouds(std::vector<CloudEntry> clouds);

struct CloudTopic {
    std::size_t topic = 0;
    /// CloudMessage::lidar; empty if the topic has one LiDAR
    std::string lidar;
    std::string frame;              ///< frame of the first cloud
    std::size_t n_other_frame = 0;  ///< clouds that have another frame than the first cloud
    std::string other_frame;        ///< frame of the first of these clouds
    /// For Ouster packets: frames of the clouds that Ouster's driver computes from them
    std::vector<std::string> driver_frames;
    std::vector<CloudMessage::CloudField> fields;  ///< fields of the first cloud
    /// Clouds with points, in recorded order. Parts of a revolution are joined.
    std::vector<CloudEntry> clouds;
    std::string parts_note;  ///< text about the joined clouds; empty if no clouds are joined
    std::size_t n_empty = 0;
    /// Packets, if the topic has these. Each revolution becomes one scan.
    packets::PacketIndex packets;

    bool has_field(read::PointAttribute attribute) const;
    std::size_t median_points() const;
    /// Returns the name of the LiDAR: the topic, and `lidar` if it is not empty.
    std::string make_name(const BagRecording& bag) const;
};

struct PoseTopic {
    std::size_t topic = 0;
    std::string parent, child;  ///< names of the parent and the child frame; the child may be empty
    std::vector<StampedPose> samples;
};

/// A message that contains at least one box.
struct BoxIndexEntry : MessageTimes {
    MessagePosition message_position;
};

struct BoxTopic {
    std::size_t topic = 0;
    std::string frame;  ///< frame of the first box
    std::vector<BoxIndexEntry> lists;
    std::size_t n_boxes = 0, n_named = 0;  ///< number of boxes, and number of boxes that have a track id
    /// number of boxes that are ignored because their size or their pose is invalid
    std::size_t n_left_out = 0;
};

/// Positions on the earth of an antenna.
struct FixTopic {
    struct Sample : MessageTimes {
        GeodeticPosition position;
    };
    std::size_t topic = 0;
    std::string frame;  ///< frame of the antenna
    std::vector<Sample> samples;
};

/// Content of a recording, without points and boxes.
struct BagIndex {
    std::vector<TopicStatistics>
        facts;  ///< message statistics of each topic, in the order of BagRecording::topics()
    std::vector<CloudTopic> clouds;
    std::vector<PoseTopic> poses;
    std::vector<BoxTopic> boxes;
    std::vector<FixTopic> fixes;
    FrameTree frames;
};

/// Reads all messages of a recording and lists its content. Counts invalid messages
/// instead of throwing. Reads Ouster packets again if their metadata follow later.
/// @throws DataError if a file is damaged
BagIndex index_bag(BagRecording& bag, const Progress& progress);

/// Returns one line per topic: name, type, number of messages, rate, and its content.
/// @param is_topic_used  [topics] true if the topic is loaded
std::vector<std::string> describe_topics(const BagRecording& bag, const BagIndex& index,
                                         const std::vector<bool>& is_topic_used);

// The following texts are empty if there is nothing to report.

/// Describes missing sweeps, which cause time steps that are much longer than usual.
std::string describe_gaps(const std::vector<double>& sweep_times_s, double sweep_period_s);
std::string describe_frame_ids(const CloudTopic& cloud_topic);
/// Describes time stamps that decrease, or that jump relative to the recording times.
std::string describe_jumps(const CloudTopic& cloud_topic);

}  // namespace relidar::bag
