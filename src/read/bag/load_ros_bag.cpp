// SPDX-License-Identifier: Apache-2.0
// Loads a recording in two passes. The first pass finds the topics, clouds and poses,
// with limited memory. The second pass reads only the clouds of the requested frames.
// These clouds become scans in the same way as the scan files of a plain folder.
#include "read/readers.hpp"

#include <algorithm>
#include <optional>

#include <relidar/log/log_time.hpp>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "log/frames/match_sweeps.hpp"
#include "read/bag/bag_scans.hpp"
#include "read/bag/choose.hpp"
#include "read/scans/cloud_units.hpp"
#include "read/scans/pose_conventions.hpp"
#include "read/scans/pose_files.hpp"
#include "read/scans/sweep_poses.hpp"

namespace relidar {
namespace {

using namespace bag;

constexpr std::int64_t kNsPerSecond = 1000000000;
constexpr double kMinStep_s = 2e-3;  // minimum time between sweeps
// Clouds of several LiDARs form one sweep if their times differ by at most this value.
// The unit is the sweep period of the main LiDAR.
constexpr double kMaxSweepOffset = 0.6;

constexpr const char* kOtherPoses = "select smooth poses with dataset.poses_from, for example the frame odom";

/// Indexes a recording. Reads the quaternions of pose topics as the user has set.
BagIndex index_with_conventions(BagRecording& bag, const DatasetOptions& options) {
    BagIndex index = index_bag(bag, options.progress);
    if (options.conventions.quaternions != Conventions::Quaternions::wxyz) return index;
    for (PoseTopic& topic : index.poses)
        for (StampedPose& sample : topic.samples) {
            const glm::dquat read = sample.pose.rotation;  // as x y z w
            sample.pose.rotation = glm::dquat(read.x, read.y, read.z, read.w);
        }
    return index;
}

/// Selects topics of a recording and loads them as a log.
class BagLogLoader {
public:
    BagLogLoader(const std::filesystem::path& path, const DatasetOptions& options)
        : options_(options),
          bag_(path, options.skip_broken),
          survey_(index_with_conventions(bag_, options)),
          clouds_(choose_clouds(bag_, survey_, options.lidars)),
          poses_(choose_poses(bag_, survey_, survey_.clouds[clouds_.lidars[clouds_.main]], options)),
          boxes_(choose_boxes(bag_, survey_)) {
        // A path that ends with a slash has no file name.
        const std::filesystem::path clean = path.lexically_normal();
        log_.name = (clean.has_filename() ? clean : clean.parent_path()).filename().string();
        log_.source = path.string();
    }

    /// Groups the clouds to frames, adds LiDARs and poses, then reads the scans of the
    /// frames. Corrects rays with the poses between frames last.
    Log load_recording() {
        has_poses_ = options_.poses_file.empty() && poses_.path;
        using Deskew = Conventions::Deskew;
        const Conventions& set = options_.conventions;
        is_deskewed_ = bag_.points_frame() == "sensor at the stamp" && set.deskew != Deskew::raw;
        add_topic_notes();
        group_clouds();
        add_lidars();
        add_frames();
        read::ScanLayout layout{.motion_compensated = is_deskewed_};
        layout.declared_by = "relidar, which wrote the file";
        layout.is_deskew_declared = is_deskewed_;
        bool have_one_time = false;  // all points of a cloud
        for (std::size_t l = 0; l < log_.lidars.size(); ++l) {
            layout.lidars.push_back({.has_beams = !log_.lidars[l].sensor.beams.empty()});
            if (!lidars_[l].units.is_deskewed) continue;
            have_one_time = true;
            layout.motion_compensated = true;
            layout.declared_by = "guess: all points of a scan have the same time";
            layout.is_deskew_declared = true;
        }
        // The formats of packets define these conventions.
        const auto has_clouds = [&](std::size_t topic) { return survey_.clouds[topic].packets.empty(); };
        if (std::ranges::any_of(clouds_.lidars, has_clouds)) read::apply_conventions(log_, layout, set);
        // BagScans undoes it.
        if (is_deskewed_ && has_poses_ && !have_one_time) layout.motion_compensated = false;
        DatasetOptions options = options_;
        if (!log_.has_poses) options.poses_file = kNoPoses;
        LidarPoseFunction deskewed_by;  // empty: the points are not compensated, or it cannot be undone
        if (is_deskewed_ && has_poses_)
            deskewed_by = [&](std::size_t lidar, double t_s) {
                const Pose pose = vehicle_pose(t_s);
                return clouds_.lidars.size() > 1 ? pose * log_.lidars[lidar].vehicle_from_sensor : pose;
            };
        read::read_scans(log_, layout, BagScans(bag_, lidars_, frames_, poses_.clock, deskewed_by), options);
        if (!has_poses_) return std::move(log_);
        leave_out_torn();
        const auto vehicle_pose_in_log_world = [&](double t_s) -> std::optional<Pose> {
            if (!poses_.path->covers_time(t_s)) return std::nullopt;
            Pose pose = vehicle_pose(t_s);
            pose.translation -= log_.world_offset_m;
            return pose;
        };
        add_note(read::correct_rays(log_, vehicle_pose_in_log_world));
        return std::move(log_);
    }

private:
    const DatasetOptions& options_;
    BagRecording bag_;
    BagIndex survey_;
    ChosenClouds clouds_;
    ChosenPoses poses_;
    SelectedBoxTopic boxes_;
    Log log_;
    std::vector<LidarTopic> lidars_;  ///< topic of each LiDAR
    std::vector<FrameCloud> frames_;  ///< cloud of each frame
    bool has_poses_ = false;          ///< the recording has poses
    /// True if relidar wrote the bag with motion-compensated points. All points of a
    /// cloud are then in the sensor frame at the time stamp of the cloud.
    bool is_deskewed_ = false;

