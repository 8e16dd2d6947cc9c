// SPDX-License-Identifier: Apache-2.0
// Selects the reader of a dataset by its path. The table has one row per kind of dataset.
// To support a new kind, write a reader and add a row.
#include <relidar/log/checks.hpp>
#include <relidar/read/dataset.hpp>

#include <algorithm>
#include <cmath>
#include <utility>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/error.hpp>
#include <relidar/read/clouds.hpp>
#include "base/fail.hpp"
#include "base/files.hpp"
#include "base/parallel.hpp"
#include "log/checks/checks.hpp"
#include "read/files/dropped_ray.hpp"
#include "read/files/other_formats.hpp"
#include "read/files/point_table.hpp"
#include "read/readers.hpp"
#include "read/scans/pose_conventions.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

struct DatasetKind {
    const char* name;
    /// Files or folders, separated by blanks, any of which identifies this kind. "name*"
    /// matches a beginning, ".ending" files with this extension, also inside a folder.
    const char* marker;
    const char* describe;
    Log (*load)(const fs::path&, const DatasetOptions&);
    /// true if it contains several recordings; DatasetOptions::sequence selects one
    bool holds_drives = false;
};

constexpr DatasetKind kDatasetKinds[] = {
    {"argoverse2", "city_SE3_egovehicle.feather", "an Argoverse 2 log", load_argoverse2},
    {"kitti_raw", "velodyne_points", "a KITTI raw drive", load_kitti_raw},
    {"kitti_tracking", "label_02 training/label_02 tracking/training/label_02 velodyne/0000",
     "the layout of KITTI tracking", load_kitti_tracking, true},
    {"kitti_object", "label_2 training/label_2 lidar/training/label_2 calib/000000.txt",
     "the layout of KITTI object", load_kitti_object},
    {"kitti_odometry", "calib.txt velodyne/000000.bin", "a KITTI odometry sequence", load_odometry},
    {"kitti360", "data_3d_raw", "KITTI-360", load_kitti_360, true},
    {"waymo", ".tfrecord", "a segment of Waymo Open", load_waymo, true},
    {"nuscenes", "v1.*", "nuScenes or TruckScenes", load_nuscenes, true},
    {"lyft", "data/scene.json train_data/scene.json test_data/scene.json", "Lyft Level 5", load_nuscenes,
     true},
    {"t4", "annotation/scene.json", "a T4 dataset of TIER IV", load_nuscenes, true},
    {"boreas", "applanix", "a Boreas sequence", load_boreas},
    {"mulran", "global_pose.csv sensor_data/Ouster", "a MulRan sequence", load_mulran},
    {"once", "lidar_roof", "a ONCE sequence", load_once},
    {"ncore", ".zarr.itar .zarr .zmetadata.cbor.xz", "a sequence of NCore", load_ncore},
    {"folder", "sequence.json", "a plain folder", load_folder},
    {"synthetic", "street.toml", "a synthetic street", load_synthetic},
    {"rosbag", ".mcap .db3 .bag .mcap.zstd .db3.zstd metadata.yaml", "a ROS bag", load_ros_bag},
    {"pcap", ".pcap .pcapng .pcap.gz .pcapng.gz", "a capture of LiDAR packets", load_ros_bag},
};

std::vector<std::string> list_kind_names() {
    std::vector<std::string> names;
    for (const DatasetKind& kind : kDatasetKinds) names.emplace_back(kind.name);
    return names;
}

const DatasetKind& find_kind(const std::string& kind_name) {
    for (const DatasetKind& kind : kDatasetKinds)
        if (kind_name == kind.name) return kind;
    fail<UsageError>("the dataset kind '{}' is unknown{} (known: {})", kind_name,
                     did_you_mean(kind_name, list_kind_names(), "'"), fmt::join(list_kind_names(), ", "));
}

/// Returns true if a path contains a file with a name, with an ending (".bin"), or with a
/// beginning ("scan*"). A path of a file matches by its own ending.
bool contains_match(const fs::path& path, std::string_view file_name_pattern) {
    const bool is_ending = file_name_pattern.starts_with('.'),
               is_beginning = file_name_pattern.ends_with('*');
    if (!is_ending && !is_beginning) return does_path_exist(path / file_name_pattern);
    const auto matches = [&](const fs::path& file) {
        const std::string name = file.filename().string();
        if (is_ending) return name.ends_with(file_name_pattern);
        return name.starts_with(file_name_pattern.substr(0, file_name_pattern.size() - 1));
    };
    if (!does_path_exist(path)) return false;
    if (!fs::is_directory(path)) return is_ending && matches(path);
    return std::ranges::any_of(list_folder(path), matches);
}

