// SPDX-License-Identifier: Apache-2.0
// Writes labels as ASAM OpenLABEL 1.0 (JSON), next to the points in the folders of
// SemanticKITTI: velodyne/, labels/, calib.txt, poses.txt and times.txt.
#include "simulate/scan_files/layouts/layout.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/scene/labels.hpp>
#include "base/bytes.hpp"
#include "log/classes/dataset_classes.hpp"
#include "simulate/scan_files/placed_scan.hpp"

namespace relidar::layouts {
namespace {

namespace fs = std::filesystem;

constexpr const char *kRig = "rig", *kWorld = "world", *kStream = "lidar";
constexpr std::uint32_t kOutlier = 1;  // SemanticKITTI's class of points that are no surface

Json transform_json(const Pose& pose) {
    const glm::dquat& q = pose.rotation;
    const glm::dvec3& t = pose.translation;
    return {{"quaternion", {q.x, q.y, q.z, q.w}}, {"translation", {t.x, t.y, t.z}}};
}

/// Returns the 12 numbers of the first three rows of a matrix.
std::string matrix_line(const Pose& pose) {
    const std::vector<double> matrix = scan_files::row_major(pose);
    return fmt::format("{}\n", fmt::join(matrix.begin(), matrix.begin() + 12, " "));
}

/// Computes the label of a point: its class in the low 16 bits, and in the high 16 bits
/// the number of its object, from 1.
class PointLabeller {
public:
    /// @param cloud  points of one sensor
    PointLabeller(const LabelledFrame& frame, const LidarPoints& cloud, const DatasetSensor& sensor)
        : frame_(frame),
          cloud_(cloud),
          options_(sensor.options),
          classes_(find_values<std::int32_t>(cloud.channels, "class")),
          sources_(find_values<std::int32_t>(cloud.channels, "source")),
          world_from_cloud_(frame.world_from_rig * sensor.rig_from_sensor) {
        for (const std::string& track : options_.instance_names) {
            const auto box = std::ranges::find(options_.actors, track, &BoxTrack::id);
            label_of_instance_.push_back(
                box == options_.actors.end()
                    ? 0u
                    : make_label(label_of(*box), box->is_moving(), int(box - options_.actors.begin())));
        }
    }
    std::uint32_t find_label(std::size_t point) const {
        // A cause other than a surface, for example rain.
        if (sources_ && (*sources_)[point] > 0) return kOutlier;
        const std::int32_t instance = cloud_.instance[point];
        // Instance 0 is the background.
        if (instance > 0) return label_of_instance_[std::size_t(instance)];
        const glm::dvec3 position = world_from_cloud_ * glm::dvec3(cloud_.position_m[point]);
        for (const LabelledObject& object : frame_.objects)  // standing objects are background
            if (object.is_static && is_on_object(inverse(object.world_from_box) * position, object.size_m))
                return make_label(object.category, false, object.number);
        const int surface = classes_ ? (*classes_)[point] : 0;
        return std::uint32_t(to_semantic_kitti(SurfaceClass(std::max(0, surface))));
    }

private:
    const LabelledFrame& frame_;
    const LidarPoints& cloud_;
    const ScanOutputOptions& options_;
    const std::vector<std::int32_t>*classes_, *sources_;
    const Pose world_from_cloud_;
    std::vector<std::uint32_t> label_of_instance_;

    static std::uint32_t make_label(const std::string& category, bool moves, int number) {
        const ObjectNames names = find_object_names(category);
        return std::uint32_t(number + 1) << 16 |
               std::uint32_t(moves ? names.moving_class : names.still_class);
    }
};

class OpenLabelWriter : public LayoutWriter {
public:
    OpenLabelWriter(SequencePlace place, const std::vector<DatasetSensor>& sensors, const DatasetView& view)
        : LayoutWriter(std::move(place), sensors, view),
          folder_(place_.folder / "sequences" / fmt::format("{:02}", place_.number)) {
        std::error_code failed;
        if (place_.is_new) fs::remove_all(folder_, failed);
    }

    void write_frame(const LabelledFrame& frame) override {
        const std::string name = fmt::format("{:06}", frame.index), points = "velodyne/" + name + ".bin";
        write_rig_points(folder_ / points, frame, sensors_);
        std::string labels;
        // The labels have the order of the points in write_rig_points().
        for (std::size_t s = 0; s < sensors_.size(); ++s) {
            const PointLabeller labeller(frame, frame.clouds[s], sensors_[s]);
            for (std::size_t i = 0; i < frame.clouds[s].size(); ++i)
                append_raw(labels, labeller.find_label(i));
        }
        write_bytes(folder_ / "labels" / (name + ".label"), labels);
        if (frame.index == 0) world_from_first_ = frame.world_from_rig;
        // Poses of the camera, relative to its first pose.
        const Pose camera_from_rig{glm::dquat(0.5, 0.5, -0.5, 0.5), glm::dvec3(0.0)};
        // camera_i in camera_0 = C (rig_0^-1 rig_i) C^-1, with C = camera_from_rig
        poses_ += matrix_line(camera_from_rig * inverse(world_from_first_) * frame.world_from_rig *
                              inverse(camera_from_rig));
        times_ += fmt::format("{}\n", frame.time_s);
        const Json to_world = {
            {"src", kRig}, {"dst", kWorld}, {"transform_src_to_dst", transform_json(frame.world_from_rig)}};
        Json objects = Json::object();
        for (const LabelledObject& object : frame.objects) objects.update(object_json(object, frame));
        frames_[std::to_string(frame.index)] = {{"frame_properties",
                                                 {{"timestamp", 1e-9 * double(frame.stamp_ns)},
                                                  {"streams", {{kStream, {{"uri", points}}}}},
                                                  {"transforms", {{"rig_to_world", to_world}}}}},
                                                {"objects", objects}};
    }