    const CloudTopic& cloud_topic_of(std::size_t lidar_index) const {
        return survey_.clouds[clouds_.lidars[lidar_index]];
    }
    const CloudTopic& main_topic() const { return cloud_topic_of(clouds_.main); }
    template <class AnyTopic>
    const std::string& topic_name_of(const AnyTopic& topic_entry) const {
        return bag_.topics()[topic_entry.topic].name;
    }
    std::string topic_name_of(const CloudTopic& cloud_topic) const { return cloud_topic.make_name(bag_); }
    double cloud_time_of(const CloudEntry& entry) const {
        return 1e-9 * double(entry.time_ns(poses_.clock) - poses_.zero_ns);
    }

    void add_note(const std::string& text) {
        if (!text.empty()) log_.notes.push_back(text);
    }
    template <class AnyTopic>
    void add_topic_note(const AnyTopic& topic_entry, const std::string& text) {
        if (!text.empty()) log_.notes.push_back(topic_name_of(topic_entry) + ": " + text);
    }

    /// Returns for each topic of the recording whether it is loaded.
    std::vector<bool> list_used_topics() const {
        std::vector<bool> used(bag_.topics().size(), false);
        for (const std::size_t c : clouds_.lidars) used[survey_.clouds[c].topic] = true;
        for (std::size_t t = 0; t < used.size() && has_poses_; ++t) {
            const BagTopic& topic = bag_.topics()[t];
            // The description ends with the name of the topic if there is one.
            if (find_purpose(topic) == MessagePurpose::transforms ||
                poses_.description.ends_with(" " + topic.name))
                used[t] = true;
        }
        if (boxes_.topic) used[boxes_.topic->topic] = true;
        if (const FixTopic* fixes = find_fixes()) used[fixes->topic] = true;
        return used;
    }

    /// Adds notes about the topics and their selection. Corrects jumps of the clocks.
    void add_topic_notes() {
        for (const auto& texts : {bag_.file_problems(), describe_topics(bag_, survey_, list_used_topics()),
                                  clouds_.notes, poses_.notes, boxes_.notes})
            for (const std::string& text : texts) add_note(text);
        if (has_poses_) {
            add_note(poses_.clock_note);
            for (UsedConvention& used : poses_.conventions) read::list_convention(log_, std::move(used));
            // Poses that contain a mounting cannot be inverted later.
            const std::optional<Pose> mounting =
                survey_.frames.find_constant(poses_.vehicle, main_topic().frame);
            if (options_.conventions.poses == Conventions::Poses::automatic && clouds_.lidars.size() == 1 &&
                mounting &&
                (mounting->translation != glm::dvec3(0.0) || std::abs(mounting->rotation.w) != 1.0))
                read::list_convention(
                    log_, {"poses", "world from sensor", read::kFromMessages, "conventions.poses"});
        }
        for (const std::string& frame : survey_.frames.ambiguous_frames())
            add_note(fmt::format(
                "the frame '{}' has several parents in /tf; the parent with the most transforms is used",
                frame));
        for (std::size_t l = 0; l < clouds_.lidars.size(); ++l) {
            CloudTopic& topic = survey_.clouds[clouds_.lidars[l]];
            // choose_poses() has corrected the times of the main LiDAR.
            if (l != clouds_.main)
                add_topic_note(topic,
                               fix_clock_jumps(topic.clouds, poses_.clock, list_times(main_topic().clouds)));
            add_topic_note(topic, describe_frame_ids(topic));
            add_topic_note(topic, describe_jumps(topic));
        }
    }

