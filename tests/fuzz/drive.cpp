// SPDX-License-Identifier: Apache-2.0
// A whole small KITTI drive, and an odometry sequence of its scans: an input says what other bytes some of its files hold, so that each
// reader is reached whatever another one would have said before. Input: options, then sections of file number, length (2 bytes,
// little-endian), bytes; the last may be cut.
#include "harness.hpp"

#include <cstdlib>
#include <functional>

#include <fmt/format.h>

#include <relidar/dataset.hpp>

#include "dataset/kitti_drive.hpp"
#include "dataset/hdl64_rings.hpp"
#include "dataset/kitti_files.hpp"

namespace relidar::fuzz {
namespace {

namespace fs = std::filesystem;

constexpr unsigned kPosesFile = 1, kNone = 2, kAllScans = 4, kAllFrames = 8;   // options

/// The drive, a seventh of its points left: a sweep takes milliseconds to read.
class Drive {
public:
    explicit Drive(const fs::path& folder) : drive_((::setenv("TEST_TMPDIR", folder.c_str(), 1), "fuzz")) {
        for (int frame = 0; frame < 3; ++frame) {
            const std::string whole = test::read_text(drive_.scan(frame));
            std::string some;
            for (std::size_t at = 0; at + 16 <= whole.size(); at += 7 * 16) some += whole.substr(at, 16);
            put(drive_.scan(frame), some);
        }
        put(drive_.file("poses.txt"), "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n1 0 0 2 0 1 0 0 0 0 1 0\n");
        for (int frame = 0; frame < 3; ++frame) {
            fs::create_directories(odometry() / "velodyne");
            put(odometry() / "velodyne" / fmt::format("{:06d}.bin", frame), contents(drive_.scan(frame)));
        }
        put(odometry() / "calib.txt", "P0: 1 0 0 0 0 1 0 0 0 0 1 0\nTr: 0 -1 0 0 0 0 -1 -0.1 1 0 0 -0.3\n");
        put(odometry() / "times.txt", "0.0e+00\n1.0e-01\n2.0e-01\n");
        put(odometry() / "poses.txt", contents(drive_.file("poses.txt")));
        files_ = {drive_.file("velodyne_points/timestamps.txt"),
                  drive_.file("velodyne_points/timestamps_start.txt"),
                  drive_.file("velodyne_points/timestamps_end.txt"),
                  drive_.file("oxts/data/0000000000.txt"),
                  drive_.file("oxts/data/0000000001.txt"),
                  drive_.calibration(),
                  drive_.file("tracklet_labels.xml"),
                  drive_.file("poses.txt"),
                  drive_.scan(0),
                  drive_.scan(2),
                  odometry() / "calib.txt",
                  odometry() / "times.txt",
                  odometry() / "poses.txt",
                  odometry() / "velodyne/000000.bin"};
        for (const fs::path& file : files_) usual_.push_back(contents(file));
    }

