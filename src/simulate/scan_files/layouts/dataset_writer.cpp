// SPDX-License-Identifier: Apache-2.0
// Adds a sequence to a data set: the list of sequences in dataset.json, the split into
// training and validation, and README.md.
#include <relidar/simulate/dataset_layouts.hpp>

#include <algorithm>
#include <fstream>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/base/files.hpp>
#include "base/bytes.hpp"
#include "base/fail.hpp"
#include "base/text_hash.hpp"
#include "simulate/scan_files/layouts/layout.hpp"

namespace relidar::layouts {
namespace {

namespace fs = std::filesystem;

constexpr const char* kIndexFormat = "relidar data set";

struct LayoutKind {
    const char* name;
    std::unique_ptr<LayoutWriter> (*make)(SequencePlace, const std::vector<DatasetSensor>&,
                                          const DatasetView&);
    Camera (*make_camera)();  ///< null for a layout without pictures
};
constexpr LayoutKind kLayouts[] = {{"kitti", make_kitti_writer, kitti_camera},
                                   {"nuscenes", make_nuscenes_writer, nuscenes_camera},
                                   {"openlabel", make_openlabel_writer, nullptr},
                                   {"custom", make_custom_writer, nullptr}};

/// Reads the list of sequences of a data set.
/// @return no value if the folder has no such list
/// @throws UsageError if the file is not such a list
std::optional<DatasetIndex> read_index(const fs::path& folder) {
    const fs::path file = folder / kDatasetIndex;
    std::error_code failed;
    if (!fs::exists(file, failed)) return std::nullopt;
    try {
        std::ifstream stream(file);
        const Json json = Json::parse(stream);
        if (json.at("format") == kIndexFormat) {
            DatasetIndex index{json.at("layout"), {}};
            for (const Json& sequence : json.at("sequences"))
                index.sequences.push_back(
                    {sequence.at("key"), sequence.at("frames"), sequence.at("settings")});
            return index;
        }
    } catch (const Json::exception&) {
        // The text is no JSON, or has other members.
    }
    fail<UsageError>("{}: found no list of sequences, expected a data set of relidar", file.string());
}

/// Reads the index of a data set. For a new folder, returns an index without sequences.
/// @throws UsageError if the layout is unknown or is not that of the data set, or if the
/// folder has other files
DatasetIndex open_index(const fs::path& folder, const std::string& layout) {
    const std::vector<std::string> names = list_layouts();
    if (std::ranges::find(names, layout) == names.end())
        fail<UsageError>("--layout: \"{}\" is unknown{} (known layouts: {})", layout,
                         did_you_mean(layout, names), fmt::join(names, ", "));
    if (std::optional<DatasetIndex> index = read_index(folder)) {
        if (index->layout == layout) return std::move(*index);
        fail<UsageError>(
            "--layout {}: {} is a data set with the layout {}; expected the same layout or a new folder",
            layout, folder.string(), index->layout);
    }
    // Hidden files do not matter. A missing folder has no files and gives no error.
    std::error_code missing;
    for (const auto& entry : fs::directory_iterator(folder, missing))
        if (const std::string name = entry.path().filename().string(); !name.starts_with('.'))
            fail<UsageError>("--layout {}: found {} in {}, expected a new folder or a data set of relidar",
                             layout, name, folder.string());
    return {layout, {}};
}

/// Returns the split of a sequence. If the layout lists frames, sequence 0 is in both.
std::string describe_split(const DatasetIndex& index, std::size_t sequence) {
    if (index.is_validation(sequence)) return "val";
    const int n_frames = index.sequences[sequence].n_frames, first = first_val_frame(sequence, n_frames);
    if (first == n_frames || index.layout == "openlabel") return "train";
    return fmt::format("train; val from frame {}", first);
}

/// Writes the list of sequences, which read_index() reads when another sequence is added.
void write_index(const fs::path& folder, const DatasetIndex& index) {
    Json sequences = Json::array();
    for (std::size_t s = 0; s < index.sequences.size(); ++s) {
        const DatasetIndex::Sequence& sequence = index.sequences[s];
        sequences.push_back({{"key", sequence.key},
                             {"frames", sequence.n_frames},
                             {"split", describe_split(index, s)},
                             {"settings", sequence.settings}});
    }
    const Json json = {{"format", kIndexFormat}, {"layout", index.layout}, {"sequences", sequences}};
    write_bytes(folder / kDatasetIndex, json.dump(1) + "\n");
}

std::string describe_pose(const Pose& pose) {
    const glm::dvec3& t = pose.translation;
    const glm::dquat& q = pose.rotation;
    return fmt::format("{},{},{} {},{},{},{}", t.x, t.y, t.z, q.w, q.x, q.y, q.z);
}

const char* name_of(DatasetFov fov) {
    constexpr const char* kNames[] = {"all", "camera", "labels"};
    return kNames[static_cast<int>(fov)];
}

std::string describe_camera(const Camera& camera, bool has_pictures) {
    return fmt::format("{} {} x {}, focal length {} {}, centre {} {}, at {}{}", camera.name, camera.columns,
                       camera.rows, camera.focal_x_px, camera.focal_y_px, camera.centre_x_px,
                       camera.centre_y_px, describe_pose(camera.rig_from_camera),
                       has_pictures ? "" : "; pictures are black");
}

/// Returns everything that decides the data of a sequence, for users and as its identity:
/// equal settings give equal data. Rays, tracks and settings are long, and are only
/// compared, so a hash stands for each of them.
Json describe_sequence(const std::vector<DatasetSensor>& sensors, const DatasetView& view,
                       const std::vector<double>& times_s) {
    // All sensors have the same run, actors and settings.
    const ScanOutputOptions& options = sensors.front().options;
    std::string sensor_poses, rays, tracks, settings;
    for (const DatasetSensor& sensor : sensors) {
        rays += sensor.description;
        sensor_poses +=
            fmt::format("{}{} {} at {}", sensor_poses.empty() ? "" : "; ", sensor.options.frame_id,
                        sensor.options.sensor, describe_pose(sensor.rig_from_sensor));
    }
    for (const auto* boxes : {&options.actors, &options.standing})
        for (const BoxTrack& box : *boxes) {
            tracks += box.id + box.category;
            for (const Pose& pose : box.world_from_box.pose) tracks += describe_pose(pose);
        }
    for (const ConfigKey& key : list_config_keys(options.config)) settings += key.key + key.value + "\n";
    Json json = {{"run", options.run},
                 {"source", file_name_of(options.config.dataset.path)},
                 {"licence", "unknown: see the source"},
                 {"relidar", RELIDAR_VERSION},
                 {"sensors (x,y,z w,x,y,z)", sensor_poses},
                 {"offset", describe_pose(options.offset)},
                 {"trajectory", options.trajectory},
                 {"rays", make_token(rays)},
                 {"only", options.only},
                 {"seed", options.sample ? Json(*options.sample) : Json()},
                 {"weather", format_weather(options.weather)},
                 {"tracks", make_token(tracks)},
                 {"settings", make_token(settings)},
                 {"times_s", times_s}};
    if (view.camera) json["camera"] = describe_camera(*view.camera, view.has_pictures);
    json["fov"] = name_of(view.fov);
    if (!view.class_names.empty()) json["classes"] = view.class_names;
    if (view.labelled)
        json["labels are complete"] = fmt::format(
            "from {:.1f} to {:.1f} degrees of azimuth, left is positive",
            view.labelled->azimuth.right_rad * 180.0 / kPi, view.labelled->azimuth.left_rad * 180.0 / kPi);
    return json;
}

/// Fills in the camera of the layout.
/// @throws UsageError if the view needs a camera or labels that are missing
DatasetView complete_view(DatasetView view, const std::string& layout) {
    if (!view.camera) view.camera = find_layout_camera(layout);
    if (view.fov == DatasetFov::camera && !view.camera)
        fail<UsageError>("--fov camera: found no camera, expected one, because the layout {} has none",
                         layout);
    return view;
}

/// What users of the layout nuscenes must know.
constexpr const char* kNuscenesNotes =
    "\nThe scenes have names of nuScenes, although they are none of its scenes: OpenPCDet, mmdet3d and the "
    "development kit select the scenes of a split by the official names. Only the pictures of CAM_FRONT are "
    "rendered. Those of the other cameras are black; mmdet3d needs their records.\n";

/// Writes a description for users: licence, split, and the settings of each sequence.
void write_readme(const fs::path& folder, const DatasetIndex& index) {
    std::string text = fmt::format(
        "# Simulated LiDAR data\n\n"
        "Written by relidar {} (`relidar render --layout {}`). The points are simulated from the recorded "
        "logs below, so the licence of each log applies. Objects have a box if a sensor sees them and a "
        "point is in the box. All points of a frame have the same reference time.\n\n"
        "The fov of a sequence is all, camera (points and objects in the picture), or labels (where the "
        "labels of the log are complete). With all, objects outside the picture have the image box "
        "0 0 0 0 in the layout kitti, and objects where labels are not complete may lack a box.\n\n"
        "Validation split: the sequences 1, 6, 11, ..., and the last fifth of sequence 0 if the layout lists "
        "frames. So a frame never changes its split when sequences are added.\n{}",
        RELIDAR_VERSION, index.layout, index.layout == "nuscenes" ? kNuscenesNotes : "");
    for (std::size_t s = 0; s < index.sequences.size(); ++s) {
        const Json& settings = index.sequences[s].settings;
        text += fmt::format("\n## Sequence {}\n\n- frames: {}\n- split: {}\n", s, index.sequences[s].n_frames,
                            describe_split(index, s));
        if (index.layout == "nuscenes")
            for (const SceneStart& scene : list_scenes(s, index.sequences[s].n_frames))
                text += fmt::format("- {} from frame {}\n", scene.name, scene.first_frame);
        for (const auto& [key, value] : settings.items())
            if (key != "times_s")
                text += fmt::format("- {}: {}\n", key,
                                    value.is_string() ? value.get<std::string>() : value.dump());
    }
    write_bytes(folder / "README.md", text);
}

/// Adds a sequence at the end of the index, or replaces the sequence with the same
/// settings in place. The same settings give the same key.
/// @throws UsageError if there is such a sequence and `replace` is false
SequencePlace place_sequence(DatasetIndex& index, DatasetIndex::Sequence sequence, const fs::path& folder,
                             bool replace) {
    const auto same = std::ranges::find(index.sequences, sequence.key, &DatasetIndex::Sequence::key);
    SequencePlace place{.folder = folder,
                        .number = std::size_t(same - index.sequences.begin()),
                        .first_frame = 0,
                        .n_frames = sequence.n_frames,
                        .key = sequence.key,
                        .is_new = same == index.sequences.end()};
    for (auto earlier = index.sequences.begin(); earlier != same; ++earlier)
        place.first_frame += earlier->n_frames;
    if (!place.is_new && !replace)
        fail<UsageError>(
            "--out {}: sequence {} has the same run, sensors and settings; expected another seed, or --force "
            "to write it again",
            folder.string(), place.number);
    if (place.is_new) index.sequences.push_back(std::move(sequence));
    else *same = std::move(sequence);
    return place;
}

}  // namespace

int first_val_frame(std::size_t sequence, int n_frames) {
    constexpr int kFold = 5;
    if (sequence == 0 && n_frames > 1) return n_frames - std::max(1, n_frames / kFold);
    return sequence % kFold == 1 ? 0 : n_frames;
}

bool DatasetIndex::is_validation(std::size_t sequence) const { return is_validation(sequence, 0); }

bool DatasetIndex::is_validation(std::size_t sequence, int frame) const {
    return frame >= first_val_frame(sequence, sequences[sequence].n_frames);
}

void write_bytes(const fs::path& path, const std::string& bytes) {
    std::error_code failed;  // then the file cannot be written
    fs::create_directories(path.parent_path(), failed);
    write_text_file(path, bytes);
}

std::string pack_rig_points(const LabelledFrame& frame, const std::vector<DatasetSensor>& sensors) {
    std::string bytes;
    for (std::size_t s = 0; s < sensors.size(); ++s)
        for (std::size_t i = 0; i < frame.clouds[s].size(); ++i) {
            const glm::dvec3 point(frame.clouds[s].position_m[i]);
            append_raw(bytes, glm::vec3(sensors[s].rig_from_sensor * point));
            append_raw(bytes, frame.clouds[s].intensity[i]);
        }
    return bytes;
}

void write_rig_points(const fs::path& path, const LabelledFrame& frame,
                      const std::vector<DatasetSensor>& sensors) {
    write_bytes(path, pack_rig_points(frame, sensors));
}

std::string make_token(const std::string& text, std::size_t n_digits) {
    std::string token;
    for (const std::uint64_t hash : hash_text_twice(text)) token += fmt::format("{:016x}", hash);
    return token.substr(0, n_digits);
}

}  // namespace relidar::layouts