    /// Each cloud of the main LiDAR starts a frame. Clouds of other LiDARs belong to the
    /// frame with the nearest time.
    void group_clouds() {
        std::vector<FrameCloud> sweeps;
        std::size_t n_late = 0;
        for (const CloudEntry& entry : main_topic().clouds) {
            const double t_s = cloud_time_of(entry);
            if (!sweeps.empty() && t_s < sweeps.back().time_s + kMinStep_s) {
                ++n_late;
                continue;
            }
            sweeps.push_back({.number = int(sweeps.size()),
                              .time_s = t_s,
                              .cloud_s = t_s,
                              .lidar = clouds_.main,
                              .entry = entry});
        }
        if (n_late > 0)
            add_note(fmt::format("{} clouds are skipped, because they are not later than the previous cloud",
                                 n_late));
        std::vector<double> times_s;
        for (const FrameCloud& sweep : sweeps) times_s.push_back(sweep.time_s);
        const double step_s = median_interval_s(times_s);
        add_note(describe_gaps(times_s, step_s));
        std::vector<FrameCloud> all = sweeps;
        for (std::size_t l = 0; l < clouds_.lidars.size(); ++l)
            if (l != clouds_.main) append_nearest(all, sweeps, l, kMaxSweepOffset * step_s);
        std::ranges::stable_sort(
            all, {}, [](const FrameCloud& cloud) { return std::pair(cloud.number, cloud.lidar); });
        select_clouds(all);
        add_units(step_s);
    }

    /// Adds to each sweep of the main LiDAR the nearest cloud of another LiDAR. Corrects
    /// a clock offset between the two LiDARs if it is certain.
    void append_nearest(std::vector<FrameCloud>& all_clouds, const std::vector<FrameCloud>& main_sweeps,
                        std::size_t lidar_index, double max_time_difference_s) {
        const std::vector<CloudEntry>& clouds = cloud_topic_of(lidar_index).clouds;
        ClockOffset offset;
        if (poses_.clock == LogClock::stamps)
            offset = estimate_offset(list_times(clouds), list_times(main_topic().clouds));
        if (offset.offset_ns != 0)
            add_topic_note(
                cloud_topic_of(lidar_index),
                fmt::format("compared with the recording times, the time stamps are {}{}",
                            offset.describe("the time stamps of " + topic_name_of(main_topic())),
                            offset.is_clear
                                ? ", so their clocks differ; this time is subtracted"
                                : "; either the clocks differ or messages are late; nothing is corrected"));
        std::vector<double> main_s, other_s;
        for (const FrameCloud& sweep : main_sweeps) main_s.push_back(sweep.time_s);
        for (const CloudEntry& entry : clouds)
            other_s.push_back(cloud_time_of(entry) - 1e-9 * double(offset.correction_ns()));
        const auto nearest = match_sweeps(main_s, other_s, max_time_difference_s);  // [main sweeps]
        std::size_t n_skipped = clouds.size();
        for (std::size_t k = 0; k < main_sweeps.size(); ++k) {
            if (!nearest[k]) continue;
            all_clouds.push_back({.number = main_sweeps[k].number,
                                  .time_s = main_s[k],
                                  .cloud_s = other_s[*nearest[k]],
                                  .lidar = lidar_index,
                                  .entry = clouds[*nearest[k]]});
            --n_skipped;
        }
        if (n_skipped > 0)
            add_topic_note(cloud_topic_of(lidar_index),
                           fmt::format("{} clouds are skipped, because {} has no cloud near their times",
                                       n_skipped, topic_name_of(main_topic())));
    }

