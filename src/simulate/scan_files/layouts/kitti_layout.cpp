// SPDX-License-Identifier: Apache-2.0
// Writes the layouts of KITTI's object and tracking benchmarks, after the readme files of
// their development kits.
#include "simulate/scan_files/layouts/layout.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "simulate/scan_files/layouts/oxts.hpp"
#include "simulate/scan_files/placed_scan.hpp"

namespace relidar::layouts {
namespace {

namespace fs = std::filesystem;

constexpr int kMaxFrames = 1'000'000, kMaxSequences = 10'000;  // names have 6 and 4 digits

double wrap_angle(double angle_rad) { return std::remainder(angle_rad, 2.0 * kPi); }

/// Returns KITTI's occlusion: 0 fully visible, 1 partly, 2 largely occluded, 3 unknown.
int occlusion_level(const std::optional<double>& visible_share) {
    constexpr double kFullyVisible = 0.8, kPartlyVisible = 0.4;
    if (!visible_share) return 3;
    return *visible_share >= kFullyVisible ? 0 : *visible_share >= kPartlyVisible ? 1 : 2;
}

/// Returns the columns of a KITTI label from `occluded` to `rotation_y`, which the object
/// and the tracking benchmark share. The camera frame has the axes right, down, forward.
std::string label_columns(const LabelledObject& object, const Pose& camera_from_world,
                          const Pose& camera_from_rig) {
    const Pose camera_from_box = camera_from_world * object.world_from_box;
    // Loaders compute the centre of the box along the z axis of the LiDAR, also if the
    // LiDAR is tilted against the box.
    const glm::dvec3 &size_m = object.size_m, forward = camera_from_box.rotation * glm::dvec3(1.0, 0.0, 0.0),
                     up = camera_from_rig.rotation * glm::dvec3(0.0, 0.0, 1.0),
                     location = camera_from_box.translation - 0.5 * size_m.z * up;
    const double rotation_y = std::atan2(-forward.z, forward.x);  // angle from right to backward
    // `alpha` is rotation_y relative to the line from the camera to the object.
    const double alpha = wrap_angle(rotation_y - std::atan2(location.x, location.z));
    const ImageBox box = object.image_box.value_or(ImageBox{});
    // occluded, alpha, image box, height, width, length, location, rotation_y
    return fmt::format(
        "{} {:.4f} {:.2f} {:.2f} {:.2f} {:.2f} {:.4f} {:.4f} {:.4f} {:.4f} {:.4f} {:.4f} {:.4f}",
        occlusion_level(object.visible_share), alpha, box.min_px.x, box.min_px.y, box.max_px.x, box.max_px.y,
        size_m.z, size_m.y, size_m.x, location.x, location.y, location.z, rotation_y);
}

/// Returns the columns of DontCare after its truncation: part of a picture without
/// labels.
std::string unlabelled_columns(const ImageBox& box) {
    return fmt::format("-1 -10 {:.2f} {:.2f} {:.2f} {:.2f} -1 -1 -1 -1000 -1000 -1000 -10", box.min_px.x,
                       box.min_px.y, box.max_px.x, box.max_px.y);
}

/// Returns the truncation of the tracking benchmark: 0 no, 1 partly, 2 largely.
int truncation_level(double share_outside) {
    constexpr double kWhole = 0.1, kLargely = 0.5;
    return share_outside < kWhole ? 0 : share_outside < kLargely ? 1 : 2;
}

/// Makes a file available under a second name: a hard link, or a copy if links fail.
void share_file(const fs::path& file, const fs::path& other) {
    std::error_code failed;
    fs::create_directories(other.parent_path(), failed);
    // Replaces an earlier file in one step.
    const fs::path link = other.string() + ".new";
    fs::remove(link, failed);
    fs::create_hard_link(file, link, failed);
    if (failed) return write_bytes(other, read_file(file));
    fs::rename(link, other);
}

class KittiWriter : public LayoutWriter {
public:
    KittiWriter(SequencePlace place, const std::vector<DatasetSensor>& sensors, const DatasetView& view)
        : LayoutWriter(std::move(place), sensors, view) {
        if (place_.first_frame + place_.n_frames > kMaxFrames || place_.number >= kMaxSequences)
            fail<UsageError>("--layout kitti: found frame {} and sequence {}, expected at most {} and {}",
                             place_.first_frame + place_.n_frames - 1, place_.number, kMaxFrames - 1,
                             kMaxSequences - 1);
        if (!place_.is_new) return;
        // Removes the frames of an interrupted sequence.
        std::error_code failed;
        for (const char* files : {"velodyne", "image_02"}) fs::remove_all(tracked(files), failed);
        const fs::path object = place_.folder / "training";
        for (int frame = place_.first_frame;; ++frame) {
            const std::string name = frame_name(frame);
            for (const char* files : {"label_2", "calib"})
                fs::remove(object / files / (name + ".txt"), failed);
            for (const char* files : {"image_2", "depth_2"})
                fs::remove(object / files / (name + ".png"), failed);
            if (!fs::remove(object / "velodyne" / (name + ".bin"), failed)) break;
        }
    }