/// Returns true if a path matches one of a kind's markers, which blanks separate.
bool is_of_kind(const fs::path& path, const DatasetKind& kind) {
    for (std::string_view left = kind.marker; !left.empty();) {
        const std::size_t end = std::min(left.find(' '), left.size());
        if (contains_match(path, left.substr(0, end))) return true;
        left.remove_prefix(std::min(end + 1, left.size()));
    }
    return false;
}

/// Throws a DataError if a folder, or its folder scans/, contains scans. The message
/// contains an example of the sequence.json that is missing.
void require_sequence_json(const fs::path& path) {
    const auto count_scans = [](const fs::path& folder) -> std::ptrdiff_t {
        std::error_code failed;
        if (!fs::is_directory(folder, failed)) return 0;
        return std::ranges::count_if(list_folder(folder), [](const fs::path& file) {
            return read::is_point_file(file) || read::is_image_file(file);
        });
    };
    const std::ptrdiff_t n_in_subfolder = count_scans(path / "scans");
    const bool has_subfolder = n_in_subfolder > 1;
    const std::ptrdiff_t n_scans = has_subfolder ? n_in_subfolder : count_scans(path);
    if (n_scans < 2) return;
    fail(R"({} contains {} scans but no sequence.json; write one next to {}, for example )"
         R"({{"format": "relidar log", "version": 1, "rate_hz": 10{}}})"
         R"(, and add poses.txt or use dataset.poses=none; see docs/datasets.md)",
         path.string(), n_scans, has_subfolder ? "the folder of the scans" : "them",
         has_subfolder ? "" : R"(, "lidars": [{"name": "lidar", "scans": "."}])");
}

/// Returns an error message that names the folder to use instead, for an odometry
/// log, a folder of drives, and a folder inside a drive. Otherwise an empty string.
/// @param expected_subfolder  subfolder that every drive has
std::string describe_mistake(const fs::path& folder, const std::string& expected_subfolder) {
    std::error_code failed;
    const auto has = [&](const char* name) { return fs::exists(folder / name, failed); };
    if ((has("velodyne") && (has("times.txt") || has("calib.txt"))) || has("sequences"))
        return "the folder is a KITTI odometry sequence with motion-compensated scans; expected also its "
               "file calib.txt, or the KITTI raw drive from which the sequence was made";
    // A folder above this one may be the dataset.
    for (fs::path above = fs::canonical(folder, failed).parent_path(); !failed && above.has_relative_path();
         above = above.parent_path())
        if (fs::exists(above / expected_subfolder, failed))
            return fmt::format("the folder is inside a dataset; use the folder of the dataset, {}",
                               above.string());
    // Subfolders may be datasets.
    std::vector<std::string> datasets;
    for (fs::directory_iterator entry(folder, failed), end; !failed && entry != end; entry.increment(failed))
        if (fs::exists(entry->path() / expected_subfolder, failed))
            datasets.push_back(entry->path().filename().string());
    if (datasets.empty()) return "";
    return fmt::format("the folder contains {} dataset{}; use the folder of one of them, such as {}",
                       datasets.size(), datasets.size() == 1 ? "" : "s",
                       (folder / *std::ranges::min_element(datasets)).string());
}

/// Calls visit(range_m) for all returns of a scan.
template <class Visit>
void visit_ranges(const Scan& scan, const Visit& visit) {
    for (const float range_m : scan.range_m) visit(range_m);
    for (const AdditionalReturns& second : scan.second_returns)
        for (const float range_m : second.range_m) visit(range_m);
}

/// Returns the largest range of all returns of a LiDAR, rounded up to metres. Returns 80
/// m if the LiDAR has no returns.
double farthest_return_m(const Log& log, int lidar_index) {
    // Larger ranges are ignored as errors, because no LiDAR on a vehicle measures them.
    constexpr float kMaxPlausibleRange_m = 1000.0f;
    constexpr double kWithoutReturns_m = 80.0;
    std::vector<float> farthest(log.frames.size(), 0.0f);  // [frames]
    parallel_for(int(farthest.size()), [&](int index) {
        const Frame& frame = log.frames[std::size_t(index)];
        if (frame.lidar != lidar_index) return;
        visit_ranges(frame.scan, [&](float range_m) {
            if (range_m <= kMaxPlausibleRange_m)
                farthest[std::size_t(index)] = std::max(farthest[std::size_t(index)], range_m);
        });
    });
    const float farthest_m = farthest.empty() ? 0.0f : *std::ranges::max_element(farthest);
    return farthest_m > 0.0f ? std::ceil(double(farthest_m)) : kWithoutReturns_m;
}