    /// Keeps the clouds of the requested frames that have a pose at their time.
    void select_clouds(const std::vector<FrameCloud>& all_clouds) {
        std::size_t n_unplaced = 0;
        for (const FrameCloud& cloud : all_clouds) {
            if (cloud.number < options_.frames.begin ||
                (options_.frames.end >= 0 && cloud.number >= options_.frames.end))
                continue;
            if (has_poses_ && !poses_.path->covers_time(cloud.time_s)) ++n_unplaced;
            else frames_.push_back(cloud);
        }
        if (frames_.empty() && n_unplaced > 0)
            fail(
                "{}: {}; none of the {} clouds has a pose at its time; select other poses with "
                "dataset.poses_from or dataset.poses=FILE, or estimate them with dataset.poses=none",
                log_.source, poses_.description, n_unplaced);
        if (frames_.empty())
            fail<UsageError>("frames {}:{} select no cloud of {}; frames are numbered from 0",
                             options_.frames.begin,
                             options_.frames.end < 0 ? "" : std::to_string(options_.frames.end),
                             topic_name_of(main_topic()));
        if (n_unplaced > 0)
            add_note(
                fmt::format("{} clouds are skipped, because there are no poses at their times", n_unplaced));
    }

    /// Removes the sweeps during which the poses jump, because their rays do not fit
    /// together. Loops are closed rarely. If many sweeps have a jump, poses have other
    /// steps, such as repeated values, and all sweeps are kept.
    void leave_out_torn() {
        const std::vector<PoseJump> jumps = poses_.path->find_jumps();
        if (jumps.empty()) return;
        // Times of the first and the last ray of each LiDAR's sweeps. `info` reads only
        // some scans.
        std::vector<std::pair<float, float>> span_s(log_.lidars.size());
        for (const Frame& frame : log_.frames)
            if (const auto& offsets_s = frame.scan.rays.time_offset_s; !offsets_s.empty()) {
                const auto [first, last] = std::ranges::minmax(offsets_s);
                span_s[std::size_t(frame.lidar)] = {first, last};
            }
        const auto is_torn = [&](const Frame& frame) {
            const auto [first, last] = span_s[std::size_t(frame.lidar)];
            return std::ranges::any_of(jumps, [&](const PoseJump& jump) {
                return jump.last_s >= frame.time_s + first && jump.first_s <= frame.time_s + last;
            });
        };
        const auto n_removed = std::size_t(std::ranges::count_if(log_.frames, is_torn));
        if (n_removed > std::max<std::size_t>(1, log_.frames.size() / 10) || n_removed == log_.frames.size())
            return;
        std::erase_if(log_.frames, is_torn);
        PoseTrack track;  // has poses only at the times of frames
        for (std::size_t k = 0; k < log_.world_from_vehicle.pose.size(); ++k) {
            const double time_s = log_.world_from_vehicle.time_s[k];
            if (std::ranges::find(log_.frames, time_s, &Frame::time_s) != log_.frames.end())
                track.append(time_s, log_.world_from_vehicle.pose[k]);
        }
        log_.world_from_vehicle = std::move(track);
        const PoseJump& largest = *std::ranges::max_element(jumps, {}, &PoseJump::distance_m);
        add_note(fmt::format(
            "the poses jump {} by {:.2f} m at {:.2f} s, as after a loop closure; {} sweeps during a jump are "
            "left out; surfaces do not fit together before and after it; {}",
            jumps.size() == 1 ? "once," : fmt::format("{} times, most", jumps.size()), largest.distance_m,
            largest.last_s, n_removed, kOtherPoses));
    }

    /// Estimates the units of the points of each LiDAR. Clouds that are parts of a
    /// revolution last only a part of the sweep period.
    void add_units(double sweep_period_s) {
        for (std::size_t l = 0; l < clouds_.lidars.size(); ++l) {
            const CloudTopic& clouds = cloud_topic_of(l);
            const std::size_t n_parts =
                clouds.clouds.empty() ? 1 : std::max<std::size_t>(clouds.clouds[0].parts.size(), 1);
            lidars_.push_back(
                estimate_units(bag_, clouds, sweep_period_s / double(n_parts), options_.conventions));
            if (!clouds.packets.empty()) lidars_.back().sensor = clouds.packets.make_sensor();
            add_topic_note(clouds, clouds.parts_note);
            const read::PointCloudUnits& units = lidars_.back().units;
            add_topic_note(clouds, units.time_note);
            for (const std::string& text : units.fields.notes) add_topic_note(clouds, text);
            if (clouds.packets.empty()) {
                const std::string lidar = clouds_.lidars.size() == 1 ? "" : " of " + topic_name_of(clouds);
                read::list_times(log_, units, options_.conventions, lidar);
                read::list_scale(log_, units.fields.scale, lidar);
            }
            if (is_deskewed_ && has_poses_ &&
                lidars_.back().units.time_reference != read::PointTimeReference::none)
                add_topic_note(clouds,
                               "relidar deskewed the points to the stamp of the cloud. They are converted "
                               "back to the sensor's frame at the time of each point");
        }
    }

