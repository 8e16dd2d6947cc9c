// SPDX-License-Identifier: Apache-2.0
#include "render/dataset_view.hpp"

#include <algorithm>
#include <array>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "base/fail.hpp"
#include "console.hpp"
#include "options.hpp"

namespace relidar::cli {
namespace {

constexpr std::array<const char*, 3> kFovNames{"all", "camera", "labels"};  // [DatasetFov]

/// Returns the camera of the log that looks forward, or null. If there are several, it is
/// the one that KITTI's object benchmark uses, or the first.
const Camera* find_front_camera(const Log& log) {
    constexpr double kMinCosine = 0.9;
    const Camera* front = nullptr;
    for (const Camera& camera : log.cameras)
        if ((camera.rig_from_camera.rotation * glm::dvec3(0, 0, 1)).x > kMinCosine &&
            (!front || camera.name == "image_2"))
            front = &camera;
    return front;
}

DatasetFov parse_fov(const std::string& name, const std::string& layout) {
    // The loaders of KITTI remove points outside the picture, but not boxes without
    // points.
    if (name.empty()) return layout == "kitti" ? DatasetFov::camera : DatasetFov::all;
    return static_cast<DatasetFov>(std::ranges::find(kFovNames, name) - kFovNames.begin());
}

}  // namespace

void add_view_options(CLI::App& command, DatasetViewOptions& options) {
    add_option(
        command, "--camera NAME|FILE", options.camera,
        "pictures of a camera instead of a sensor: one of the log, kitti, nuscenes, or a JSON file with K, "
        "size and mounting. With --layout kitti or nuscenes: the camera of the data set, mounted on the "
        "sensor "
        "or rig; none: black pictures, which cost no time (default: the front camera of the log, or that of "
        "the layout)");
    add_option(command, "--fov WHAT", options.fov,
               "points and boxes of --layout: all; camera, those in the picture; labels, where the log has "
               "labels for all objects (default: camera for kitti, otherwise all)")
        ->check(CLI::IsMember(kFovNames));
    add_option(
        command, "--classes FILE", options.classes,
        "names of classes in --layout: a TOML or JSON file with pairs of a class or label and its name, "
        "for example {\"Van\": \"Car\", \"Other\": \"\"}; an empty name leaves the objects out");
}

void check_view_options(const DatasetViewOptions& options, const std::string& layout) {
    if (layout.empty() && !(options.fov.empty() && options.classes.empty()))
        fail<UsageError>("found --fov or --classes without --layout, expected --layout, too");
    if (!options.classes.empty()) (void)read_class_names(options.classes);  // for its errors
    const bool needs_camera = options.fov == "camera";
    if (layout.empty() || find_layout_camera(layout)) return;
    if (needs_camera && options.camera.empty())
        fail<UsageError>("--fov camera: the layout {} has no camera, expected --camera", layout);
    if (!needs_camera && !options.camera.empty())
        fail<UsageError>("--camera {}: the layout {} has no pictures, expected --fov camera", options.camera,
                         layout);
}

DatasetView choose_view(const DatasetViewOptions& options, const std::string& layout, const Log& log,
                        int lidar) {
    constexpr const char* kNoPictures = "none";
    DatasetView view{.fov = parse_fov(options.fov, layout)};
    const std::optional<Camera> layout_camera = find_layout_camera(layout);
    view.has_pictures = layout_camera && options.camera != kNoPictures;
    if (!options.camera.empty() && options.camera != kNoPictures)
        view.camera = choose_camera(options.camera, log, lidar);
    else if (layout_camera) {
        const Camera* front = find_front_camera(log);
        view.camera = front ? choose_camera(front->name, log, lidar) : layout_camera;
    }
    if (!options.classes.empty()) view.class_names = read_class_names(options.classes);
    if (log.labelled_azimuth)
        view.labelled =
            LabelledSector{*log.labelled_azimuth, shift_track(log.lidar_track(0), log.world_offset_m)};
    return view;
}

void note_labelled_sector(const DatasetView& view) {
    if (!exceeds_labels(view)) return;
    const AzimuthInterval& sector = view.labelled->azimuth;
    print_note(fmt::format(
        "the log has labels only from {:.1f} to {:.1f} degrees (left is positive), so objects elsewhere may "
        "lack boxes; --fov labels writes only this sector",
        sector.right_rad * 180.0 / kPi, sector.left_rad * 180.0 / kPi));
}

}  // namespace relidar::cli