    void finish(const DatasetIndex& index) override {
        Json names = Json::array(), systems = {{kWorld, system_json("scene_cs", "", {kRig})}};
        for (const DatasetSensor& sensor : sensors_) names.push_back(sensor.options.frame_id);
        systems[kRig] = system_json("local_cs", kWorld, names);
        for (const DatasetSensor& sensor : sensors_) {
            Json& system = systems[sensor.options.frame_id] = system_json("sensor_cs", kRig, Json::array());
            system["pose_wrt_parent"] = transform_json(sensor.rig_from_sensor);
        }
        const Json stream = {{"type", "lidar"},
                             {"uri", "velodyne"},
                             {"description", "points of all sensors in the frame of the rig"}};
        const Json json = {
            {"openlabel",
             {{"metadata", {{"schema_version", "1.0.0"}, {"annotator", "relidar " RELIDAR_VERSION}}},
              {"coordinate_systems", systems},
              {"streams", {{kStream, stream}}},
              {"frame_intervals", {interval_json(0, place_.n_frames - 1)}},
              {"objects", objects_},
              {"frames", frames_}}}};
        write_bytes(folder_ / "openlabel.json", json.dump() + "\n");
        std::string calibration;
        for (int camera = 0; camera < 4; ++camera)
            calibration += fmt::format("P{}: 1 0 0 0 0 1 0 0 0 0 1 0\n", camera);
        write_bytes(folder_ / "calib.txt", calibration + "Tr: 0 -1 0 0 0 0 -1 0 1 0 0 0\n");
        write_bytes(folder_ / "poses.txt", poses_);
        write_bytes(folder_ / "times.txt", times_);
        Json splits = {{"train", Json::array()}, {"val", Json::array()}};
        for (std::size_t s = 0; s < index.sequences.size(); ++s)
            splits[index.is_validation(s) ? "val" : "train"].push_back(fmt::format("{:02}", s));
        write_bytes(place_.folder / "splits.json", splits.dump(1) + "\n");
    }

private:
    const fs::path folder_;
    Pose world_from_first_;
    std::string poses_, times_;
    Json frames_ = Json::object(), objects_ = Json::object();

    static Json interval_json(std::size_t first, std::size_t last) {
        return {{"frame_start", first}, {"frame_end", last}};
    }
    static Json system_json(const char* type, const char* parent, Json children) {
        return {{"type", type}, {"parent", parent}, {"children", std::move(children)}};
    }
    /// Returns the data of an object in a frame. Also lists it among all objects.
    Json object_json(const LabelledObject& object, const LabelledFrame& frame) {
        const std::string key = std::to_string(object.number);
        Json& known = objects_[key];
        if (known.is_null())
            known = {{"name", object.track},
                     {"type", find_object_names(object.category).kitti},
                     {"frame_intervals", Json::array()}};
        Json& intervals = known["frame_intervals"];
        if (intervals.empty() || std::size_t(intervals.back()["frame_end"]) + 1 != frame.index)
            intervals.push_back(interval_json(frame.index, frame.index));
        intervals.back()["frame_end"] = frame.index;
        const Pose pose = inverse(frame.world_from_rig) * object.world_from_box;
        const glm::dvec3 &t = pose.translation, &size = object.size_m;
        const glm::dquat& q = pose.rotation;
        const Json cuboid = {{"name", "box"},
                             {"val", {t.x, t.y, t.z, q.x, q.y, q.z, q.w, size.x, size.y, size.z}},
                             {"coordinate_system", kRig}};
        Json numbers = {{{"name", "points"}, {"val", object.n_points}}};
        if (object.visible_share)
            numbers.push_back({{"name", "visible_share"}, {"val", *object.visible_share}});
        return {{key,
                 {{"object_data",
                   {{"cuboid", {cuboid}},
                    {"num", numbers},
                    {"boolean", {{{"name", "is_static"}, {"val", !object.moves}}}},
                    {"text", {{{"name", "category"}, {"val", object.category}}}}}}}}};
    }
};

}  // namespace

std::unique_ptr<LayoutWriter> make_openlabel_writer(SequencePlace place,
                                                    const std::vector<DatasetSensor>& sensors,
                                                    const DatasetView& view) {
    return std::make_unique<OpenLabelWriter>(std::move(place), sensors, view);
}

}  // namespace relidar::layouts
