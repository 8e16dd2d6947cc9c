// SPDX-License-Identifier: Apache-2.0
// Fuzzes KITTI raw, odometry and KITTI-360 logs of the same scans.
#include "harness.hpp"

#include <fmt/format.h>

#include "changed_files.hpp"
#include "read/datasets/kitti/hdl64_rings.hpp"
#include "read/datasets/kitti/kitti_360.hpp"
#include "read/datasets/kitti/kitti_360_folder.hpp"
#include "read/datasets/kitti/log_files.hpp"
#include "read/scans/pose_files.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr unsigned kPosesFile = 1, kNone = 2, kAllScans = 4, kAllFrames = 8;  // options

/// Removes six of seven points of a scan, so that reading a sweep takes milliseconds.
void thin(const fs::path& scan) {
    const std::string all_points = read_contents(scan);
    std::string some;
    for (std::size_t at = 0; at + 16 <= all_points.size(); at += 7 * 16) some += all_points.substr(at, 16);
    put(scan, some);
}

struct Drive {
    test::KittiDrive log{"fuzz"};
    fs::path odometry = log.file("odometry"), poses = log.file("poses.txt");
    ChangedFiles files{write_files()};

    std::vector<std::string> seeds() const { return files.seeds({0u, kNone, kAllFrames}, {0u, kPosesFile}); }
    std::vector<fs::path> write_files() const {
        put(poses, "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n1 0 0 2 0 1 0 0 0 0 1 0\n");
        fs::create_directories(odometry / "velodyne");
        for (int frame = 0; frame < 3; ++frame) {
            thin(log.scan(frame));
            fs::copy_file(log.scan(frame), odometry / "velodyne" / fmt::format("{:06d}.bin", frame));
        }
        put(odometry / "calib.txt", "P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 0 -1 0 0 0 0 -1 -0.1 1 0 0 -0.3\n");
        put(odometry / "times.txt", "0.0e+00\n1.0e-01\n2.0e-01\n");
        fs::copy_file(poses, odometry / "poses.txt");
        return {log.file("velodyne_points/timestamps.txt"),
                log.file("velodyne_points/timestamps_start.txt"),
                log.file("velodyne_points/timestamps_end.txt"),
                log.file("oxts/data/0000000000.txt"),
                log.file("oxts/data/0000000001.txt"),
                log.calibration(),
                log.file("tracklet_labels.xml"),
                poses,
                log.scan(0),
                log.scan(2),
                odometry / "calib.txt",
                odometry / "times.txt",
                odometry / "poses.txt",
                odometry / "velodyne/000000.bin"};
    }
};

/// Runs all readers, and reports the last error.
void attempt_all(const std::vector<std::function<void()>>& readers) {
    std::exception_ptr failure;
    for (const auto& read : readers) {
        try {
            read();
        } catch (const std::exception&) {
            failure = std::current_exception();
        }
    }
    if (failure) std::rethrow_exception(failure);
}

void read_drive_texts(const Drive& drive, unsigned options) {
    const std::vector<int> frames = kitti::list_scans(drive.log.folder / "velodyne_points/data", 0, -1);
    const PoseTrack track{{0.0, 0.1, 0.2}, std::vector<Pose>(3)};
    attempt_all({[&] { kitti::read_sweep_s(drive.log.folder); },
                 [&] {
                     Log log;
                     kitti::read_frame_times(drive.log.folder / "velodyne_points/timestamps.txt", frames,
                                             log);
                 },
                 [&] {
                     if (options & kPosesFile) read::read_matrices(drive.poses, frames);
                     else kitti::read_oxts_poses(drive.log.folder, frames);
                 },
                 [&] { kitti::split_rings(kitti::read_kitti_scan(drive.log.scan(0))); },
                 [&] { kitti::read_tracklets(drive.log.folder / "tracklet_labels.xml", frames, track); }});
}

DatasetOptions to_dataset(unsigned options) {
    DatasetOptions dataset;
    if (options & kNone) dataset.poses_file = kNoPoses;
    if (!(options & kAllFrames)) dataset.frames = {0, 1};
    return dataset;
}

void read_all_frames(const Drive& drive, unsigned options) {
    DatasetOptions dataset = to_dataset(options);
    if ((options & kPosesFile) && !(options & kNone)) dataset.poses_file = drive.poses;
    dataset.allow_missing_scans = !(options & kAllScans);
    load_log("kitti_raw:" + drive.log.folder.string(), dataset);
}

