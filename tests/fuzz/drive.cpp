// SPDX-License-Identifier: Apache-2.0
// Fuzzes KITTI raw, odometry and KITTI-360 logs of the same scans.
#include "harness.hpp"

#include <cstdlib>

#include <fmt/format.h>

#include "changed_files.hpp"
#include "read/datasets/kitti/hdl64_rings.hpp"
#include "read/datasets/kitti/kitti_360.hpp"
#include "read/datasets/kitti/kitti_360_folder.hpp"
#include "read/kitti/log_files.hpp"

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

const Drive& make_drive_in(const fs::path& folder) {
    ::setenv("TEST_TMPDIR", folder.c_str(), 1);
    static const Drive drive;
    return drive;
}

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

void read_texts(const Drive& drive, unsigned options) {
    const std::vector<int> frames = kitti::list_scans(drive.log.folder / "velodyne_points/data", 0, -1);
    const PoseTrack track{{0.0, 0.1, 0.2}, std::vector<Pose>(3)};
    attempt_all({[&] { kitti::read_sweep_s(drive.log.folder); },
                 [&] {
                     Log sequence;
                     kitti::read_frame_times(drive.log.folder / "velodyne_points/timestamps.txt", frames,
                                             sequence);
                 },
                 [&] {
                     if (options & kPosesFile) kitti::read_matrices(drive.poses, frames);
                     else kitti::read_oxts_poses(drive.log.folder, frames);
                 },
                 [&] { kitti::split_rings(kitti::read_kitti_scan(drive.log.scan(0)).points); },
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
    load_sequence("kitti_raw:" + drive.log.folder.string(), dataset);
}

void read_odometry(const Drive& drive, unsigned options) {
    load_sequence("kitti_odometry:" + drive.odometry.string(), to_dataset(options));
}

template <auto Read>
void read_changed(std::string_view input, const fs::path& folder) {
    const Drive& drive = make_drive_in(folder);
    drive.files.read(input, [&](unsigned options) { Read(drive, options); });
}

std::vector<std::string> make_drive_seeds(const fs::path& folder) {
    return make_drive_in(folder).files.seeds({0u, kNone, kAllFrames}, {0u, kPosesFile});
}

struct Kitti360 {
    test::Kitti360Folder folder;
    ChangedFiles files;

    explicit Kitti360(const fs::path& at)
        : folder((::setenv("TEST_TMPDIR", at.c_str(), 1), "fuzz_360"), 0), files(thinned(folder)) {}

    static std::vector<fs::path> thinned(const test::Kitti360Folder& folder) {
        for (int frame = 0; frame < 3; ++frame) thin(folder.scan(frame));
        return {folder.raw() / "timestamps.txt",
                folder.poses(),
                folder.boxes(),
                folder.calibration("calib_cam_to_pose.txt"),
                folder.calibration("calib_cam_to_velo.txt"),
                folder.scan(0)};
    }
};

const Kitti360& make_kitti_360_in(const fs::path& folder) {
    static const Kitti360 kitti(folder);
    return kitti;
}

void read_kitti_360(std::string_view input, const fs::path& folder) {
    const Kitti360& kitti = make_kitti_360_in(folder);
    kitti.files.read(input, [&](unsigned options) {
        load_sequence("kitti360:" + kitti.folder.folder.string(), to_dataset(options));
    });
}

void read_kitti_360_texts(std::string_view input, const fs::path& folder) {
    const Kitti360& kitti = make_kitti_360_in(folder);
    static const std::vector<Frame> frames{{0, 0.0, {}, 0}, {1, 0.1, {}, 0}, {2, 0.2, {}, 0}};
    kitti.files.read(input, [&](unsigned) {
        attempt_all({[&] { kitti::read_time_step_s(kitti.folder.raw() / "timestamps.txt"); },
                     [&] { kitti::read_numbered_poses(kitti.folder.poses()); },
                     [&] { kitti::read_360_boxes(kitti.folder.boxes(), frames); }});
    });
}

std::vector<std::string> make_kitti_360_seeds(const fs::path& folder) {
    return make_kitti_360_in(folder).files.seeds({0u, kAllFrames}, {kAllFrames, kNone});
}

}  // namespace

/// Reading the full drive takes a hundred times as long as reading its texts.
std::vector<Harness> list_drive_harnesses() {
    return {
        // The seeds are not valid logs, because a part of a scan cannot be read as a
        // scan.
        {"drive_texts", make_drive_seeds, read_changed<read_texts>, false},
        {"drive", make_drive_seeds, read_changed<read_all_frames>, false},
        {"odometry", make_drive_seeds, read_changed<read_odometry>, false},
        {"kitti360_texts", make_kitti_360_seeds, read_kitti_360_texts, false},
        {"kitti360", make_kitti_360_seeds, read_kitti_360, false},
    };
}

}  // namespace relidar::fuzz