namespace relidar {

namespace fs = std::filesystem;
using namespace layouts;

struct DatasetSequenceWriter::Impl {
    fs::path folder;
    std::vector<DatasetSensor> sensors;
    DatasetView view;
    DatasetIndex index;  ///< with the new sequence
    std::unique_ptr<LayoutWriter> writer = {};
    std::size_t n_written = 0;
};

std::vector<std::string> list_layouts() {
    std::vector<std::string> names;
    for (const LayoutKind& kind : kLayouts) names.emplace_back(kind.name);
    return names;
}

std::optional<Camera> find_layout_camera(const std::string& layout) {
    const auto kind = std::ranges::find(kLayouts, layout, &LayoutKind::name);
    if (kind == std::end(kLayouts) || !kind->make_camera) return {};
    return kind->make_camera();
}

void check_dataset_folder(const fs::path& folder, const std::string& layout) { open_index(folder, layout); }

DatasetSequenceWriter::DatasetSequenceWriter(fs::path folder, const std::string& layout,
                                             std::vector<DatasetSensor> sensors, std::vector<double> times_s,
                                             bool replace, DatasetView view)
    : impl_(std::make_shared<Impl>(Impl{.folder = folder,
                                        .sensors = std::move(sensors),
                                        .view = complete_view(std::move(view), layout),
                                        .index = open_index(folder, layout)})) {
    DatasetIndex& index = impl_->index;
    // Writes the index of a new folder before any frame. If this sequence is interrupted,
    // open_index() then still accepts the folder.
    if (index.sequences.empty()) write_index(folder, index);
    const Json settings = describe_sequence(impl_->sensors, impl_->view, times_s);
    const SequencePlace place = place_sequence(
        index, {.key = make_token(settings.dump()), .n_frames = int(times_s.size()), .settings = settings},
        folder, replace);
    const auto kind = std::ranges::find(kLayouts, layout, &LayoutKind::name);
    impl_->writer = kind->make(place, impl_->sensors, impl_->view);
}

void DatasetSequenceWriter::write_scans(std::span<const RenderedScan> scans, const RenderedScan* picture) {
    if (scans.size() != impl_->sensors.size())
        fail<UsageError>("cannot write a data set: found {} scans, expected {}, one for each sensor",
                         scans.size(), impl_->sensors.size());
    LabelledFrame frame = label_frame(scans, impl_->sensors, impl_->view, impl_->n_written++);
    name_objects(frame, impl_->index.layout, impl_->view.class_names);
    frame.picture = picture;
    impl_->writer->write_frame(frame);
}

void DatasetSequenceWriter::finish() {
    impl_->writer->finish(impl_->index);
    write_readme(impl_->folder, impl_->index);
    write_index(impl_->folder, impl_->index);
}

}  // namespace relidar