/// Sets unknown maximum ranges of LiDARs to the largest range in the log, with a note.
void fill_max_ranges(Log& log) {
    for (std::size_t l = 0; l < log.lidars.size(); ++l) {
        SpinningSensor& sensor = log.lidars[l].sensor;
        if (std::isfinite(sensor.max_range_m)) continue;
        sensor.max_range_m = farthest_return_m(log, int(l));
        const std::string& name = log.lidars[l].name;
        log.notes.push_back(
            fmt::format("maximum range{}: relidar uses the range of the farthest return, {} m, because the "
                        "limit of the sensor is unknown",
                        name.empty() ? "" : " of " + name, sensor.max_range_m));
    }
}

/// Numbers of returns that are nearer or farther than the limits, and of all returns.
struct RangeLimitCounts {
    std::size_t n_below_min = 0, n_above_max = 0, n_returns = 0;
    void add(const RangeLimitCounts& other) {
        n_below_min += other.n_below_min;
        n_above_max += other.n_above_max;
        n_returns += other.n_returns;
    }
    std::size_t n_outside() const { return n_below_min + n_above_max; }
};

/// Counts the returns of a scan that are nearer or farther than the range limits.
RangeLimitCounts count_outside(const Scan& scan, const RangeLimits& limits) {
    RangeLimitCounts counts;
    visit_ranges(scan, [&](float range_m) {
        if (range_m > 0.0f) ++counts.n_returns;
        if (range_m > 0.0f && double(range_m) < limits.min_m) ++counts.n_below_min;
        if (double(range_m) > limits.max_m) ++counts.n_above_max;
    });
    return counts;
}

/// Adds a note for the user about each LiDAR with returns outside its range limits.
/// @param counts_of_frames  [frames] numbers of near, far and all returns in each frame
/// @throws DataError if all returns of the log are outside the limits
void note_dropped(Log& log, const std::vector<RangeLimitCounts>& counts_of_frames) {
    RangeLimitCounts all;
    for (std::size_t l = 0; l < log.lidars.size(); ++l) {
        RangeLimitCounts counts;
        for (std::size_t i = 0; i < counts_of_frames.size(); ++i)
            if (log.frames[i].lidar == int(l)) counts.add(counts_of_frames[i]);
        all.add(counts);
        if (counts.n_outside() == 0) continue;
        const Lidar& lidar = log.lidars[l];
        std::vector<std::string> reasons;
        if (counts.n_above_max > 0)
            reasons.push_back(
                fmt::format("{} returns are beyond {} m", counts.n_above_max, lidar.sensor.max_range_m));
        if (counts.n_below_min > 0)
            reasons.push_back(
                fmt::format("{} returns are nearer than {} m", counts.n_below_min, lidar.sensor.min_range_m));
        log.notes.push_back(fmt::format(
            "range{}: {} of {} returns ({:.3g} %) are read as dropped rays: {}",
            lidar.name.empty() ? "" : " of " + lidar.name, counts.n_outside(), counts.n_returns,
            100.0 * double(counts.n_outside()) / double(counts.n_returns), fmt::join(reasons, " and ")));
    }
    if (all.n_returns > 0 && all.n_outside() == all.n_returns)
        fail(
            "{}: none of its {} returns is within the range limits; change dataset.min_range_m or "
            "dataset.max_range_m ({})",
            log.source, all.n_returns, log.notes.back().text);  // a note from above
}

/// Sets the range limits that the user requested for all LiDARs. Turns returns outside
/// the limits into dropped rays.
void apply_range_limits(Log& log, const RangeLimits& requested_limits) {
    fill_max_ranges(log);
    for (Lidar& lidar : log.lidars) {
        const RangeLimits limits = intersect(lidar.sensor.range_limits(), requested_limits);
        lidar.sensor.min_range_m = limits.min_m;
        lidar.sensor.max_range_m = limits.max_m;
    }
    std::vector<RangeLimitCounts> counts(log.frames.size());
    parallel_for(int(counts.size()), [&](int index) {
        Frame& frame = log.frames[std::size_t(index)];
        const RangeLimits limits = log.lidar_of(frame).sensor.range_limits();
        counts[std::size_t(index)] = count_outside(frame.scan, limits);
        limit_ranges(frame.scan, limits);
    });
    note_dropped(log, counts);
}

