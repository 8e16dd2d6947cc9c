// SPDX-License-Identifier: Apache-2.0
// Loads a recording in two passes. The first pass finds the topics, clouds and poses in
// bounded memory. The second pass reads only the clouds of the requested frames. These
// clouds become scans in the same way as the scans of a plain folder.
#include "log/readers/bag/load_ros_bag.hpp"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "base/files.hpp"
#include "log/clouds/log_files.hpp"
#include "log/clouds/match_sweeps.hpp"
#include "log/clouds/sweep_poses.hpp"
#include "log/readers/bag/bag_boxes.hpp"
#include "log/readers/bag/bag_scans.hpp"
#include "log/readers/bag/choose.hpp"
#include "log/readers/bag/recording_notes.hpp"

namespace relidar {
namespace {

using namespace bag;

constexpr std::int64_t kSecond_ns = 1000000000;
constexpr double kLeastStep_s = 2e-3;  // minimum time between sweeps
// Clouds of several LiDARs are one sweep if their times differ by at most this share of
// the main LiDAR's sweep period.
constexpr double kBeside = 0.6;

class BagLog {
public:
    BagLog(const std::filesystem::path& path, const DatasetOptions& options)
        : options_(options),
          bag_(path, options.skip_broken),
          survey_(survey_bag(bag_, options.progress)),
          clouds_(choose_clouds(bag_, survey_, options.lidars)),
          poses_(choose_poses(bag_, survey_, main(), options.bag.poses_from)),
          boxes_(choose_box_topic(bag_, survey_)) {
        sequence_.name = path.lexically_normal().filename().empty()
                             ? path.lexically_normal().parent_path().filename().string()
                             : path.lexically_normal().filename().string();
        sequence_.source = path.string();
    }

    Sequence load() {
        has_poses_ = options_.poses_file.empty() && poses_.path;
        is_deskewed_ = bag_.points_in() == "sensor at the stamp";
        note_topics();
        find_frames();
        add_lidars();
        add_frames();
        folder::Head head;
        head.name = sequence_.name;
        for (std::size_t l = 0; l < sequence_.lidars.size(); ++l) {
            head.lidars.emplace_back().lidar = sequence_.lidars[l];
            head.lidars.back().is_guessed = true;
            head.lidars.back().has_beams = !sequence_.lidars[l].sensor.beams.empty();
            head.motion_compensated =
                head.motion_compensated || lidars_[l].units.is_deskewed || (is_deskewed_ && !has_poses_);
        }
        DatasetOptions options = options_;
        if (!sequence_.has_poses) options.poses_file = kNoPoses;
        LidarPose deskewed_by;
        if (is_deskewed_ && has_poses_)
            deskewed_by = [&](std::size_t lidar, double t_s) { return compute_lidar_pose(lidar, t_s); };
        folder::read_scans(sequence_, head, BagScans(bag_, lidars_, frames_, poses_.clock, deskewed_by),
                           options);
        if (has_poses_)
            note(correct_ray_motion(sequence_, [&](double t_s) { return compute_recentred_pose(t_s); }));
        return std::move(sequence_);
    }

private:
    const DatasetOptions& options_;
    Bag bag_;
    Survey survey_;
    CloudChoice clouds_;
    PoseChoice poses_;
    BoxChoice boxes_;
    Sequence sequence_;
    std::vector<LidarTopic> lidars_;  ///< topic of each LiDAR
    std::vector<FrameCloud> frames_;  ///< cloud of each frame
    bool has_poses_ = false;          ///< the recording has poses
    /// True if relidar wrote the bag with motion-compensated points. All points of a
    /// cloud are then in the sensor frame at the time of its stamp.
    bool is_deskewed_ = false;

    const CloudTopic& get_topic(std::size_t lidar) const { return survey_.clouds[clouds_.lidars[lidar]]; }
    const CloudTopic& main() const { return get_topic(clouds_.main); }
    template <class AnyTopic>
    const std::string& get_name(const AnyTopic& any) const {
        return bag_.topics()[any.topic].name;
    }
    double seconds(const CloudEntry& entry) const {
        return 1e-9 * double(entry.time_ns(poses_.clock) - poses_.zero_ns);
    }

    void note(const std::string& text) {
        if (!text.empty()) sequence_.notes.push_back(text);
    }

    void note_topics() {
        std::vector<bool> used(bag_.topics().size(), false);
        for (const std::size_t c : clouds_.lidars) used[survey_.clouds[c].topic] = true;
        for (std::size_t t = 0; t < used.size(); ++t)
            if (has_poses_ && !used[t])
                used[t] = get_topic_use(bag_.topics()[t]) == Use::transforms ||
                          poses_.about.ends_with(" " + bag_.topics()[t].name);
        if (boxes_.topic) used[boxes_.topic->topic] = true;
        for (const std::string& text : bag_.notes()) note(text);
        for (const std::string& text : list_topic_lines(bag_, survey_, used)) note(text);
        for (const std::string& text : clouds_.notes) note(text);
        for (const std::string& text : poses_.notes) note(text);
        for (const std::string& text : boxes_.notes) note(text);
        if (has_poses_) note(poses_.about + "; use dataset.poses_from to select another frame or topic");
        for (const std::string& frame : survey_.frames.list_disputed_frames())
            note(
                fmt::format("the frame '{}' has several parents in /tf; the parent with the most "
                            "transforms is used",
                            frame));
        for (std::size_t l = 0; l < clouds_.lidars.size(); ++l)
            if (const std::string text = describe_time_jumps(get_topic(l)); !text.empty())
                note(get_name(get_topic(l)) + ": " + text);
    }