void read_odometry(const Drive& drive, unsigned options) {
    load_log("kitti_odometry:" + drive.odometry.string(), to_dataset(options));
}

struct Tracking {
    test::KittiDrive drive{"fuzz_tracking"};
    fs::path folder = drive.file("tracking");
    ChangedFiles files{write_files()};

    std::vector<std::string> seeds() const { return files.seeds({0u, kAllFrames}, {kAllFrames, kNone}); }
    std::vector<fs::path> write_files() const {
        for (const char* part : {"velodyne/0000", "oxts", "label_02", "calib"})
            fs::create_directories(folder / part);
        std::string oxts, labels;
        for (int frame = 0; frame < 3; ++frame) {
            thin(drive.scan(frame));
            fs::copy_file(drive.scan(frame), folder / "velodyne/0000" / fmt::format("{:06d}.bin", frame));
            oxts += fmt::format("49 {} 110 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n",
                                8.4 + 1e-5 * frame);
            labels +=
                fmt::format("{} 7 Car 0 0 -1.5 0 0 50 50 1.5 1.6 4 -2 1.7 {} -1.5\n", frame, 12 - frame);
        }
        put(folder / "oxts/0000.txt", oxts);
        put(folder / "label_02/0000.txt", labels);
        put(folder / "calib/0000.txt",
            "R_rect 1 0 0 0 1 0 0 0 1\nTr_velo_cam 0 -1 0 0 0 0 -1 0 1 0 0 0\n"
            "Tr_imu_velo 1 0 0 0 0 1 0 0 0 0 1 0\n");
        return {folder / "oxts/0000.txt", folder / "label_02/0000.txt", folder / "calib/0000.txt",
                folder / "velodyne/0000/000000.bin"};
    }
};

void read_tracking(const Tracking& tracking, unsigned options) {
    load_log("kitti_tracking:" + tracking.folder.string(), to_dataset(options));
}

struct Kitti360 {
    test::Kitti360Folder log{"fuzz_360", 0};
    ChangedFiles files{thin_scans()};

    std::vector<std::string> seeds() const { return files.seeds({0u, kAllFrames}, {kAllFrames, kNone}); }
    std::vector<fs::path> thin_scans() const {
        for (int frame = 0; frame < 3; ++frame) thin(log.scan(frame));
        return {log.raw() / "timestamps.txt",
                log.poses(),
                log.boxes(),
                log.calibration("calib_cam_to_pose.txt"),
                log.calibration("calib_cam_to_velo.txt"),
                log.scan(0)};
    }
};

void read_kitti_360(const Kitti360& kitti, unsigned options) {
    load_log("kitti360:" + kitti.log.folder.string(), to_dataset(options));
}

void read_kitti_360_texts(const Kitti360& kitti, unsigned) {
    static const std::vector<Frame> frames{{0, 0.0, {}, 0}, {1, 0.1, {}, 0}, {2, 0.2, {}, 0}};
    attempt_all({[&] { kitti::read_time_step_s(kitti.log.raw() / "timestamps.txt"); },
                 [&] { kitti::read_numbered_poses(kitti.log.poses()); },
                 [&] { kitti::read_360_boxes(kitti.log.boxes(), frames); }});
}

/// The seeds are not valid logs, because a part of a scan cannot be read as a scan.
template <class Dataset, auto Read>
Harness make_harness(const char* name) {
    return {name, [](const fs::path& folder) { return dataset_in<Dataset>(folder).seeds(); },
            [](std::string_view input, const fs::path& folder) {
                const Dataset& dataset = dataset_in<Dataset>(folder);
                dataset.files.read(input, [&](unsigned options) { Read(dataset, options); });
            },
            false};
}

}  // namespace

/// Reading the full drive takes a hundred times as long as reading its texts.
std::vector<Harness> list_drive_harnesses() {
    return {make_harness<Drive, read_drive_texts>("drive_texts"),
            make_harness<Drive, read_all_frames>("drive"),
            make_harness<Drive, read_odometry>("odometry"),
            make_harness<Tracking, read_tracking>("tracking"),
            make_harness<Kitti360, read_kitti_360_texts>("kitti360_texts"),
            make_harness<Kitti360, read_kitti_360>("kitti360")};
}

}  // namespace relidar::fuzz
