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

const ObjectNames& find_object_names(ObjectClass object_class);

using Json = nlohmann::ordered_json;

/// Rectangle of an object in the picture of the camera.
struct ImageBox {
    glm::dvec2 min_px{0.0}, max_px{0.0};  ///< clipped to the centres of the outermost pixels
    /// Share of the area of the full rectangle that is outside the picture.
    double truncated = 0.0;
};
/// Returns the rectangle around the corners of a box, clipped to the picture. Parts of
/// the box behind the camera do not count. Nothing if the rectangle is not in the
/// picture.
std::optional<ImageBox> project_box(const Camera& camera, const Pose& camera_from_box,
                                    const glm::dvec3& size_m);

struct LabelledObject {
    std::string track;
    ObjectClass object_class{};
    std::string label = {};                    ///< label_of() the object
    std::string name = {};                     ///< of the class in the layout; set by name_objects()
    int number = 0;                            ///< number of the track in the sequence, from 0
    bool is_static = false;                    ///< true for an object that is part of the background
    bool moves = false;                        ///< true if the object moves at any time
    glm::dvec3 size_m{0.0};                    ///< length, width and height
    Pose world_from_box = {};                  ///< at the time at which the sensor faces the object
    std::size_t n_points = 0;                  ///< ActorBox::n_points, of all sensors
    std::optional<double> visible_share = {};  ///< of the sensor that sees most
    std::optional<ImageBox> image_box = {};    ///< empty if the object is not in the picture
};

struct LabelledFrame {
    std::size_t index = 0;  ///< in the sequence
    double time_s = 0.0;
    std::int64_t stamp_ns = 0;
    Pose world_from_rig = {};
    std::vector<LidarPoints> clouds = {};  ///< [sensors] deskewed, each in the frame of its sensor
    std::vector<int> n_rings = {};         ///< [sensors]
    std::vector<LabelledObject> objects = {};
    /// Parts of the picture that may show objects without a label: boxes of the log that
    /// no ray hits, and what is outside the labelled sector.
    std::vector<ImageBox> unlabelled = {};
    const RenderedScan* picture = nullptr;  ///< null: the picture is black
};

/// The camera and the labelled sector of a data set at the time of a frame.
class FrameView {
public:
    /// @param view  must outlive this object
    /// @param frame  with its time and the pose of the rig
    FrameView(const DatasetView& view, const LabelledFrame& frame);
    /// Returns a copy of a scan in which rays that end outside DatasetView::fov have no
    /// return.
    RenderedScan cut_scan(const RenderedScan& scan, const Config& config) const;
    /// Returns the rectangle of an object in the picture.
    std::optional<ImageBox> find_image_box(const LabelledObject& object) const;
    /// Returns true if DatasetView::fov contains an object.
    bool has_label(const LabelledObject& object) const;
    /// Returns the parts of the picture outside the labelled sector.
    std::vector<ImageBox> unlabelled_parts() const;

private:
    const DatasetView& view_;
    const Pose world_from_camera_;  ///< identity without a camera
    const Pose lidar_from_world_;   ///< identity without a labelled sector

    bool contains(const glm::dvec3& world_m) const;
};

LabelledFrame label_frame(std::span<const RenderedScan> scans, const std::vector<DatasetSensor>& sensors,
                          const DatasetView& view, std::size_t index);

/// Sets the names of classes. Objects without a name become unlabelled.
/// @param chosen  names that the user has chosen
void name_objects(LabelledFrame& frame, const std::string& layout, const ClassNames& chosen);

/// Writes the gray picture of a frame as PNG. Creates its folder.
void write_picture(const std::filesystem::path& path, const Camera& camera, const RenderedScan* picture);
/// Writes the depth of a picture in the format of KITTI's depth benchmark.
void write_depth(const std::filesystem::path& path, const RenderedScan& picture);

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
    /// @param sensors, view  must outlive the writer
    LayoutWriter(SequencePlace place, const std::vector<DatasetSensor>& sensors, const DatasetView& view)
        : place_(std::move(place)), sensors_(sensors), view_(view) {}
    virtual ~LayoutWriter() = default;
    virtual void write_frame(const LabelledFrame& frame) = 0;
    /// Writes the files that describe the sequence, and those of the data set.
    virtual void finish(const DatasetIndex& index) = 0;

protected:
    const SequencePlace place_;
    const std::vector<DatasetSensor>& sensors_;
    const DatasetView& view_;

    /// Only for layouts with a default camera.
    const Camera& camera() const { return *view_.camera; }
};

std::unique_ptr<LayoutWriter> make_kitti_writer(SequencePlace place,
                                                const std::vector<DatasetSensor>& sensors,
                                                const DatasetView& view);
std::unique_ptr<LayoutWriter> make_nuscenes_writer(SequencePlace place,
                                                   const std::vector<DatasetSensor>& sensors,
                                                   const DatasetView& view);
std::unique_ptr<LayoutWriter> make_openlabel_writer(SequencePlace place,
                                                    const std::vector<DatasetSensor>& sensors,
                                                    const DatasetView& view);
std::unique_ptr<LayoutWriter> make_custom_writer(SequencePlace place,
                                                 const std::vector<DatasetSensor>& sensors,
                                                 const DatasetView& view);

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

}  // namespace relidar::layouts