/// Returns for each LiDAR whether it has one of the names. LiDARs that share a topic have
/// the names TOPIC:ID, and the name of the topic selects all of them.
/// @throws UsageError if no LiDAR has a name
std::vector<bool> find_kept_lidars(const Log& log, const std::vector<std::string>& lidar_names) {
    std::vector<bool> is_kept(log.lidars.size());
    for (const std::string& name : lidar_names) {
        bool is_found = false;
        for (std::size_t l = 0; l < is_kept.size(); ++l) {
            const std::string& lidar = log.lidars[l].name;
            if (lidar == name || lidar.starts_with(name + ":")) is_kept[l] = is_found = true;
        }
        // Throws for an unknown name. An empty name means the first LiDAR.
        if (!is_found) is_kept[std::size_t(find_lidar(log, name))] = true;
    }
    return is_kept;
}

/// Keeps only the named LiDARs and their frames and poses.
void keep_lidars(Log& log, const std::vector<std::string>& lidar_names) {
    const std::vector<bool> is_kept = find_kept_lidars(log, lidar_names);
    std::vector<Lidar> remaining_lidars;
    std::vector<int> new_index_of_lidar;  // -1: removed
    std::vector<std::string> left_out;
    for (std::size_t l = 0; l < is_kept.size(); ++l) {
        new_index_of_lidar.push_back(is_kept[l] ? int(remaining_lidars.size()) : -1);
        if (is_kept[l]) remaining_lidars.push_back(std::move(log.lidars[l]));
        else left_out.push_back(log.lidars[l].name);
    }
    std::erase_if(log.frames,
                  [&](const Frame& frame) { return new_index_of_lidar[std::size_t(frame.lidar)] < 0; });
    if (log.frames.empty())
        fail<UsageError>(
            "dataset.lidars: the selected frames contain no scan of {}; select another LiDAR or other frames",
            fmt::join(lidar_names, ", "));
    PoseTrack track;  // one pose per time of the remaining frames, which are sorted by time
    for (Frame& frame : log.frames) {
        frame.lidar = new_index_of_lidar[std::size_t(frame.lidar)];
        if (!track.time_s.empty() && track.time_s.back() == frame.time_s) continue;
        track.append(frame.time_s, log.world_from_vehicle.pose_at(frame.time_s));
    }
    log.lidars = std::move(remaining_lidars);
    log.world_from_vehicle = std::move(track);
    if (!left_out.empty())
        log.notes.push_back(
            fmt::format("these LiDARs of the log are not read: {}", fmt::join(left_out, ", ")));
}

/// Splits a text of the form "kind:path". Returns an empty kind if the text is only a
/// path. An existing path may contain a colon.
std::pair<std::string, fs::path> split_dataset(const std::string& dataset) {
    std::error_code failed;
    const std::size_t colon = dataset.find(':');
    const bool has_kind =
        colon != std::string::npos && dataset.find('/') > colon && !fs::exists(dataset, failed);
    return has_kind ? std::pair(dataset.substr(0, colon), fs::path(dataset.substr(colon + 1)))
                    : std::pair(std::string(), fs::path(dataset));
}

/// Returns the kind of a dataset.
/// @param requested_drive  recording (drive) that the user requested; may be empty
/// @throws UsageError if a drive is requested but the dataset contains only one drive
const DatasetKind& kind_of_path(const std::string& dataset, const std::string& requested_drive) {
    const auto [kind, path] = split_dataset(dataset);
    const std::string name = kind.empty() ? detect_kind(path) : kind;
    const DatasetKind& reader = find_kind(name);
    if (!requested_drive.empty() && !reader.holds_drives)
        fail<UsageError>(
            "dataset.sequence: found '{}', but {} is a single drive; do not set dataset.sequence",
            quote(requested_drive), reader.describe);
    return reader;
}

/// Adds a note that names the conventions that are guesses.
void note_guesses(Log& log) {
    std::vector<std::string> guesses;
    for (const UsedConvention& used : log.conventions_used)
        if (used.from.starts_with("guess: ")) guesses.push_back(used.name + " " + used.value);
    if (!guesses.empty())
        log.notes.push_back({kGuessesNote, -1,
                             fmt::format("these conventions are guesses: {}; `relidar info` tells why, and "
                                         "which settings change them",
                                         fmt::join(guesses, ", "))});
}

