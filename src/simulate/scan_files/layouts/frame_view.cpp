// SPDX-License-Identifier: Apache-2.0
// What the camera of a data set shows of a frame, and which part of a frame is written.
#include "simulate/scan_files/layouts/layout.hpp"

#include <algorithm>
#include <array>

#include <relidar/base/images.hpp>
#include <relidar/simulate/camera.hpp>

namespace relidar::layouts {
namespace {

/// Returns true for pixels of the picture in the sense of KITTI's development kits: from
/// 0 to columns, and from 0 to rows.
bool is_in_picture(const Camera& camera, const std::optional<glm::dvec2>& pixel) {
    return pixel && pixel->x >= 0.0 && pixel->y >= 0.0 && pixel->x < camera.columns && pixel->y < camera.rows;
}

void create_folder_of(const std::filesystem::path& path) {
    std::error_code failed;  // then the file cannot be written
    std::filesystem::create_directories(path.parent_path(), failed);
}

}  // namespace

std::optional<ImageBox> project_box(const Camera& camera, const Pose& camera_from_box,
                                    const glm::dvec3& size_m) {
    constexpr double kNearPlane_m = 0.1;
    std::array<glm::dvec3, 8> corners;
    for (std::size_t i = 0; i < corners.size(); ++i)
        corners[i] = camera_from_box * (size_m * (glm::dvec3(i & 1, i >> 1 & 1, i >> 2 & 1) - 0.5));
    glm::dvec2 min_px(INFINITY), max_px(-INFINITY);
    const auto add = [&](const glm::dvec3& point_m) {
        const glm::dvec2 pixel = *camera.project(point_m);
        min_px = glm::min(min_px, pixel);
        max_px = glm::max(max_px, pixel);
    };
    for (std::size_t i = 0; i < corners.size(); ++i) {
        if (corners[i].z >= kNearPlane_m) add(corners[i]);
        // An edge joins two corners whose numbers differ in one bit. Adds the point in
        // which the edge crosses the near plane.
        for (const std::size_t axis : {1, 2, 4}) {
            const glm::dvec3 &a = corners[i], &b = corners[i | axis];
            if ((a.z < kNearPlane_m) == (b.z < kNearPlane_m)) continue;
            glm::dvec3 crossing = glm::mix(a, b, (kNearPlane_m - a.z) / (b.z - a.z));
            crossing.z = kNearPlane_m;
            add(crossing);
        }
    }
    const glm::dvec2 last_px(camera.columns - 1, camera.rows - 1),
        clipped_min_px = glm::max(min_px, glm::dvec2(0.0)), clipped_max_px = glm::min(max_px, last_px),
        side_px = max_px - min_px, clipped_side_px = clipped_max_px - clipped_min_px;
    if (!(clipped_side_px.x > 0.0 && clipped_side_px.y > 0.0)) return {};
    return ImageBox{clipped_min_px, clipped_max_px,
                    1.0 - clipped_side_px.x * clipped_side_px.y / (side_px.x * side_px.y)};
}

void write_picture(const std::filesystem::path& path, const Camera& camera, const RenderedScan* picture) {
    const auto n_values = 3 * std::size_t(camera.rows) * std::size_t(camera.columns);
    const Image image = picture ? draw_camera(*picture)
                                : Image{camera.rows, camera.columns, std::vector<std::uint8_t>(n_values)};
    create_folder_of(path);
    write_png(path, image);
}

void write_depth(const std::filesystem::path& path, const RenderedScan& picture) {
    create_folder_of(path);
    write_png(path, draw_depth(picture));
}

FrameView::FrameView(const DatasetView& view, const LabelledFrame& frame)
    : view_(view),
      world_from_camera_(view.camera ? frame.world_from_rig * view.camera->rig_from_camera : Pose{}),
      lidar_from_world_(view.labelled ? inverse(view.labelled->dataset_from_lidar.pose_at(frame.time_s))
                                      : Pose{}) {}

bool FrameView::contains(const glm::dvec3& world_m) const {
    if (view_.fov == DatasetFov::camera)
        return is_in_picture(*view_.camera, view_.camera->project(inverse(world_from_camera_) * world_m));
    return view_.fov == DatasetFov::all || !view_.labelled ||
           view_.labelled->azimuth.contains(lidar_from_world_ * world_m);
}

RenderedScan FrameView::cut_scan(const RenderedScan& scan, const Config& config) const {
    RenderedScan cut = scan;
    FiringPoseInterpolator world_from_firing(scan);
    const std::vector<float>& range_m = point_ranges(scan, config);
    for (std::size_t ray = 0; ray < range_m.size(); ++ray) {
        const Pose& pose = world_from_firing.pose_of(ray);
        const auto contains_range = [&](float at_m) {
            return contains(pose * glm::dvec3(scan.image.origin[ray] + at_m * scan.image.direction[ray]));
        };
        if (!contains_range(range_m[ray])) cut.image.drop_prob[ray] = 1.0f;
        for (AdditionalReturns& returns : cut.second_returns)
            if (!contains_range(returns.range_m[ray])) returns.range_m[ray] = returns.intensity[ray] = 0.0f;
    }
    return cut;
}

std::optional<ImageBox> FrameView::find_image_box(const LabelledObject& object) const {
    if (!view_.camera) return {};
    return project_box(*view_.camera, inverse(world_from_camera_) * object.world_from_box, object.size_m);
}

bool FrameView::has_label(const LabelledObject& object) const {
    return view_.fov == DatasetFov::camera ? object.image_box.has_value()
                                           : contains(object.world_from_box.translation);
}

std::vector<ImageBox> FrameView::unlabelled_parts() const {
    std::vector<ImageBox> parts;
    if (!view_.camera || !view_.labelled) return parts;
    const Camera& camera = *view_.camera;
    const glm::dquat lidar_from_camera = lidar_from_world_.rotation * world_from_camera_.rotation;
    for (int column = 0, first = 0; column <= camera.columns; ++column) {
        // Points far away in a column have about the same azimuth in all rows.
        const bool is_outside = column < camera.columns &&
                                !view_.labelled->azimuth.contains(
                                    lidar_from_camera * camera.direction_of({column, camera.centre_y_px}));
        if (is_outside) continue;
        if (column > first) parts.push_back({glm::dvec2(first, 0), glm::dvec2(column - 1, camera.rows - 1)});
        first = column + 1;
    }
    return parts;
}

}  // namespace relidar::layouts

namespace relidar {

bool exceeds_labels(const DatasetView& view) {
    // The azimuths of a camera are those of points far away.
    constexpr double kTolerance_rad = 0.02;
    if (!view.labelled || view.fov == DatasetFov::labels) return false;
    if (view.fov == DatasetFov::all) return true;
    const AzimuthInterval seen = view_azimuths(*view.camera), &sector = view.labelled->azimuth;
    return seen.right_rad < sector.right_rad - kTolerance_rad ||
           seen.left_rad > sector.left_rad + kTolerance_rad;
}

}  // namespace relidar
