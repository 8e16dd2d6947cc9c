// SPDX-License-Identifier: Apache-2.0
// Makes an actor of a labelled object that stands still: cuts its surfels out of the
// background, and closes the ground below it, which it hid from the sensor.
#include <relidar/run/edit.hpp>

#include <algorithm>
#include <cmath>

#include <fmt/ranges.h>

#include <relidar/run/run.hpp>
#include <relidar/scene/labels.hpp>
#include "base/fail.hpp"
#include "base/geometry/plane_sums.hpp"
#include "base/sigmoid.hpp"
#include "run/edit/tracks.hpp"

namespace relidar {
namespace {

// Surfels this far outside of the box belong to the object, because labels are smaller
// than mirrors and bumpers.
constexpr double kCutMargin_m = 0.2;
// Labels jitter and are turned. Up to this distance, surfels belong to the object unless
// they are connected with surfels farther away, for example of a wall.
constexpr double kLooseMargin_m = 0.6, kLink_m = 0.3;
// In the box, surfels belong to the ground if centre and upper end are at most
// this high above it. Tyres begin at the ground, and many surfels there stand upright.
constexpr double kGroundNoise_m = 0.05, kGroundTop_m = 0.1;
// Around the box, lower surfels belong to the ground.
constexpr double kLowObject_m = 0.15;
constexpr double kMinGroundNormalZ = 0.75;  // as in ground.cpp
// Largest distance of ground around the object from the ground that ground.cpp finds.
constexpr double kMaxGroundStep_m = 0.3, kMaxOffPlane_m = 0.1;
// The ground around the object is searched up to these distances from its box.
constexpr double kRings_m[] = {1.0, 2.0, 4.0};
constexpr std::size_t kMinRingSurfels = 50, kNeighbours = 8;
// Distance of surfels that fill the ground. Their standard deviation makes them overlap.
constexpr double kFillStep_m = 0.15, kFillScale_m = 0.6 * kFillStep_m;
constexpr float kFillOpacityLogit = 3.0f;
constexpr double kMinCovered = 0.5;  // alpha of the ground below which it is filled
constexpr std::size_t kMostViews = 64;

glm::dmat3 surfel_axes(const Surfels& surfels, std::size_t i) {
    const glm::vec4& q = surfels.rotation[i];  // w, x, y, z
    return glm::mat3_cast(glm::normalize(glm::dquat(q.x, q.y, q.z, q.w)));
}

/// Returns the standard deviation of a surfel along z.
double upward_m(const Surfels& surfels, std::size_t i) {
    const glm::dmat3 axes = surfel_axes(surfels, i);
    const glm::dvec2 scale_m = glm::exp(glm::dvec2(surfels.log_scale[i]));
    const double w_m = surfels.log_scale_w.empty() ? 0.0 : std::exp(double(surfels.log_scale_w[i]));
    return glm::length(glm::dvec3(axes[0].z, axes[1].z, axes[2].z) * glm::dvec3(scale_m, w_m));
}

double largest(const glm::dvec3& v) { return std::max({v.x, v.y, v.z}); }

/// A standing object and a box around it.
struct StandingBox {
    Pose world_from_box, box_from_world;
    glm::dvec3 half_m;

    explicit StandingBox(const BoxTrack& box)
        : world_from_box(box.world_from_box.pose.front()),
          box_from_world(inverse(world_from_box)),
          half_m(0.5 * box.size_m) {}
    /// Returns how far a point is outside of the box along each of its axes.
    glm::dvec3 outside_m(const glm::dvec3& point_m) const {
        return glm::abs(box_from_world * point_m) - half_m;
    }
    /// Returns how far a point is outside of the footprint; negative inside.
    double outside_footprint_m(const glm::dvec3& point_m) const {
        const glm::dvec3 out_m = outside_m(point_m);
        return std::max(out_m.x, out_m.y);
    }
};

bool is_level(const Surfels& surfels, std::size_t i) {
    return !properties_of(surfels.primitive).has_normals ||
           std::abs(surfel_axes(surfels, i)[2].z) > kMinGroundNormalZ;
}

/// Ground around an object: a plane through level surfels, and their distances from it.
class SurroundingGround {
public:
    /// @param level_m  height of the ground below the object
    /// @return nothing if there are too few level surfels
    static std::optional<SurroundingGround> fit_ring(const Surfels& background, const StandingBox& box,
                                                     double level_m) {
        for (const double ring_m : kRings_m) {
            std::vector<std::uint32_t> in_ring;
            for (std::uint32_t i = 0; i < background.size(); ++i) {
                const glm::dvec3 point(background.mean[i]);
                const double out_m = box.outside_footprint_m(point);
                if (out_m > kCutMargin_m && out_m < ring_m &&
                    std::abs(point.z - level_m) < kMaxGroundStep_m && background.opacity_logit[i] > 0.0f &&
                    is_level(background, i))
                    in_ring.push_back(i);
            }
            SurroundingGround ground;
            if (ground.fit_plane(background.reorder(in_ring))) return ground;
        }
        return std::nullopt;
    }

