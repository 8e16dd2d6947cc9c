// SPDX-License-Identifier: Apache-2.0
// Points and object boxes of a data set's frame, and the interface of layouts.
#pragma once

#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <relidar/read/points.hpp>
#include <relidar/scene/labels.hpp>
#include <relidar/simulate/dataset_layouts.hpp>
#include <relidar/simulate/render.hpp>

namespace relidar::layouts {

/// Names of a class of objects. Numbers are those of SemanticKITTI.
struct ObjectNames {
    const char* kitti;
    const char* nuscenes;
    int still_class, moving_class;
};

/// Returns the names for a class name of any dataset.
ObjectNames find_object_names(const std::string& category);

/// Returns the name of nuScenes. Keeps a name that already has the form of nuScenes.
std::string nuscenes_category(const std::string& category);

using Json = nlohmann::ordered_json;

struct LabelledObject {
    std::string track, category;               ///< category: label_of() the object
    ObjectClass object_class{};                ///< class_of() the object
    int number = 0;                            ///< number of the track in the sequence, from 0
    bool is_static = false;                    ///< true for an object that is part of the background
    bool moves = false;                        ///< true if the object moves at any time
    glm::dvec3 size_m{0.0};                    ///< length, width and height
    Pose world_from_box = {};                  ///< at the time at which the sensor faces the object
    std::size_t n_points = 0;                  ///< ActorBox::n_points, of all sensors
    std::optional<double> visible_share = {};  ///< of the sensor that sees most
    double truncated = 0.0;                    ///< share of the box outside the field of view of every sensor
};

struct LabelledFrame {
    std::size_t index = 0;  ///< in the sequence
    double time_s = 0.0;
    std::int64_t stamp_ns = 0;
    Pose world_from_rig = {};
    std::vector<LidarPoints> clouds = {};  ///< [sensors] deskewed, each in the frame of its sensor
    std::vector<int> n_rings = {};         ///< [sensors]
    std::vector<LabelledObject> objects = {};
};

LabelledFrame label_frame(std::span<const RenderedScan> scans, const std::vector<DatasetSensor>& sensors,
                          std::size_t index);

/// The list of sequences in the file dataset.json.
struct DatasetIndex {
    struct Sequence {
        std::string key;  ///< hash of all settings of the sequence
        int n_frames = 0;
        Json settings;  ///< texts for users
    };
    std::string layout;
    std::vector<Sequence> sequences;

    /// Returns true for the sequences of the validation split.
    bool is_validation(std::size_t sequence) const;
    /// Returns true for the frames of the validation split.
    bool is_validation(std::size_t sequence, int frame) const;
};
/// Returns the first frame of a sequence that is in the validation split, like all later
/// ones; `n_frames` if there is none. The split has the sequences 1, 6, 11, ... and the
/// last fifth of sequence 0, so that a frame never changes its split when sequences are
/// added.
int first_val_frame(std::size_t sequence, int n_frames);

/// Where a sequence is stored in a data set.
struct SequencePlace {
    std::filesystem::path folder;  ///< folder of the data set
    std::size_t number;            ///< number of the sequence
    int first_frame, n_frames;     ///< first_frame counts the frames of all earlier sequences
    std::string key;               ///< DatasetIndex::Sequence::key
    /// False if the sequence replaces one with the same frames. Its files are overwritten
    /// one by one, so that an interruption leaves it complete.
    bool is_new;
};

class LayoutWriter {
public:
    /// @param sensors  must outlive the writer
    LayoutWriter(SequencePlace place, const std::vector<DatasetSensor>& sensors)
        : place_(std::move(place)), sensors_(sensors) {}
    virtual ~LayoutWriter() = default;
    virtual void write_frame(const LabelledFrame& frame) = 0;
    /// Writes the files that describe the sequence, and those of the data set.
    virtual void finish(const DatasetIndex& index) = 0;

protected:
    const SequencePlace place_;
    const std::vector<DatasetSensor>& sensors_;
};

std::unique_ptr<LayoutWriter> make_kitti_writer(SequencePlace place,
                                                const std::vector<DatasetSensor>& sensors);
std::unique_ptr<LayoutWriter> make_nuscenes_writer(SequencePlace place,
                                                   const std::vector<DatasetSensor>& sensors);
std::unique_ptr<LayoutWriter> make_openlabel_writer(SequencePlace place,
                                                    const std::vector<DatasetSensor>& sensors);
std::unique_ptr<LayoutWriter> make_custom_writer(SequencePlace place,
                                                 const std::vector<DatasetSensor>& sensors);

/// A scene of nuScenes: a part of a sequence in one split.
struct SceneStart {
    std::string name;
    int first_frame;
};
/// Returns the scenes of a sequence.
/// @throws UsageError if nuScenes does not have enough names
std::vector<SceneStart> list_scenes(std::size_t sequence, int n_frames);

/// Returns four floats for each point of all sensors: x, y, z in the frame of the rig,
/// intensity.
std::string pack_rig_points(const LabelledFrame& frame, const std::vector<DatasetSensor>& sensors);
/// Writes a KITTI .bin file with the points of all sensors, in the frame of the rig.
void write_rig_points(const std::filesystem::path& path, const LabelledFrame& frame,
                      const std::vector<DatasetSensor>& sensors);
/// Writes a file atomically. Creates its folder.
void write_bytes(const std::filesystem::path& path, const std::string& bytes);

/// Returns a hash as hexadecimal digits: FNV-1a from two start values.
/// @param n_digits  at most 32
std::string make_token(const std::string& text, std::size_t n_digits = 32);

/// Calibration of a camera in the frame of the rig: x right, y down, z forward. Its image
/// plane is at the distance 1.
inline constexpr const char* kVirtualCamera = "1 0 0 0 0 1 0 0 0 0 1 0";
inline constexpr const char* kCameraFromRig = "0 -1 0 0 0 0 -1 0 1 0 0 0";
/// Returns the lines of the cameras P0 to P3 in a calibration file.
std::string camera_lines();

}  // namespace relidar::layouts