    std::size_t size() const { return files_.size(); }
    const std::string& usual(std::size_t file) const { return usual_[file]; }
    const fs::path& folder() const { return drive_.folder; }
    fs::path scan() const { return drive_.scan(0); }
    fs::path odometry() const { return drive_.file("odometry"); }
    fs::path poses() const { return drive_.file("poses.txt"); }
    void write(std::size_t file, std::string_view bytes) const { put(files_[file], bytes); }

private:
    test::KittiDrive drive_;
    std::vector<fs::path> files_;
    std::vector<std::string> usual_;
};

const Drive& drive_in(const fs::path& folder) {
    static const Drive drive(folder);
    return drive;
}

/// Every reader of text, each alone.
void read_texts(const Drive& drive, unsigned options) {
    const std::vector<int> frames = kitti::list_scans(drive.folder() / "velodyne_points/data", 0, -1);
    std::exception_ptr failure;
    const auto attempt = [&](const std::function<void()>& read) {
        try {
            read();
        } catch (const std::exception&) {
            failure = std::current_exception();   // the last one is looked at; a crash is one at once
        }
    };
    PoseTrack track{{0.0, 0.1, 0.2}, std::vector<Pose>(3)};
    attempt([&] { kitti::read_period(drive.folder()); });
    attempt([&] { kitti::read_times(drive.folder() / "velodyne_points/timestamps.txt", frames); });
    if (options & kPosesFile) attempt([&] { kitti::read_pose_file(drive.poses(), frames); });
    else attempt([&] { kitti::read_oxts_poses(drive.folder(), frames); });
    attempt([&] { kitti::split_rings(kitti::read_scan(drive.scan())); });
    attempt([&] { kitti::read_tracklets(drive.folder() / "tracklet_labels.xml", frames, track); });
    if (failure) std::rethrow_exception(failure);
}

void read_whole(const Drive& drive, unsigned options) {
    DatasetOptions dataset;
    if (options & kPosesFile) dataset.poses_file = drive.poses();
    if (options & kNone) dataset.poses_file = kNoPoses;
    dataset.allow_missing_scans = !(options & kAllScans);
    if (!(options & kAllFrames)) dataset.frames = {0, 1};
    load_sequence("kitti_raw:" + drive.folder().string(), dataset);
}

void read_odometry(const Drive& drive, unsigned options) {
    DatasetOptions dataset;
    if (options & kNone) dataset.poses_file = kNoPoses;
    if (!(options & kAllFrames)) dataset.frames = {0, 1};
    load_sequence("kitti_odometry:" + drive.odometry().string(), dataset);
}

/// Writes what an input says, reads, and puts back what was there.
void read_changed(std::string_view input, const fs::path& folder, void (*read)(const Drive& drive, unsigned options)) {
    const Drive& drive = drive_in(folder);
    const unsigned options = input.empty() ? 0u : static_cast<unsigned char>(input[0]);
    std::vector<std::size_t> changed;
    for (std::size_t at = 1; at + 3 <= input.size();) {
        const auto byte = [&](std::size_t i) { return static_cast<std::size_t>(static_cast<unsigned char>(input[i])); };
        const std::size_t file = byte(at) % drive.size(), length = byte(at + 1) + 256 * byte(at + 2);
        const std::string_view bytes = input.substr(at + 3, length);
        drive.write(file, bytes);
        changed.push_back(file);
        at += 3 + bytes.size();
    }
    struct Restore {
        const Drive& drive;
        const std::vector<std::size_t>& changed;
        ~Restore() {
            for (const std::size_t file : changed) drive.write(file, drive.usual(file));
        }
    } restore{drive, changed};
    read(drive, options);
}

/// Each file by itself.
std::vector<std::string> drive_seeds(const fs::path& folder) {
    const Drive& drive = drive_in(folder);
    std::vector<std::string> seeds;
    for (const unsigned options : {0u, kNone, kAllFrames}) seeds.emplace_back(1, static_cast<char>(options));
    for (std::size_t file = 0; file < drive.size(); ++file) {
        const std::string bytes = drive.usual(file).substr(0, 4096);   // the start of a scan, all of a text
        const std::string section =
            std::string(1, static_cast<char>(file)) + static_cast<char>(bytes.size() % 256) + static_cast<char>(bytes.size() / 256) + bytes;
        for (const unsigned options : {0u, kPosesFile}) seeds.push_back(static_cast<char>(options) + section);
    }
    return seeds;
}

}  // namespace

/// The whole drive takes a hundred times as long as its texts.
std::vector<Harness> drive_harnesses() {
    return {
        // a piece of a scan is none
        {"drive_texts", drive_seeds, [](std::string_view input, const fs::path& folder) { read_changed(input, folder, read_texts); },
         false},
        {"drive", drive_seeds, [](std::string_view input, const fs::path& folder) { read_changed(input, folder, read_whole); }, false},
        {"odometry", drive_seeds, [](std::string_view input, const fs::path& folder) { read_changed(input, folder, read_odometry); },
         false},
    };
}

}  // namespace relidar::fuzz
