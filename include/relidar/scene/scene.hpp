// SPDX-License-Identifier: Apache-2.0
// Scene of 2D Gaussians (surfels), with a model for the background and for each actor.
// Instances place the models in the world (paper, Eq. 1, 4, 5). A scene may use 3D
// Gaussians instead. Comments about surfels also apply to them.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <glm/glm.hpp>

#include <relidar/scene/primitives.h>
#include <relidar/base/math.hpp>
#include <relidar/base/process_group.hpp>
#include <relidar/base/progress.hpp>
#include <relidar/log/log.hpp>
#include <relidar/scene/box_surface.hpp>

namespace relidar {

/// Number of coefficients of the real spherical harmonics (SH) basis of degree 3.
inline constexpr int kShCoefficients = 16;
inline constexpr int kShChannels = 3;  ///< Number of SH channels: intensity, hit logit, drop logit.
inline constexpr int kShFloats = kShChannels * kShCoefficients;

/// Type of Gaussian that a scene consists of (docs/method.md section 2).
enum class PrimitiveType {
#define RELIDAR_PRIMITIVE(number, name, label, third_scale, normals, proxy) name = number,
    RELIDAR_PRIMITIVES(RELIDAR_PRIMITIVE)  // Declares one enumerator per primitive.
#undef RELIDAR_PRIMITIVE
};

/// Triangle mesh that encloses a primitive in the driver's acceleration structure.
/// `rectangle`: two triangles in the plane of a surfel. `icosahedron`: twenty triangles
/// around the ellipsoid of a 3D Gaussian.
enum class ProxyMesh { rectangle, icosahedron };

/// Properties of a primitive. RELIDAR_PRIMITIVES explains each field.
struct PrimitiveProperties {
    PrimitiveType primitive;
    const char* name;
    const char* label;
    bool third_scale;
    bool has_normals;
    ProxyMesh mesh;
};

inline constexpr std::array kPrimitives{
#define RELIDAR_PRIMITIVE(number, name, label, third_scale, normals, proxy) \
    PrimitiveProperties{PrimitiveType::name, #name, label, third_scale, normals, ProxyMesh::proxy},
    RELIDAR_PRIMITIVES(RELIDAR_PRIMITIVE)  // Adds one row per primitive.
#undef RELIDAR_PRIMITIVE
};
constexpr const PrimitiveProperties& properties_of(PrimitiveType primitive) {
    return kPrimitives[static_cast<std::size_t>(primitive)];
}

/// Phase window of a surfel on an actor whose shape changes periodically, like the legs
/// of a walking person. p is the phase of the actor's motion (InstancePose::phase,
/// docs/method.md M14):
///   opacity factor exp(sharpness^2 (cos 2 pi (p - phase) - 1)),
///   position       mean + swing sin 2 pi (p - phase)
///
/// If all fields are zero, the surfel is always visible and does not move.
struct GaitPhaseWindow {
    /// Phase at which the surfel is most opaque and not displaced, 0..1.
    float phase = 0.0f;
    /// How quickly the surfel fades away from `phase`: the window is about a Gaussian
    /// with a standard deviation of 1 / (2 pi sharpness). 0 = always visible.
    float sharpness = 0.0f;
    glm::vec3 swing{0.0f};  ///< Amplitude of the surfel's motion, [3] metres, model frame.
};

/// Selects the parameters that the surfels of a scene have.
struct SurfelParameterSet {
    PrimitiveType primitive;
    bool bends;  ///< True if the surfels also have a gait (phase window).
    constexpr SurfelParameterSet(PrimitiveType p = PrimitiveType::surfel, bool b = false)
        : primitive(p), bends(b) {}
    bool operator==(const SurfelParameterSet&) const = default;
};

/// Surfel parameters in the form in which they are stored and optimised. Each parameter
/// has one array. All parameters are in the frame of the surfel's model.
struct Surfels {
    std::vector<glm::vec3> mean;  ///< Centres, [n,3] metres.
    /// Rotations, [n,4] quaternions w, x, y, z, unnormalised. The columns of the rotation
    /// matrix R are a_u, a_v and the normal.
    std::vector<glm::vec4> rotation;
    std::vector<glm::vec2> log_scale;  ///< Standard deviations along a_u and a_v, [n,2] ln metres.
    std::vector<float> opacity_logit;  ///< Logits of the opacities, [n].
    /// SH coefficients, [n,3,16], channel by channel. The value of a channel is 0.5 +
    /// basis(direction) . coefficients.
    std::vector<float> sh;
    /// Standard deviations of 3D Gaussians along the third axis, [n] ln metres. Empty for
    /// surfels.
    std::vector<float> log_scale_w;
    std::vector<GaitPhaseWindow> gait;  ///< Phase windows, [n] if `bends` is true, otherwise empty.
    PrimitiveType primitive = PrimitiveType::surfel;
    bool bends = false;  ///< True if the surfels have a gait (phase window).

    std::size_t size() const { return mean.size(); }
    SurfelParameterSet parameters_used() const { return {primitive, bends}; }
    void resize(std::size_t count) { resize(count, parameters_used()); }
    void resize(std::size_t count, SurfelParameterSet parameters);
    void add_still_gait();  ///< Adds a gait without motion to all surfels if they have none.
    /// Appends surfels. An empty set adopts the primitive type of `other`. If only one
    /// set has a gait, the other gets one without motion.
    /// @throws DataError if the primitive types differ
    void append_surfels(const Surfels& other);
    /// Returns a reordered copy: surfel i of the result is surfel order[i] of this set.
    Surfels reorder(const std::vector<std::uint32_t>& order) const;
    /// Returns a copy of surfels first ... first + count - 1.
    Surfels slice(std::size_t first, std::size_t count) const;
    /// @throws DataError if the arrays do not have the same number of surfels
    void check_lengths() const;
};

/// Converts surfels to another primitive. If the new primitive has a third scale, its
/// value is `relative_thickness` times the geometric mean of the other two scales.
void convert_surfels(Surfels& surfels, PrimitiveType primitive, double relative_thickness);

/// Contiguous range of the scene's surfels that share one coordinate frame.
struct SurfelModel {
    std::string name;  ///< Name of the model: "background" or the track id.
    std::uint32_t first = 0;
    std::uint32_t count = 0;
    /// Half size of the box around the model's surfels, centred at the origin, metres. 0
    /// = the model has no box.
    glm::vec3 half_size_m{0.0f};
    /// Metres after which an actor repeats its recorded walk, including a gap of about
    /// three frames between end and start. 0 = rigid model.
    float stride_m = 0.0f;
    std::optional<ObservedBoxSurface> surface = {};  ///< observed parts of the box; empty: unknown
};

/// Placement of a model in the world. Instance 0 is the background at the origin.
struct ModelInstance {
    std::uint32_t model = 0;
    std::string track;  ///< Id of the track that moves the instance. Empty for the background.
};

/// Part of the background that was trained on one section of a road. Its surfels are
/// loaded from a file when a sensor is near.
struct SceneBlock {
    std::filesystem::path file;  ///< Model file whose first model holds the surfels of the block.
    std::uint32_t count = 0;     ///< Number of surfels in the block.
    /// Corners of the box around the surfels and three of their standard deviations, [3]
    /// metres, world frame.
    glm::vec3 low_m{0.0f}, high_m{0.0f};

    /// Returns the distance from a point in the world frame to the box; 0 in the box.
    double distance_m(const glm::dvec3& point_m) const {
        return glm::distance(point_m, glm::clamp(point_m, glm::dvec3(low_m), glm::dvec3(high_m)));
    }
};

/// Scene that can be rendered: surfels, models, instances that place the models in the
/// world, and drop probabilities of the sensor.
struct Scene {
    Surfels surfels;
    std::vector<SurfelModel> models;
    std::vector<ModelInstance> instances;
    /// Probabilities that the log's LiDARs drop a ray regardless of the scene, one row
    /// per beam (Log::find_global_beam). Empty if not estimated.
    RayDropTable sensor_drop;
    /// Parts of the background that are stored in files and not in `surfels`.
    std::vector<SceneBlock> blocks = {};
};

/// Returns the number of surfels of a scene, including blocks that are still in files.
std::size_t count_surfels(const Scene& scene);

/// Scene together with its log, whose tracks move the actors (ModelInstance::track). The
/// scans of the log are not used.
struct SceneWithLog {
    Scene scene;
    Log log;
};

/// @throws DataError unless the models are consecutive ranges that contain all surfels,
/// in order, and all instances have one of the models
void check_layout(const Scene& scene);
/// Returns a scene that has only a background model and its instance.
Scene wrap_background(Surfels surfels);
/// Returns a copy of the scene in which another background, sorted in kd-tree order,
/// replaces the background and all blocks.
Scene replace_background(const Scene& scene, const Surfels& background);
/// Copies a model and its surfels from another scene to the end of this scene.
/// @return index of the new model
std::uint32_t append_model(Scene& scene, const Scene& source_scene, std::uint32_t model_index);
/// Returns the same scene with a separate model for every instance.
Scene unshare_models(Scene scene);
/// Selects instances by name: "background", "actors" (all except the background), or a
/// track id.
/// @return [instances] true for each selected instance
/// @throws UsageError for an unknown name
std::vector<bool> select_instances(const Scene& scene, const std::vector<std::string>& instance_names);

/// Direction in which spherical harmonics are evaluated. `ray`: along each ray. `surfel`:
/// from the sensor to each surfel's mean.
enum class ShDirection { ray, surfel };

/// Constants of the image formation model (docs/method.md sections 2-3).
struct ImageModel {
    float near_m = 0.2f;              ///< Minimum range at which a ray can hit a surfel, metres.
    float alpha_min = 1.0f / 255.0f;  ///< Minimum alpha of a hit. Hits with a smaller alpha are skipped.
    float alpha_max = 0.99f;          ///< Upper bound of alpha. The gradient is zero if alpha is clamped.
    /// A ray ends before the surfel that would reduce its transmittance below this value.
    float transmittance_min = 1e-4f;
    int sh_degree = 3;  ///< Active SH degree, 0..3.
    ShDirection sh_direction = ShDirection::ray;
    /// If true, hit logits stay 0 (ablation), so that the drop probability, a softmax of
    /// hit and drop logits (docs/method.md M6), depends on the drop logits only.
    bool single_drop_logit = false;
    PrimitiveType primitive = PrimitiveType::surfel;  ///< Primitive of the scene (ablation).
    bool operator==(const ImageModel&) const = default;
};

/// Kind of a labelled object, the same for all datasets.
enum class ObjectKind {
    vehicle,  ///< Vehicle on more than two wheels or on rails, or a trailer.
    cyclist,  ///< Two-wheeler with or without a rider, or a rider.
    person,
    other
};
/// Maps a class name of KITTI, KITTI-360, Waymo, Argoverse 2 or nuScenes to a kind.
/// Returns `other` for an unknown name.
ObjectKind parse_kind(std::string_view category);
/// Returns the name of a kind in settings: vehicle, cyclist, person or other.
const char* name_of(ObjectKind kind);

/// Treatment of moving objects without a label. `background`: their points become
/// background. `removed`: points are removed if rays of other frames pass through them.
/// `actors`: like `removed`, and objects that are observed long enough become actors.
enum class UnlabelledMoverPolicy { background, removed, actors };

/// Options for creating the initial scene from a log.
struct InitOptions {
    /// Edge length of voxels in which points of all training frames are averaged, metres.
    double voxel_m = 0.15;
    /// Minimum edge length of a voxel, divided by its distance from the nearest sensor
    /// position. 0 = all have `voxel_m`.
    double voxel_growth = 0.0;
    /// If true, normals are estimated from neighbours. If false, they are random
    /// (ablation).
    bool normals = true;
    int normal_neighbours = 6;
    /// A point lies on a surface if the variance of its neighbours across the surface is
    /// less than this fraction of the smaller variance within the surface. Surfels on a
    /// surface are moved onto it. Other surfels (leaves, wires, corners) face the sensor.
    /// With 1, all surfels keep the position and normal of their points (paper).
    double flatness = 1.0;
    double opacity = 0.1;
    /// Initial hit logit minus initial drop logit of a surfel. Their mean is 0.5. The
    /// initial drop probability (softmax of both) is 1 / (1 + exp(hit_margin)).
    double hit_margin = 1.0;
    /// If true, surfels start with hit logit 0 and drop logit -hit_margin. Training sets
    /// this if it keeps all hit logits at 0 (ImageModel::single_drop_logit).
    bool one_logit = false;
    /// Upper bound of the initial standard deviations, metres, except over gaps
    /// (max_gap_m).
    double max_scale_m = 1000.0;
    /// Initial standard deviation divided by the mean distance to the 3 nearest points.
    double scale_factor = 1.0;
    /// Stretches surfels over gaps between scan lines. A gap must be much wider than the
    /// point spacing, but narrower than this (metres). 0 = off, as in the paper.
    double max_gap_m = 0.0;
    /// Initial scale of 3D Gaussians along the normal, relative to the scale in the
    /// plane. 1 = spheres, as in 3D Gaussian splatting.
    double thickness = 1.0;
    bool second_returns = false;  ///< If true, second returns of the log also become surfels.
    /// Treatment of moving objects without a label. The default is that of the paper.
    UnlabelledMoverPolicy unlabelled_movers = UnlabelledMoverPolicy::background;
    /// Moving boxes that become actors: comma-separated class names or kinds
    /// (parse_kind()), all, or empty for none.
    std::string actor_classes = "all";
    /// If true, moving boxes that do not become actors are excluded from training. If
    /// false, they are trained as background (paper).
    bool mask_others = true;
    /// Comma-separated track ids that become actors, regardless of class and motion.
    /// Empty = select actors by class.
    std::string actor_tracks;
    /// Actors whose shape changes, as comma-separated class names or kinds. Empty = none.
    std::string deform = "person,cyclist";
    /// Maximum number of surfels per actor, or 200 per frame if its shape changes.
    int actor_points = 8000;
    /// Actors with fewer surfels get random points in their box. 0 = off (paper: 8000).
    int actor_pad_to = 0;
    /// Boxes with fewer points do not become actors and are excluded from training.
    int actor_min_points = 20;
    /// Seed for random orientations and points. Training uses train.seed instead.
    std::uint64_t seed = 1;
    bool operator==(const InitOptions&) const = default;
};

/// Pose and motion of an instance during a sweep. An instance may be absent.
struct InstancePose {
    Pose world_from_model;
    bool present = true;
    double time_s = 0.0;  ///< Time at which the instance's track has the pose world_from_model.
    double phase = 0.0;   ///< Phase of the model's motion, which repeats after 1.
    PoseMotion motion{};  ///< Motion during the sweep, relative to world_from_model.
};

/// Finds moving objects without a label. Selects returns of training frames up to 40 m at
/// places through which rays of other frames pass. Groups these returns, and connects the
/// groups over time. Fits upright boxes of constant size whose x axis follows a smooth
/// path. Keeps a box if it is seen in 6 frames, moves 0.6 m and 0.9 of its size, and is
/// not part of the sensor's vehicle. If only one side was seen, the box size is a guess
/// (BoxTrack::size_guess).
///
/// An object with a label for part of the time keeps the id, class and size of the label,
/// gets poses before and after the labels (n_before, n_after), and replaces the labelled
/// box. Other boxes are named mover-0, mover-1, ... All processes of a group get the same
/// result. If several LiDARs saw an object, the first track is kept unless a later one is
/// more than 1.5 times as long.
std::vector<BoxTrack> discover_tracks(const Log& log, const std::vector<int>& frames,
                                      const Progress& progress = {}, const ProcessGroup& group = {});

/// Returns the boxes whose points and rays are kept out of the background: moving boxes
/// (BoxTrack::is_moving()) and the tracks listed in actor_tracks. With mask_others=false,
/// only the actors among them.
/// @throws DataError for a box without a size or with a pose that is not finite
/// @throws UsageError for an unknown track
std::vector<BoxTrack> list_foreground(const Log& log, const InitOptions& options);

/// Creates the background surfels from the training frames of a log, in the recentred
/// world frame and in kd-tree order, which software BVH builders without sorting need.
/// @throws DataError if no training frame has a usable point
Surfels init_background(const Log& log, const std::vector<int>& frames, const InitOptions& options,
                        const Progress& progress = {});

/// Creates the background, and one model and instance per actor, in the frame of the
/// actor's box (Eq. 4-5). Actors are moving boxes of the selected classes, or the
/// selected tracks. A point in two boxes belongs to both models.
/// @param notes output: for each actor of InitOptions::deform, whether its
/// shape changes, or the reason why it is rigid
/// @throws DataError if no training frame has a usable point
Scene init_scene(const Log& log, const std::vector<int>& frames, const InitOptions& options,
                 const Progress& progress = {}, std::vector<std::string>* notes = nullptr);

/// Returns the boxes that were removed from the background and have no model in the
/// scene, because of their class or their few points. Renderings lack their returns.
std::vector<BoxTrack> find_unmodelled(const Scene& scene, const Log& log, const InitOptions& options);
/// Returns the moving boxes that are neither background nor selected as actors.
std::vector<BoxTrack> find_unselected(const Log& log, const InitOptions& options);
/// Returns a list of track ids and classes, at most eight: "3 (Pedestrian), 7 (Tram)".
std::string format_box_list(const std::vector<BoxTrack>& boxes);

/// Computes poses and motions of all instances during a sweep, from the tracks of the
/// log. A box is absent before its first and after its last label.
std::vector<InstancePose> pose_instances(const Scene& scene, const Log& log, const SweepTiming& sweep);

/// Tracks of actors by name. Poses are box centres in relidar's world frame, interpolated
/// over time. Actors without an entry are absent.
using ActorTracksByName = std::map<std::string, PoseTrack>;
/// The same with tracks of the caller.
/// @param world_from_actor  [instances] null: the actor is absent
std::vector<InstancePose> pose_instances(const Scene& scene, const Log& log, const SweepTiming& sweep,
                                         std::span<const PoseTrack* const> world_from_actor);
/// Returns the surfels of all present instances at one time, with their poses and walking
/// motions, in the world frame.
/// @param poses [instances] pose of each instance
/// @throws DataError if the number of poses is wrong
Surfels freeze_scene(const Scene& scene, const std::vector<InstancePose>& poses);

/// Sorts points in kd-tree order, by recursive median splits along the longest axis. The
/// median of a range is at (first + last) / 2.
/// @return [n] permutation: position i of the sorted array holds point order[i]
std::vector<std::uint32_t> kd_tree_order(const std::vector<glm::vec3>& points);

/// Returns the extent of a model in metres, to which some settings are relative. Actors:
/// 4 times the diagonal of the box. Other models: 3 times the 90th percentile of 2 |p -
/// centre| over the surfels. Without surfels: 1.
double model_extent_m(const Scene& scene, std::size_t model_index);
/// Returns the extent of an actor's model in metres: 4 times the diagonal of its box.
double actor_extent_m(const glm::vec3& half_size_m);
/// The extent of the background.
double scene_extent_m(const Scene& scene);

/// Returns a copy of a scene that has everything but the surfels.
Scene strip_surfels(const Scene& scene);

}  // namespace relidar
