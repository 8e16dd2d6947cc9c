// SPDX-License-Identifier: Apache-2.0
// Writes the layouts of KITTI's object and tracking benchmarks, after the readme files of
// their development kits. There is no camera: the image boxes are 0, and the calibration
// has a virtual camera at the origin of the rig.
#include "simulate/scan_files/layouts/layout.hpp"

#include <fmt/format.h>

#include "base/fail.hpp"

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
/// and the tracking benchmark share. The rig frame has the axes forward, left, up. The
/// camera frame has right, down, forward.
std::string label_columns(const LabelledObject& object, const Pose& world_from_rig) {
    const Pose rig_from_box = inverse(world_from_rig) * object.world_from_box;
    const glm::dvec3 &size_m = object.size_m, &centre = rig_from_box.translation,
                     forward = rig_from_box.rotation * glm::dvec3(1.0, 0.0, 0.0);
    // Angle from forward to the left. rotation_y is the angle from right to backward.
    const double yaw_rad = std::atan2(forward.y, forward.x);
    const double rotation_y = wrap_angle(-yaw_rad - 0.5 * kPi);
    // `alpha` is rotation_y relative to the line from the camera to the object.
    const double azimuth_to_right_rad = std::atan2(-centre.y, centre.x);
    const double alpha = wrap_angle(rotation_y - azimuth_to_right_rad);
    const glm::dvec3 location(-centre.y, 0.5 * size_m.z - centre.z, centre.x);  // centre of the lower face
    // occluded, alpha, image box (none), height, width, length, location, rotation_y
    return fmt::format("{} {:.4f} 0 0 0 0 {:.4f} {:.4f} {:.4f} {:.4f} {:.4f} {:.4f} {:.4f}",
                       occlusion_level(object.visible_share), alpha, size_m.z, size_m.y, size_m.x, location.x,
                       location.y, location.z, rotation_y);
}

/// Returns the truncation of the tracking benchmark: 0 no, 1 partly, 2 largely.
int truncation_level(double share_outside) {
    constexpr double kWhole = 0.1, kLargely = 0.5;
    return share_outside < kWhole ? 0 : share_outside < kLargely ? 1 : 2;
}

class KittiWriter : public LayoutWriter {
public:
    KittiWriter(SequencePlace place, const std::vector<DatasetSensor>& sensors)
        : LayoutWriter(std::move(place), sensors) {
        if (place_.first_frame + place_.n_frames > kMaxFrames || place_.number >= kMaxSequences)
            fail<UsageError>("--layout kitti: found frame {} and sequence {}, expected at most {} and {}",
                             place_.first_frame + place_.n_frames - 1, place_.number, kMaxFrames - 1,
                             kMaxSequences - 1);
        if (!place_.is_new) return;
        // Removes the frames of an interrupted sequence.
        std::error_code failed;
        fs::remove_all(tracked("velodyne"), failed);
        const fs::path object = place_.folder / "training";
        for (int frame = place_.first_frame;; ++frame) {
            const std::string name = frame_name(frame);
            fs::remove(object / "label_2" / (name + ".txt"), failed);
            fs::remove(object / "calib" / (name + ".txt"), failed);
            if (!fs::remove(object / "velodyne" / (name + ".bin"), failed)) break;
        }
    }

    void write_frame(const LabelledFrame& frame) override {
        // Numbers of object frames count all sequences. Tracking frames start at 0.
        const std::string name = frame_name(place_.first_frame + int(frame.index));
        const fs::path object = place_.folder / "training", points = object / "velodyne" / (name + ".bin"),
                       tracked_points = tracked("velodyne") / (frame_name(int(frame.index)) + ".bin");
        write_rig_points(points, frame, sensors_);
        // Both benchmarks share the points: a hard link, or a copy if links fail.
        std::error_code failed;
        fs::create_directories(tracked_points.parent_path(), failed);
        fs::create_hard_link(points, tracked_points, failed);
        if (failed) write_rig_points(tracked_points, frame, sensors_);
        std::string labels;
        for (const LabelledObject& label : frame.objects) {
            const std::string columns = label_columns(label, frame.world_from_rig);
            labels += fmt::format("{} {:.2f} {}\n", label.name, label.truncated, columns);
            tracks_ += fmt::format("{} {} {} {} {}\n", frame.index, label.number, label.name,
                                   truncation_level(label.truncated), columns);
        }
        write_bytes(object / "label_2" / (name + ".txt"), labels);
        write_bytes(object / "calib" / (name + ".txt"),
                    calibration("R0_rect:", "Tr_velo_to_cam:", "Tr_imu_to_velo:"));
    }

    void finish(const DatasetIndex& index) override {
        write_bytes(tracked("label_02") += ".txt", tracks_);
        write_bytes(tracked("calib") += ".txt", calibration("R_rect", "Tr_velo_cam", "Tr_imu_velo"));
        std::string train, val;
        int number = 0;
        for (std::size_t s = 0; s < index.sequences.size(); ++s)
            for (int frame = 0; frame < index.sequences[s].n_frames; ++frame)
                (index.is_validation(s, frame) ? val : train) += frame_name(number++) + "\n";
        write_bytes(place_.folder / "ImageSets/train.txt", train);
        write_bytes(place_.folder / "ImageSets/val.txt", val);
    }

private:
    std::string tracks_;  ///< labels of the tracking benchmark

    static std::string frame_name(int number) { return fmt::format("{:06}", number); }
    fs::path tracked(const char* what) const {
        return place_.folder / "tracking/training" / what / fmt::format("{:04}", place_.number);
    }
    static std::string calibration(const char* rectification, const char* camera_from_velo,
                                   const char* velo_from_imu) {
        return camera_lines() + fmt::format("{} 1 0 0 0 1 0 0 0 1\n{} {}\n{} {}\n", rectification,
                                            camera_from_velo, kCameraFromRig, velo_from_imu, kVirtualCamera);
    }
};

}  // namespace

std::unique_ptr<LayoutWriter> make_kitti_writer(SequencePlace place,
                                                const std::vector<DatasetSensor>& sensors) {
    return std::make_unique<KittiWriter>(std::move(place), sensors);
}

}  // namespace relidar::layouts