    struct Neighbour {
        std::size_t surfel;  ///< index in ring()
        double weight;       ///< the sum over all neighbours is 1
    };
    /// Returns the nearest surfels of the ring.
    std::vector<Neighbour> find_neighbours(const glm::dvec2& xy) const {
        std::vector<Neighbour> near;
        for (std::size_t i = 0; i < ring_.size(); ++i) {
            const glm::dvec2 apart_m = glm::dvec2(ring_.mean[i]) - xy;
            near.push_back({i, 1.0 / (glm::dot(apart_m, apart_m) + kFillStep_m * kFillStep_m)});
        }
        const auto end = near.begin() + kNeighbours;
        std::ranges::partial_sort(near, end, std::ranges::greater{}, &Neighbour::weight);
        near.erase(end, near.end());
        double sum = 0.0;
        for (const Neighbour& n : near) sum += n.weight;
        for (Neighbour& n : near) n.weight /= sum;
        return near;
    }

    /// Returns the height of the ground: that of the plane, plus the mean distance of the
    /// nearest surfels from it, so that filled ground has no step at its border.
    double height_m(const glm::dvec2& xy) const {
        double z_m = plane_z_m(xy);
        for (const auto& [i, weight] : find_neighbours(xy))
            z_m += weight * (double(ring_.mean[i].z) - plane_z_m(glm::dvec2(ring_.mean[i])));
        return z_m;
    }
    const glm::dvec3& normal() const { return normal_; }
    const Surfels& ring() const { return ring_; }

private:
    Surfels ring_;
    glm::dvec3 origin_m_{0.0}, normal_{0.0, 0.0, 1.0};

    double plane_z_m(const glm::dvec2& xy) const {
        return origin_m_.z -
               (normal_.x * (xy.x - origin_m_.x) + normal_.y * (xy.y - origin_m_.y)) / normal_.z;
    }