    /// A single LiDAR is the vehicle frame. Several have poses on the vehicle.
    void add_lidars() {
        const bool is_one = clouds_.lidars.size() == 1;
        log_.lidars.clear();
        for (std::size_t l = 0; l < clouds_.lidars.size(); ++l) {
            Lidar lidar;
            lidar.sensor = lidars_[l].sensor;
            if (lidar.sensor.beams.empty()) lidar.sensor.name = topic_name_of(cloud_topic_of(l));
            if (lidar.sensor.beams.empty()) lidar.sensor.max_range_m = options_.max_range_m;
            if (!is_one || !options_.lidars.empty()) lidar.name = topic_name_of(cloud_topic_of(l));
            if (!is_one)
                lidar.vehicle_from_sensor =
                    *survey_.frames.find_constant(poses_.vehicle, cloud_topic_of(l).frame);
            log_.lidars.push_back(std::move(lidar));
        }
    }

    /// Returns the pose of the vehicle. The frame of a single LiDAR is the vehicle frame.
    Pose vehicle_pose(double t_s) const {
        const Pose world_from_vehicle = poses_.path->compute_pose_at(t_s);
        if (clouds_.lidars.size() > 1) return world_from_vehicle;
        return world_from_vehicle * *survey_.frames.find_constant(poses_.vehicle, main_topic().frame);
    }

    /// Compares the clock of the log with another clock: with the sensor's clock if the
    /// recording contains packets that have it, otherwise with the recorder's clock.
    ClockOffset compare_clocks() const {
        if (poses_.clock == LogClock::recorder) return {};
        const CloudTopic& main = main_topic();
        std::vector<MessageTimes> times = list_times(main.clouds);
        const std::vector<packets::PacketRevolution>& revolutions = main.packets.revolutions();
        for (std::size_t i = 0; !revolutions.empty() && i < times.size(); ++i) {
            // log_ns becomes the time on the sensor's clock, if this is known (not 0).
            const std::int64_t ahead_ns = revolutions[main.clouds[i].revolution_index].stamp_less_clock_ns;
            if (ahead_ns != 0) times[i].log_ns = times[i].stamp_ns - ahead_ns;
        }
        // The same messages with stamps of the other clock.
        std::vector<MessageTimes> other = times;
        for (MessageTimes& message : other) message.stamp_ns = message.log_ns;
        const ClockOffset offset = estimate_offset(times, other);
        if (offset.drift_ns != 0 && !offset.is_clear) return {};
        // A sensor without GPS counts its hour from any moment. Only whole seconds show
        // that the sensor has GPS.
        const bool is_unrelated = main.packets.has_clock_wraps() && offset.offset_ns % kNsPerSecond != 0;
        return is_unrelated ? ClockOffset{} : offset;
    }

    /// Reads vehicle poses from a file of the user, which lists them by frame number or
    /// by time. Uses another clock if the file covers the frames only on that clock.
    std::vector<Pose> read_user_poses() {
        const auto read_poses = [&](std::int64_t clock_offset_ns, Notes& notes) {
            std::vector<read::LogFrame> frames;
            // Time 0 of the log, on the clock that the file is assumed to use.
            const double zero_s = 1e-9 * double(poses_.zero_ns - clock_offset_ns);
            for (const FrameCloud& frame : frames_)
                frames.push_back({frame.number, frame.time_s + zero_s, 0, {}});
            Log listed;
            const auto poses =
                read::load_poses(options_.poses_file, frames, nullptr, options_.conventions, listed);
            notes = listed.notes;
            for (UsedConvention& used : listed.conventions_used) read::list_convention(log_, std::move(used));
            if (!poses)
                fail("{}: no such file, expected poses (dataset.poses)", options_.poses_file.string());
            return *poses;
        };
        const bool is_known = read::read_clock_offset_s(options_.conventions).has_value();
        const ClockOffset offset = is_known ? ClockOffset{} : compare_clocks();
        std::vector<Pose> poses, other_poses;  // on the clock of the scans, and on the other clock
        Notes ignored_notes;
        try {
            if (offset.offset_ns != 0) other_poses = read_poses(offset.offset_ns, ignored_notes);
        } catch (const DataError&) {
            // The file has no poses at the times of the other clock.
        }
        try {
            Notes notes;
            poses = read_poses(0, notes);
            log_.notes.insert(log_.notes.end(), notes.begin(), notes.end());
        } catch (const DataError&) {
            if (other_poses.empty()) throw;
        }
        const bool are_equal = std::ranges::equal(poses, other_poses, [](const Pose& a, const Pose& b) {
            return a.translation == b.translation && a.rotation == b.rotation;
        });
        if (!other_poses.empty() && !are_equal)
            add_note(fmt::format(
                "the clock of the scans is {}; {}",
                offset.describe(main_topic().packets.revolutions().empty() ? "the recorder" : "the sensor"),
                poses.empty() ? "the poses cover the scans only on the latter clock, so it is used"
                              : "the poses cover the scans on both clocks; they are read on the clock of the "
                                "scans, so check the clock of the poses"));
        return poses.empty() ? other_poses : poses;
    }

