// SPDX-License-Identifier: Apache-2.0
// Writes rendered scans and the boxes of their objects as a data set for training, in a
// layout that other programs read.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <relidar/log/camera.hpp>
#include <relidar/simulate/scan_files.hpp>

namespace relidar {

/// Returns the names of all layouts.
std::vector<std::string> list_layouts();

/// File that lists the sequences of a data set.
inline constexpr const char* kDatasetIndex = "dataset.json";

/// A LiDAR of a data set.
struct DatasetSensor {
    ScanOutputOptions options;  ///< frame_id is the name of the sensor
    Pose rig_from_sensor;
    /// Everything else that decides the rays, for example the text of the sensor's file.
    /// Sequences that differ here are different sequences.
    std::string description = {};
};

/// Which points and objects of a frame are written.
enum class DatasetFov {
    all,
    camera,  ///< in the picture
    labels   ///< where the log has labels for all objects
};
/// Where the log has labels for all objects. Azimuths are in the frame of its LiDAR at
/// the time of each frame.
struct LabelledSector {
    AzimuthInterval azimuth;
    PoseTrack dataset_from_lidar;
};
/// Names of classes in a data set, by the name of a class (name_of(ObjectClass)) or by a
/// label of the log, which comes first. Objects with an empty name are left out.
using ClassNames = std::map<std::string, std::string>;
/// Reads pairs of names from a TOML or JSON file, such as {"Van": "Car", "Other": ""}.
/// @throws DataError if the file has something else, or a name has spaces
ClassNames read_class_names(const std::filesystem::path& path);

/// Camera, extent and names of classes of a sequence.
struct DatasetView {
    /// Camera of the pictures and of the image boxes, mounted on the rig of the data set.
    /// Empty: the camera of the layout (find_layout_camera()).
    std::optional<Camera> camera = {};
    bool has_pictures = false;  ///< false: pictures are black, and there is no depth
    DatasetFov fov = DatasetFov::all;
    std::optional<LabelledSector> labelled = {};  ///< empty: all round
    ClassNames class_names = {};
};
/// Returns true if frames have points where the labels of the log are not complete.
bool exceeds_labels(const DatasetView& view);
/// Returns the default camera of a layout, or nothing for a layout without pictures.
std::optional<Camera> find_layout_camera(const std::string& layout);

/// Checks a folder before long work starts.
/// @throws UsageError if a layout is unknown, or if the folder has other files or a data
/// set with another layout
void check_dataset_folder(const std::filesystem::path& folder, const std::string& layout);

/// Adds a sequence to a data set. An object has a box in a frame if a sensor sees the
/// object and at least one point is in the box. The box has the time at which the sensor
/// with the most points on the object faces it.
///   kitti      training/ and ImageSets/ of the object benchmark, tracking/training/ of
///              the tracking benchmark; points of all sensors, in the frame of the rig
///   nuscenes   v1.0-trainval/ and samples/; a scene, and a channel for each sensor and
///              for the camera
///   openlabel  sequences/NN/openlabel.json, with the points of all sensors and their
///              classes as in SemanticKITTI (velodyne/, labels/)
///   custom     points/, labels/ and ImageSets/ of OpenPCDet and mmdet3d
/// All points of a frame have the reference time of the scans (deskewed). dataset.json
/// lists the sequences. Files of an interrupted sequence are overwritten by the next one.
class DatasetSequenceWriter {
public:
    /// Makes a new folder a data set, and chooses the place of the sequence in it.
    /// @param times_s  times of all frames
    /// @param replace  whether a sequence with the same settings is replaced
    /// @throws UsageError if the data set has a sequence with the same settings, if the
    /// layout cannot store the sequence, if the view needs a camera or labels that are
    /// missing, and in the cases of check_dataset_folder()
    /// @throws DataError if the folder cannot be written
    DatasetSequenceWriter(std::filesystem::path folder, const std::string& layout,
                          std::vector<DatasetSensor> sensors, std::vector<double> times_s, bool replace,
                          DatasetView view = {});
    /// Writes the next frame.
    /// @param scans  a scan for each sensor, all at the same time
    /// @param picture  scan of camera_sensor() at this time. Null: the picture is black
    /// @throws DataError if a file cannot be written
    void write_scans(std::span<const RenderedScan> scans, const RenderedScan* picture = nullptr);
    /// Adds the sequence to the tables, splits and the README of the data set.
    void finish();

private:
    struct Impl;
    std::shared_ptr<Impl> impl_;
};

}  // namespace relidar