    /// Fits the plane three times. Leaves out what is far from it, for example a kerb.
    bool fit_plane(Surfels ring) {
        ring_ = std::move(ring);
        for (int round = 0; round < 3; ++round) {
            if (ring_.size() < kMinRingSurfels) return false;
            const glm::dvec3 first_m(ring_.mean.front());
            PointMomentSums sums;
            for (const glm::vec3& mean : ring_.mean) sums.add_point(glm::dvec3(mean) - first_m);
            const PlaneFit fit = sums.fit_plane();
            origin_m_ = first_m + fit.mean;
            normal_ = fit.axes[0] * (fit.axes[0].z > 0.0 ? 1.0 : -1.0);
            if (normal_.z < kMinGroundNormalZ) return false;
            std::vector<std::uint32_t> near;
            for (std::uint32_t i = 0; i < ring_.size(); ++i)
                if (std::abs(double(ring_.mean[i].z) - plane_z_m(glm::dvec2(ring_.mean[i]))) < kMaxOffPlane_m)
                    near.push_back(i);
            ring_ = ring_.reorder(near);
        }
        return ring_.size() >= kNeighbours;
    }
};

/// Returns the ground around an object, if the log has observed it.
std::optional<SurroundingGround> find_ground(const SceneWithLog& driving, const Surfels& background,
                                             const StandingBox& box) {
    const Pose dataset_from_box{box.world_from_box.rotation,
                                box.world_from_box.translation + driving.log.world_offset_m};
    const std::optional<double> gap_m =
        heights_above_ground({driving.scene, driving.log}, {{0.0}, {dataset_from_box}}, 2.0 * box.half_m)
            .front();
    if (!gap_m) return std::nullopt;
    const double bottom_m = (box.world_from_box * glm::dvec3(0.0, 0.0, -box.half_m.z)).z;
    return SurroundingGround::fit_ring(background, box, bottom_m - *gap_m);
}

/// Marks the surfels that are connected with a marked surfel by steps of kLink_m.
void mark_connected(const std::vector<glm::dvec3>& points_m, std::vector<bool>& is_marked) {
    std::vector<std::size_t> pending;
    for (std::size_t i = 0; i < points_m.size(); ++i)
        if (is_marked[i]) pending.push_back(i);
    while (!pending.empty()) {
        const glm::dvec3 from_m = points_m[pending.back()];
        pending.pop_back();
        for (std::size_t i = 0; i < points_m.size(); ++i)
            if (!is_marked[i] && glm::distance(points_m[i], from_m) < kLink_m) {
                is_marked[i] = true;
                pending.push_back(i);
            }
    }
}

/// Returns which surfels of the background belong to an object: those in its box and
/// above the ground. A surfel near two objects belongs to the nearer one.
std::vector<bool> select_surfels(const Surfels& background, const StandingBox& box,
                                 const std::optional<SurroundingGround>& ground,
                                 const std::vector<StandingBox>& others) {
    std::vector<bool> is_part(background.size()), is_outside;
    std::vector<std::size_t> loose;  // surfels around the box
    std::vector<glm::dvec3> loose_m;
    for (std::size_t i = 0; i < background.size(); ++i) {
        const glm::dvec3 point(background.mean[i]);
        const double z_m = (box.box_from_world * point).z, above_m = z_m - box.half_m.z,
                     out_m = std::max(box.outside_footprint_m(point), above_m);
        if (out_m > kLooseMargin_m + kLink_m || z_m < -2.0 * box.half_m.z) continue;
        const double height_m = ground ? point.z - ground->height_m(glm::dvec2(point)) : z_m + box.half_m.z;
        const bool is_in_box = out_m <= kCutMargin_m;
        const bool is_ground =
            is_in_box ? height_m < kGroundNoise_m && height_m + 2.0 * upward_m(background, i) < kGroundTop_m
                      : height_m < kLowObject_m;
        if (is_ground) continue;
        const bool is_nearer_to_other = std::ranges::any_of(others, [&](const StandingBox& other) {
            return largest(other.outside_m(point)) < std::max(0.0, out_m);
        });
        is_part[i] = is_in_box && !is_nearer_to_other;
        if (is_in_box) continue;
        loose.push_back(i);
        loose_m.push_back(point);
        is_outside.push_back(is_nearer_to_other || out_m > kLooseMargin_m);
    }
    mark_connected(loose_m, is_outside);
    for (std::size_t k = 0; k < loose.size(); ++k) is_part[loose[k]] = !is_outside[k];
    return is_part;
}

/// Returns the alpha of level surfels at a point of the ground, seen from above.
double covered_alpha(const Surfels& surfels, const std::vector<std::size_t>& level,
                     const glm::dvec3& point_m) {
    double transmittance = 1.0;
    for (const std::size_t i : level) {
        const glm::dvec3 apart_m = point_m - glm::dvec3(surfels.mean[i]);
        const glm::dmat3 axes = surfel_axes(surfels, i);
        const glm::dvec2 in_plane = glm::dvec2(glm::dot(apart_m, axes[0]), glm::dot(apart_m, axes[1])) /
                                    glm::exp(glm::dvec2(surfels.log_scale[i]));
        transmittance *=
            1.0 - sigmoid(double(surfels.opacity_logit[i])) * std::exp(-0.5 * glm::dot(in_plane, in_plane));
    }
    return 1.0 - transmittance;
}

/// Returns surfels that close the ground below an object where the remaining background
/// has none. Height, intensity and drop logits are means of the nearest ground around it.
/// @param background  without the surfels of the object
Surfels fill_ground(const Surfels& background, const StandingBox& box, const SurroundingGround& ground) {
    std::vector<std::size_t> level;  // the ground below and around the object
    for (std::size_t i = 0; i < background.size(); ++i) {
        const glm::dvec3 point(background.mean[i]);
        if (box.outside_footprint_m(point) < kRings_m[0] && is_level(background, i) &&
            std::abs(point.z - ground.height_m(glm::dvec2(point))) < kLowObject_m)
            level.push_back(i);
    }
    const glm::dvec3 axis = glm::cross(glm::dvec3(0.0, 0.0, 1.0), ground.normal());
    const glm::dquat q = glm::normalize(glm::dquat(1.0 + ground.normal().z, axis.x, axis.y, axis.z));
    Surfels fill;
    fill.resize(0, background.parameters_used());
    const glm::dvec2 half_m = glm::dvec2(box.half_m) + kCutMargin_m;
    const glm::ivec2 n(glm::ceil(2.0 * half_m / kFillStep_m));
    for (int row = 0; row < n.y; ++row)
        for (int column = 0; column < n.x; ++column) {
            const glm::dvec2 place = (glm::dvec2(column, row) + 0.5) / glm::dvec2(n) * 2.0 - 1.0;
            const glm::dvec2 xy(box.world_from_box * glm::dvec3(place * half_m, -box.half_m.z));
            const glm::dvec3 point(xy, ground.height_m(xy));
            if (covered_alpha(background, level, point) > kMinCovered) continue;
            const auto neighbours = ground.find_neighbours(xy);
            Surfels added = ground.ring().slice(neighbours.front().surfel, 1);
            added.mean[0] = glm::vec3(point);
            added.rotation[0] = glm::vec4(q.w, q.x, q.y, q.z);
            added.log_scale[0] = glm::vec2(float(std::log(kFillScale_m)));
            added.opacity_logit[0] = kFillOpacityLogit;
            for (std::size_t k = 0; k < kShFloats; ++k) {
                double mean = 0.0;
                for (const auto& [surfel, weight] : neighbours)
                    mean += weight * double(ground.ring().sh[surfel * kShFloats + k]);
                added.sh[k] = float(mean);
            }
            fill.append_surfels(added);
        }
    return fill;
}

/// Returns the sides of an object that its opaque surfels show and that faced the sensor.
ObservedBoxSurface find_observed(const Surfels& surfels, const StandingBox& box, const Log& log) {
    ObservedBoxSurface surface(2.0 * box.half_m);
    const std::size_t step = std::max<std::size_t>(1, log.frames.size() / kMostViews);
    for (std::size_t f = 0; f < log.frames.size(); f += step) {
        const Frame& frame = log.frames[f];
        const glm::dvec3 sensor_m =
            box.box_from_world * log.lidar_track(frame.lidar).pose_at(frame.time_s).translation;
        for (std::size_t i = 0; i < surfels.size(); ++i) {
            const glm::dvec3 point(surfels.mean[i]);
            if (surfels.opacity_logit[i] > 0.0f)
                surface.mark_observed(point, glm::normalize(point - sensor_m));
        }
    }
    return surface;
}

/// Converts surfels of the world to the frame of a box.
Surfels to_box_frame(Surfels surfels, const StandingBox& box) {
    Scene one;
    one.models = {{.name = "", .count = static_cast<std::uint32_t>(surfels.size())}};
    one.instances = {{0, "object"}};
    one.surfels = std::move(surfels);
    return freeze_scene(one, {{.world_from_model = box.box_from_world}});
}

/// Moves the blocks near a box into the background of the scene, which is in memory.
void load_blocks_near(Scene& scene, const StandingBox& box) {
    std::vector<std::size_t> near;
    std::vector<SceneBlock> far;
    for (std::size_t i = 0; i < scene.blocks.size(); ++i)
        if (scene.blocks[i].distance_m(box.world_from_box.translation) <
            glm::length(box.half_m) + std::end(kRings_m)[-1])
            near.push_back(i);
        else far.push_back(scene.blocks[i]);
    if (near.empty()) return;
    scene = with_blocks(scene, near);
    scene.blocks = std::move(far);
}

/// Adds the model, the instance and the track of a released object.
void add_object(SceneWithLog& driving, const BoxTrack& object, const Surfels& surfels) {
    const StandingBox box(object);
    Scene& scene = driving.scene;
    scene.instances.push_back({static_cast<std::uint32_t>(scene.models.size()), object.id});
    scene.models.push_back({.name = object.id,
                            .first = static_cast<std::uint32_t>(scene.surfels.size()),
                            .count = static_cast<std::uint32_t>(surfels.size()),
                            .half_size_m = glm::vec3(box.half_m + kObjectMargin_m),
                            .surface = find_observed(surfels, box, driving.log)});
    scene.surfels.append_surfels(surfels);
    *std::ranges::find(driving.log.boxes, object.id, &BoxTrack::id) = object;
}

}  // namespace

std::optional<BoxTrack> find_standing(const SceneWithLogView& driving, const std::string& track_id) {
    const BoxTrack* box = find_box(driving.log, track_id);
    const bool has_model = std::ranges::find(driving.scene.instances, track_id, &ModelInstance::track) !=
                           driving.scene.instances.end();
    return box && !has_model ? make_standing(*box, driving.log) : std::nullopt;
}

std::optional<BoxTrack> make_standing(BoxTrack box, const Log& log) {
    Log alone;  // with only this box
    alone.boxes = {box};
    const std::vector<BoxTrack> standing = list_standing({}, alone, {});
    if (standing.empty()) return std::nullopt;
    std::vector<double> times_s = list_sweep_times_s(log);
    if (times_s.empty()) times_s = standing[0].world_from_box.time_s;
    const std::vector<Pose> poses(times_s.size(), standing[0].world_from_box.pose.front());
    box.world_from_box = {std::move(times_s), poses};
    box.n_before = box.n_after = 0;
    return box;
}

ReleasedObject release_standing(SceneWithLog driving, const std::string& track) {
    const std::optional<BoxTrack> object = find_standing({driving.scene, driving.log}, track);
    if (!object) return {std::move(driving)};
    if (count_surfels(driving.scene) == 0) {  // only the tracks are used
        add_object(driving, *object, {});
        return {std::move(driving)};
    }
    const StandingBox box(*object);
    std::vector<StandingBox> others;
    for (const BoxTrack& other : list_standing(driving.scene, driving.log, {}))
        if (other.id != track) others.emplace_back(other);
    load_blocks_near(driving.scene, box);
    Scene& scene = driving.scene;
    const Surfels all = scene.surfels.slice(0, scene.models.front().count);
    const std::optional<SurroundingGround> ground = find_ground(driving, all, box);
    const std::vector<bool> is_part = select_surfels(all, box, ground, others);
    std::vector<std::uint32_t> cut, kept;
    for (std::uint32_t i = 0; i < all.size(); ++i) (is_part[i] ? cut : kept).push_back(i);
    if (cut.empty())
        fail<UsageError>(
            "cannot edit track \"{}\": it stands still, and the background has no surfels in its box above "
            "the ground; expected an object that the log has observed",
            track);
    Surfels background = all.reorder(kept), surfels = to_box_frame(all.reorder(cut), box);
    std::size_t n_filled = 0;
    if (ground) {
        const Surfels fill = fill_ground(background, box, *ground);
        n_filled = fill.size();
        background.append_surfels(fill);
    }
    std::vector<SceneBlock> blocks = std::move(scene.blocks);
    scene = replace_background(scene, background);
    scene.blocks = std::move(blocks);
    add_object(driving, *object, surfels.reorder(kd_tree_order(surfels.mean)));
    const glm::dvec2 size_m = 2.0 * (glm::dvec2(box.half_m) + kCutMargin_m);
    const glm::dvec2 cell_m = size_m / glm::ceil(size_m / kFillStep_m);
    return {std::move(driving), double(n_filled) * cell_m.x * cell_m.y, ground.has_value()};
}

std::string describe_release(const ReleasedObject& released, const std::string& track) {
    const Scene& scene = released.edited.scene;
    const auto object = std::ranges::find(scene.instances, track, &ModelInstance::track);
    const SurfelModel& model = scene.models[object->model];
    const std::string sides = list_unseen_sides(model.surface->covered_sides());
    std::vector<std::string> unseen;
    if (released.filled_m2 > 0.0)
        unseen.push_back(fmt::format(
            "{:.1f} m2 of the ground below it, which now continue the ground around it", released.filled_m2));
    if (!released.has_ground) unseen.push_back("the ground below it, which stays open");
    if (!sides.empty()) unseen.push_back("these sides of it: " + sides);
    return fmt::format("{} stood in the background, and its {} surfels were cut out{}{}", track, model.count,
                       unseen.empty() ? "" : "; the log did not observe ", fmt::join(unseen, ", and "));
}

}  // namespace relidar