    /// Adds the boxes of the bag to the log. If the vehicle poses are from a file of the
    /// user, the boxes move with the vehicle.
    void add_boxes() {
        if (!boxes_.topic) return;
        BoxContext transform_context{.frames = survey_.frames,
                                     .poses = poses_,
                                     .vehicle = {},
                                     .world_from_vehicle = {},
                                     .box_zero_ns = poses_.zero_ns,
                                     .is_world_of_poses = has_poses_};
        if (poses_.clock == LogClock::stamps) {
            const ClockOffset offset =
                estimate_offset(list_times(main_topic().clouds), list_times(boxes_.topic->lists));
            transform_context.box_zero_ns -= offset.correction_ns();
        }
        const bool has_vehicle_frame = has_poses_ || clouds_.lidars.size() > 1;
        transform_context.vehicle = has_vehicle_frame ? poses_.vehicle : main_topic().frame;
        transform_context.world_from_vehicle = [&](double t_s) {
            if (has_poses_) return poses_.path->compute_pose_at(t_s);
            return log_.has_poses ? log_.world_from_vehicle.pose_at(t_s) : Pose{};
        };
        const LoadedBoxes tracks =
            read_bag_boxes(bag_, *boxes_.topic, transform_context, log_.world_from_vehicle.time_s);
        log_.boxes = tracks.tracks;
        for (const std::string& text : tracks.notes) add_topic_note(*boxes_.topic, text);
    }

    /// Returns the topic with the most positions on the earth, or null.
    const FixTopic* find_fixes() const {
        if (!has_poses_ || survey_.fixes.empty()) return nullptr;
        const auto count = [](const FixTopic& fixes) { return fixes.samples.size(); };
        return &*std::ranges::max_element(survey_.fixes, {}, count);
    }

    /// Adds the frames with their vehicle poses, the boxes and the place on the earth.
    void add_frames() {
        std::vector<Pose> file_poses;
        if (!options_.poses_file.empty() && options_.poses_file != kNoPoses) file_poses = read_user_poses();
        log_.has_poses = has_poses_ || !file_poses.empty();
        for (std::size_t i = 0; i < frames_.size(); ++i) {
            // Without poses, the vehicle stays at the origin.
            Pose pose;
            if (!file_poses.empty()) pose = file_poses[i];
            else if (has_poses_) pose = vehicle_pose(frames_[i].time_s);
            add_frame(log_, frames_[i].number, frames_[i].time_s, pose, int(frames_[i].lidar));
        }
        if (options_.poses_file == kNoPoses) log_.notes.push_back(read::kNoPosesNote);
        else if (!log_.has_poses)
            add_note(
                "the recording has no poses; they must be estimated from the scans, like with "
                "dataset.poses=none");
        log_.conventions = fmt::format(
            "ROS frames: x forward, y left, z up, in metres. Frame numbers count the clouds of {} from 0.",
            topic_name_of(main_topic()));
        set_log_start(log_, poses_.zero_ns,
                      poses_.clock == LogClock::stamps ? "on the clock of the time stamps"
                                                       : "on the clock of the recorder");
        add_boxes();
        centre_log(log_);
        const FixTopic* fixes = find_fixes();
        if (!fixes) return;
        const GeoreferenceFit place = find_place(*fixes, poses_, survey_.frames);
        log_.georeference = place.georeference;
        add_topic_note(*fixes, place.note);
    }
};

}  // namespace

Log load_ros_bag(const std::filesystem::path& path, const DatasetOptions& options) {
    return BagLogLoader(path, options).load_recording();
}

}  // namespace relidar