    /// Lists the frames of the log. Each cloud of the main LiDAR starts a frame. Clouds
    /// of other LiDARs belong to the frame with the nearest time.
    void find_frames() {
        std::vector<FrameCloud> sweeps;
        std::size_t n_late = 0;
        for (const CloudEntry& entry : main().clouds) {
            const double t_s = seconds(entry);
            if (!sweeps.empty() && t_s < sweeps.back().time_s + kLeastStep_s) {
                ++n_late;
                continue;
            }
            sweeps.push_back({int(sweeps.size()), t_s, t_s, clouds_.main, entry});
        }
        if (n_late > 0)
            note(fmt::format("{} clouds are skipped, because they are not later than the previous cloud",
                             n_late));
        std::vector<double> times_s;
        for (const FrameCloud& sweep : sweeps) times_s.push_back(sweep.time_s);
        const double step_s = compute_median_step_s(times_s);
        note(describe_gaps(times_s, step_s));
        std::vector<FrameCloud> all = sweeps;
        for (std::size_t l = 0; l < clouds_.lidars.size(); ++l)
            if (l != clouds_.main) add_nearby_scans(all, sweeps, l, kBeside * step_s);
        std::ranges::stable_sort(all, [](const FrameCloud& first, const FrameCloud& second) {
            return first.number != second.number ? first.number < second.number : first.lidar < second.lidar;
        });
        remove_unselected_clouds(all);
        estimate_point_units(step_s);
    }

    void add_nearby_scans(std::vector<FrameCloud>& all_clouds, const std::vector<FrameCloud>& sweeps,
                          std::size_t lidar, double max_difference_s) {
        const std::vector<CloudEntry>& clouds = get_topic(lidar).clouds;
        std::vector<double> main_s, other_s;
        for (const FrameCloud& sweep : sweeps) main_s.push_back(sweep.time_s);
        for (const CloudEntry& entry : clouds) other_s.push_back(seconds(entry));
        const auto beside = match_sweeps(main_s, other_s, max_difference_s);
        std::size_t n_left = clouds.size();
        for (std::size_t k = 0; k < sweeps.size(); ++k) {
            if (!beside[k]) continue;
            all_clouds.push_back(
                {sweeps[k].number, main_s[k], other_s[*beside[k]], lidar, clouds[*beside[k]]});
            --n_left;
        }
        if (n_left > 0)
            note(fmt::format("{}: {} clouds are skipped, because {} has no cloud near their times",
                             get_name(get_topic(lidar)), n_left, get_name(main())));
    }

    void remove_unselected_clouds(const std::vector<FrameCloud>& all_clouds) {
        std::size_t n_unplaced = 0;
        for (const FrameCloud& cloud : all_clouds) {
            if (cloud.number < options_.frames.begin ||
                (options_.frames.end >= 0 && cloud.number >= options_.frames.end))
                continue;
            if (has_poses_ && !poses_.path->covers(cloud.time_s)) ++n_unplaced;
            else frames_.push_back(cloud);
        }
        if (frames_.empty() && n_unplaced > 0)
            throw DataError(
                fmt::format("{}: {}; none of the {} clouds has a pose at its time; use dataset.poses_from "
                            "or dataset.poses=FILE to select other poses, or dataset.poses=none to "
                            "estimate the poses from the scans",
                            sequence_.source, poses_.about, n_unplaced));
        if (frames_.empty())
            throw UsageError(fmt::format(
                "frames {}:{} select no cloud of {}; frames are numbered from 0", options_.frames.begin,
                options_.frames.end < 0 ? "" : std::to_string(options_.frames.end), get_name(main())));
        if (n_unplaced > 0)
            note(fmt::format("{} clouds are skipped, because there are no poses at their times", n_unplaced));
    }

    void estimate_point_units(double step_s) {
        for (std::size_t l = 0; l < clouds_.lidars.size(); ++l) {
            const CloudTopic& clouds = get_topic(l);
            const std::size_t n_parts =
                clouds.clouds.empty() ? 1 : std::max<std::size_t>(clouds.clouds[0].parts.size(), 1);
            lidars_.push_back(sample_cloud_topic(bag_, clouds, step_s / double(n_parts)));
            if (!clouds.packets.empty()) lidars_.back().sensor = clouds.packets.sensor();
            if (!clouds.parts_about.empty()) note(get_name(clouds) + ": " + clouds.parts_about);
            if (!lidars_.back().units.about.empty())
                note(get_name(get_topic(l)) + ": " + lidars_.back().units.about);
            for (const std::string& text : lidars_.back().units.meaning.notes)
                note(get_name(get_topic(l)) + ": " + text);
            if (is_deskewed_ && has_poses_ && lidars_.back().units.zero != TimeZero::none)
                note(get_name(clouds) +
                     ": the points were deskewed to the stamp by relidar; they are converted back to the "
                     "sensor's frame at their own times");
        }
    }