/// Estimates two values for each frame: the start of the sweep, and how much the head
/// azimuths deviate from even rotation.
void estimate_sweeps(Log& log) {
    std::vector<RayTable> nominal;  // [LiDARs] rays at even rotation; empty if it does not spin
    for (const Lidar& lidar : log.lidars)
        nominal.push_back(lidar.pattern ? RayTable{} : make_lidar_rays(lidar, 0.0));
    parallel_for(int(log.frames.size()), [&](int index) {
        Frame& frame = log.frames[std::size_t(index)];
        frame.start = find_sweep_start(frame.scan.rays, log.lidar_of(frame));
        frame.azimuth_shift_rad =
            measure_shifts_rad(frame.scan, log.lidar_of(frame).sensor, nominal[std::size_t(frame.lidar)]);
    });
}

}  // namespace

bool is_dataset(const fs::path& path) {
    try {
        return std::any_of(std::begin(kDatasetKinds), std::end(kDatasetKinds),
                           [&](const DatasetKind& kind) { return is_of_kind(path, kind); });
    } catch (const DataError&) {
        return false;  // the path cannot be read
    }
}

std::string detect_kind(const fs::path& path) {
    std::error_code failed;
    if (!fs::is_regular_file(path, failed)) require_folder(path, "a dataset");
    std::string supported_formats;
    for (const DatasetKind& kind : kDatasetKinds) {
        if (is_of_kind(path, kind)) return kind.name;
        supported_formats +=
            fmt::format("{}{} ({})", supported_formats.empty() ? "" : ", ", kind.describe, kind.marker);
    }
    // The path is no known dataset. Each check fails with a reason if it knows one, the
    // most specific first: missing file, other format, unsupported dataset, wrong folder.
    require_sequence_json(path);
    if (const std::string other = describe_format(path); !other.empty()) fail("{}: {}", path.string(), other);
    if (const std::string other = find_unsupported(path); !other.empty())
        fail("{} is not a dataset: {}", path.string(), other);
    for (const DatasetKind& kind : kDatasetKinds) {
        const std::string mistake = describe_mistake(path, kind.marker);
        if (!mistake.empty()) fail("{} is not a dataset: {}", path.string(), mistake);
    }
    fail("{} is not a dataset of a known format, expected one of: {}", path.string(), supported_formats);
}

std::string absolute_dataset(const std::string& dataset) {
    const auto [kind, path] = split_dataset(dataset);
    if (path.empty()) return dataset;
    // The result has no trailing slash.
    const std::string absolute = (fs::absolute(path) / "").lexically_normal().parent_path().string();
    return kind.empty() ? absolute : kind + ":" + absolute;
}

Log load_log(const std::string& dataset, const DatasetOptions& options) {
    const FrameRange& range = options.frames;
    if (range.begin < 0 || range.end < -1 || (range.end != -1 && range.begin >= range.end))
        fail<UsageError>("the frame range {}:{} is empty, expected a:b with 0 <= a < b", range.begin,
                         range.end);
    if (!(options.min_range_m >= 0.0 && options.max_range_m > options.min_range_m))
        fail<UsageError>(
            "the range limits are {} to {} m, expected 0 <= dataset.min_range_m < dataset.max_range_m",
            options.min_range_m, options.max_range_m);
    Log log = kind_of_path(dataset, options.sequence).load(split_dataset(dataset).second, options);
    log.rolling_shutter = log.rolling_shutter && options.rolling_shutter;
    check_log(log);
    // Other LiDARs are removed first, so that the steps below do not process them. Range
    // limits are applied after far markers are removed, because a far marker is not a
    // maximum range.
    if (!options.lidars.empty()) keep_lidars(log, options.lidars);
    if (options.poses_file != kNoPoses) read::fix_inverted_poses(log, options.conventions);
    estimate_sweeps(log);
    remove_drop_markers(log);
    apply_range_limits(log, {options.min_range_m, options.max_range_m});
    checks::correct_boxes(log, options.conventions);
    read::check_settings_used(log, options.conventions);
    checks::remove_ego_boxes(log);
    checks::note_faults(log);
    note_guesses(log);
    return log;
}

}  // namespace relidar