    void write_frame(const LabelledFrame& frame) override {
        // Numbers of object frames count all sequences. Tracking frames start at 0.
        const std::string name = frame_name(place_.first_frame + int(frame.index)),
                          tracked_name = frame_name(int(frame.index));
        const fs::path object = place_.folder / "training", points = object / "velodyne" / (name + ".bin"),
                       picture = object / "image_2" / (name + ".png");
        write_rig_points(points, frame, sensors_);
        share_file(points, tracked("velodyne") / (tracked_name + ".bin"));
        write_picture(picture, camera(), frame.picture);
        share_file(picture, tracked("image_02") / (tracked_name + ".png"));
        if (frame.picture) write_depth(object / "depth_2" / (name + ".png"), *frame.picture);
        std::string labels;
        const Pose camera_from_world = inverse(frame.world_from_rig * camera().rig_from_camera);
        for (const LabelledObject& label : frame.objects) {
            const std::string columns =
                label_columns(label, camera_from_world, inverse(camera().rig_from_camera));
            const double truncated = label.image_box ? label.image_box->truncated : 1.0;
            labels += fmt::format("{} {:.2f} {}\n", label.name, truncated, columns);
            tracks_ += fmt::format("{} {} {} {} {}\n", frame.index, label.number, label.name,
                                   truncation_level(truncated), columns);
        }
        for (const ImageBox& box : frame.unlabelled) {
            labels += fmt::format("DontCare -1 {}\n", unlabelled_columns(box));
            tracks_ += fmt::format("{} -1 DontCare -1 {}\n", frame.index, unlabelled_columns(box));
        }
        // OpenPCDet does not read a frame without labels.
        if (labels.empty()) labels = fmt::format("DontCare -1 {}\n", unlabelled_columns({}));
        write_bytes(object / "label_2" / (name + ".txt"), labels);
        write_bytes(object / "calib" / (name + ".txt"),
                    calibration("R0_rect:", "Tr_velo_to_cam:", "Tr_imu_to_velo:"));
        times_s_.push_back(frame.time_s);
        world_from_rig_.push_back(frame.world_from_rig);
    }

    void finish(const DatasetIndex& index) override {
        write_bytes(tracked("label_02") += ".txt", tracks_);
        write_bytes(tracked("calib") += ".txt", calibration("R_rect", "Tr_velo_cam", "Tr_imu_velo"));
        std::string times;
        for (const double time_s : times_s_) times += fmt::format("{:.6f}\n", time_s - times_s_.front());
        write_bytes(tracked("times") += ".txt", times);
        write_bytes(tracked("oxts") += ".txt",
                    format_oxts(world_from_rig_, times_s_, sensors_[0].options.georeference));
        std::string train, val;
        int number = 0;
        for (std::size_t s = 0; s < index.sequences.size(); ++s)
            for (int frame = 0; frame < index.sequences[s].n_frames; ++frame)
                (index.is_validation(s, frame) ? val : train) += frame_name(number++) + "\n";
        const fs::path sets = place_.folder / "ImageSets";
        write_bytes(sets / "train.txt", train);
        write_bytes(sets / "val.txt", val);
        // The frames of a data set with several sequences are not in the order of `train
        // + val`.
        write_bytes(sets / "trainval.txt", list_frames(number));
        write_bytes(sets / "test.txt", "");
    }

private:
    std::string tracks_;  ///< labels of the tracking benchmark
    std::vector<double> times_s_;
    std::vector<Pose> world_from_rig_;

    static std::string frame_name(int number) { return fmt::format("{:06}", number); }
    fs::path tracked(const char* what) const {
        return place_.folder / "tracking/training" / what / fmt::format("{:04}", place_.number);
    }
    static std::string list_frames(int n_frames) {
        std::string names;
        for (int frame = 0; frame < n_frames; ++frame) names += frame_name(frame) + "\n";
        return names;
    }
    /// Returns the calibration of the camera, which is all cameras and the rectified one.
    /// The frame of the IMU is that of the points.
    std::string calibration(const char* rectification, const char* camera_from_velo,
                            const char* velo_from_imu) const {
        const Camera& c = camera();
        std::string lines;
        for (int number = 0; number < 4; ++number)
            lines += fmt::format("P{}: {} 0 {} 0 0 {} {} 0 0 0 1 0\n", number, c.focal_x_px, c.centre_x_px,
                                 c.focal_y_px, c.centre_y_px);
        const std::vector<double> matrix = scan_files::row_major(inverse(c.rig_from_camera));
        return lines + fmt::format("{} 1 0 0 0 1 0 0 0 1\n{} {}\n{} 1 0 0 0 0 1 0 0 0 0 1 0\n", rectification,
                                   camera_from_velo, fmt::join(matrix.begin(), matrix.begin() + 12, " "),
                                   velo_from_imu);
    }
};

}  // namespace

std::unique_ptr<LayoutWriter> make_kitti_writer(SequencePlace place,
                                                const std::vector<DatasetSensor>& sensors,
                                                const DatasetView& view) {
    return std::make_unique<KittiWriter>(std::move(place), sensors, view);
}

}  // namespace relidar::layouts