    /// Adds the LiDARs to the log. The frame of a single LiDAR is the vehicle frame.
    /// Several LiDARs have mounting poses on the vehicle.
    void add_lidars() {
        const bool is_one = clouds_.lidars.size() == 1;
        sequence_.lidars.clear();
        for (std::size_t l = 0; l < clouds_.lidars.size(); ++l) {
            Lidar lidar;
            lidar.sensor = lidars_[l].sensor;
            if (lidar.sensor.beams.empty()) lidar.sensor.name = get_name(get_topic(l));
            if (lidar.sensor.beams.empty()) lidar.sensor.max_range_m = options_.max_range_m;
            if (!is_one || !options_.lidars.empty()) lidar.name = get_name(get_topic(l));
            if (!is_one)
                lidar.vehicle_from_sensor =
                    *survey_.frames.find_constant_pose(poses_.vehicle, get_topic(l).frame);
            sequence_.lidars.push_back(std::move(lidar));
        }
    }

    Pose read_pose_from_bag(double t_s) const {
        const Pose world_from_vehicle = poses_.path->at(t_s);
        if (clouds_.lidars.size() > 1) return world_from_vehicle;
        return world_from_vehicle * *survey_.frames.find_constant_pose(poses_.vehicle, main().frame);
    }

    Pose compute_lidar_pose(std::size_t lidar, double t_s) const {
        const Pose pose = read_pose_from_bag(t_s);
        return clouds_.lidars.size() > 1 ? pose * sequence_.lidars[lidar].vehicle_from_sensor : pose;
    }

    std::optional<Pose> compute_recentred_pose(double t_s) const {
        if (!poses_.path->covers(t_s)) return std::nullopt;
        Pose pose = read_pose_from_bag(t_s);
        pose.translation -= sequence_.world_offset_m;
        return pose;
    }

    /// Reads vehicle poses from a file of the user, which lists them by frame number or
    /// by time.
    std::vector<Pose> list_poses_at_scans() {
        std::vector<folder::HeadFrame> frames;
        for (const FrameCloud& frame : frames_)
            frames.push_back({frame.number, frame.time_s + 1e-9 * double(poses_.zero_ns), 0, {}});
        const auto poses = folder::read_poses(options_.poses_file, frames, nullptr, sequence_.notes);
        if (!poses)
            throw DataError(fmt::format("{}: no such file, expected poses (dataset.poses)",
                                        options_.poses_file.string()));
        return *poses;
    }

    /// Adds the boxes of the bag to the log. If vehicle poses come from a file of the
    /// user, boxes keep their positions relative to the vehicle.
    void add_boxes() {
        if (!boxes_.topic) return;
        BoxPlaces places{survey_.frames, poses_, {}, {}, has_poses_};
        places.vehicle = has_poses_ || clouds_.lidars.size() > 1 ? poses_.vehicle : main().frame;
        places.world_from_vehicle = [&](double t_s) {
            return has_poses_            ? poses_.path->at(t_s)
                   : sequence_.has_poses ? sequence_.world_from_vehicle.at(t_s)
                                         : Pose{};
        };
        const BoxTracks tracks =
            read_tracks(bag_, *boxes_.topic, places, sequence_.world_from_vehicle.time_s);
        sequence_.boxes = tracks.tracks;
        for (const std::string& text : tracks.notes) note(get_name(*boxes_.topic) + ": " + text);
    }

    void add_frames() {
        std::vector<Pose> given;
        if (!options_.poses_file.empty() && options_.poses_file != kNoPoses) given = list_poses_at_scans();
        sequence_.has_poses = has_poses_ || !given.empty();
        for (std::size_t i = 0; i < frames_.size(); ++i)
            add_frame(sequence_, frames_[i].number, frames_[i].time_s,
                      !given.empty() ? given[i]
                      : has_poses_   ? read_pose_from_bag(frames_[i].time_s)
                                     : Pose{},
                      int(frames_[i].lidar));
        if (options_.poses_file == kNoPoses) note(kitti::kNoPosesNote);
        else if (!sequence_.has_poses)
            note(
                "the recording has no poses; they must be estimated from the scans, like with "
                "dataset.poses=none");
        sequence_.conventions = fmt::format(
            "ROS frames: x forward, y left, z up, in metres. The time 0 s is {}.{:09} s of the {}. Frames "
            "are numbered by the clouds of {}.",
            poses_.zero_ns / kSecond_ns, std::abs(poses_.zero_ns % kSecond_ns),
            poses_.clock == Clock::stamps ? "stamps" : "recorder's clock", get_name(main()));
        add_boxes();
        recentre_sequence(sequence_);
    }
};

}  // namespace

Sequence load_ros_bag(const std::filesystem::path& path, const DatasetOptions& options) {
    return BagLog(path, options).load();
}

}  // namespace relidar
