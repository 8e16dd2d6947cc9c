// SPDX-License-Identifier: Apache-2.0
// A scene of 2D Gaussians (surfels): a background and one set per actor, each set a
// model, placed by instances (Eq. 1, 4, 5). Or of 3D Gaussians, with a third scale; what
// is said of surfels holds for them too.
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
#include <relidar/log/sequence.hpp>

namespace relidar {

inline constexpr int kShCoefficients = 16;  ///< real SH basis of degree 3
inline constexpr int kShChannels = 3;       ///< intensity, hit logit, drop logit
inline constexpr int kShFloats = kShChannels * kShCoefficients;

/// What a scene is made of: surfels, or 3D Gaussians (docs/method.md section 2). Whoever
/// treats them differently asks their row below.
enum class Primitive {
#define RELIDAR_PRIMITIVE(number, name, label, third_scale, normals, proxy) name = number,
    RELIDAR_PRIMITIVES(RELIDAR_PRIMITIVE)  // a value each
#undef RELIDAR_PRIMITIVE
};

/// Triangles that stand for one in a driver's tree: two that share the plane of a surfel,
/// or twenty around an ellipsoid.
enum class ProxyMesh { rectangle, icosahedron };

/// A row of RELIDAR_PRIMITIVES, which says what each means.
struct PrimitiveKind {
    Primitive primitive;
    const char* name;
    const char* label;
    bool third_scale;
    bool has_normals;
    ProxyMesh mesh;
};

inline constexpr std::array kPrimitives{
#define RELIDAR_PRIMITIVE(number, name, label, third_scale, normals, proxy) \
    PrimitiveKind{Primitive::name, #name, label, third_scale, normals, ProxyMesh::proxy},
    RELIDAR_PRIMITIVES(RELIDAR_PRIMITIVE)  // a row each
#undef RELIDAR_PRIMITIVE
};
/// The row of a primitive.
constexpr const PrimitiveKind& kind_of(Primitive primitive) {
    return kPrimitives[static_cast<std::size_t>(primitive)];
}

/// How a surfel of an actor that walks takes part in its gait, at a phase of p turns
/// (InstancePose::phase, docs/method.md M14):
///   opacity exp(sharpness^2 (cos 2 pi (p - phase) - 1)),   mean + swing sin 2 pi (p - phase)
/// All zero: a surfel that is always there and rests.
struct Gait {
    float phase = 0.0f;      ///< turns: when it is most there, and where its mean is
    float sharpness = 0.0f;  ///< 0: there at every phase
    glm::vec3 swing{0.0f};   ///< [3] metres, model frame
};

/// Which parameters surfels have.
struct ParameterSet {
    Primitive primitive;
    bool bends;  ///< a gait too
    constexpr ParameterSet(Primitive p = Primitive::surfel, bool b = false) : primitive(p), bends(b) {}
    bool operator==(const ParameterSet&) const = default;
};

/// Surfels as they are stored and optimised (structure of arrays). All frames are the
/// model's own.
struct Surfels {
    std::vector<glm::vec3> mean;  ///< [n,3] metres
    /// [n,4] quaternion w, x, y, z, unnormalised; columns of R: a_u, a_v, normal
    std::vector<glm::vec4> rotation;
    std::vector<glm::vec2> log_scale;  ///< [n,2] ln metres, standard deviations along a_u, a_v
    std::vector<float> opacity_logit;  ///< [n]
    std::vector<float> sh;  ///< [n,3,16] channel-major: value = 0.5 + basis(direction) . coefficients
    /// [n] ln metres along the third axis of primitives with a third scale; empty for
    /// others
    std::vector<float> log_scale_w;
    std::vector<Gait> gait;  ///< [n] where any of them bends; else empty
    Primitive primitive = Primitive::surfel;
    bool bends = false;  ///< there is a gait

    std::size_t size() const { return mean.size(); }
    ParameterSet parameters() const { return {primitive, bends}; }
    void resize(std::size_t n) { resize(n, parameters()); }
    void resize(std::size_t n, ParameterSet of);
    void add_gait();  ///< in which they rest, where there is none
    /// Appends the surfels of another set; an empty set takes its primitive. Where one of
    /// the two has a gait, the other rests in it.
    /// @throws DataError where the primitives differ
    void append(const Surfels& other);
    /// Reorders: surfel i of the result is surfel order[i] of this set.
    Surfels permuted(const std::vector<std::uint32_t>& order) const;
    /// Surfels first ... first + count - 1 as a set of their own.
    Surfels slice(std::size_t first, std::size_t count) const;
    /// @throws DataError where the arrays disagree in length
    void check_shapes() const;
};

/// Makes another primitive of surfels. Where it has a third scale, that is `thickness`
/// times the geometric mean of the two in the plane.
void make_primitive(Surfels& surfels, Primitive primitive, double thickness);

/// A contiguous range of a scene's surfels with a frame of its own.
struct Model {
    std::string name;  ///< "background" or the track id
    std::uint32_t first = 0;
    std::uint32_t count = 0;
    /// of the box around the origin that its surfels belong in, model frame; 0 =
    /// unbounded
    glm::vec3 half_size_m{0.0f};
    float stride_m = 0.0f;  ///< way of one turn of its gait (two steps of a person); 0: it is rigid
};

/// A model placed in the world. Instance 0 is the background with the identity pose.
struct Instance {
    std::uint32_t model = 0;
    std::string track;  ///< empty for the background
};

/// A part of a background that stays in its file until a sensor comes near: what was
/// trained on one stretch of a street.
struct SceneBlock {
    std::filesystem::path file;  ///< of save_model(): the surfels of its first model
    std::uint32_t count = 0;     ///< of them
    /// [3] corners of the box around them, three standard deviations of each included;
    /// world
    glm::vec3 low_m{0.0f};
    glm::vec3 high_m{0.0f};

    /// From a point of the world to the box; 0 inside.
    double distance_m(const glm::dvec3& point_m) const {
        return glm::distance(point_m, glm::clamp(point_m, glm::dvec3(low_m), glm::dvec3(high_m)));
    }
};

/// Everything that can be rendered.
struct Scene {
    Surfels surfels;
    std::vector<Model> models;
    std::vector<Instance> instances;
    /// of the log's own LiDARs, a row a beam (Sequence::beam_number); empty where it was
    /// not estimated
    DropTable sensor_drop;
    /// of the background, beside the surfels of model 0; none: it is all in memory
    std::vector<SceneBlock> blocks = {};
};

/// Surfels of a scene, those of its blocks too.
std::size_t count_surfels(const Scene& scene);

/// A scene and the log whose box tracks place its instances; an instance has the name of
/// its track. Scans are not looked at.
struct DrivingScene {
    Scene scene;
    Sequence sequence;
};

/// A scene of one model, the background, with one instance.
Scene make_background_scene(Surfels surfels);
/// The scene with another background, which is put into kd order, and without blocks.
Scene with_background(const Scene& scene, const Surfels& background);
/// Appends a model of another scene, with its surfels. @return its number
std::uint32_t append_model(Scene& scene, const Scene& other, std::uint32_t model);
/// The same scene with a model of its own for every instance: the surfels of a model
/// placed n times are there n times.
Scene own_models(Scene scene);
/// Which instances some names mean: "background", "actors" (all others), or a track.
/// @return [instances]
/// @throws UsageError for a name that is none of them, naming the nearest
std::vector<bool> select_instances(const Scene& scene, const std::vector<std::string>& names);

/// Direction in which spherical harmonics are evaluated.
enum class ShDirection { ray, surfel };

/// The constants of the image formation model, docs/method.md sections 2-3.
struct ImageModel {
    float near_m = 0.2f;              ///< hits nearer than this are ignored
    float alpha_min = 1.0f / 255.0f;  ///< a surfel contributing less is skipped
    float alpha_max = 0.99f;          ///< alpha is clamped to this (gradient zero where clamped)
    /// a surfel that would bring T under this is not blended and ends the ray
    float transmittance_min = 1e-4f;
    int sh_degree = 3;  ///< active SH degree, 0..3
    ShDirection sh_direction = ShDirection::ray;
    /// hit logits are 0 and have no gradient: M6 is a sigmoid of the drop logit
    /// (ablation)
    bool single_drop_logit = false;
    Primitive primitive = Primitive::surfel;  ///< what the scene is made of (ablation)
    bool operator==(const ImageModel&) const = default;
};

/// What a labelled thing is, whatever its dataset calls it.
enum class ObjectKind {
    vehicle,  ///< on more than two wheels, or on rails; trailers too
    cyclist,  ///< two-wheelers, with a rider or without, and riders
    person,
    other
};
/// Of a class of KITTI, KITTI-360, Waymo, Argoverse 2 or nuScenes; `other` for a word
/// that none of them has.
ObjectKind object_kind(std::string_view category);
/// "vehicle", "cyclist", "person", "other": what settings name them by.
const char* name_of(ObjectKind kind);

/// What becomes of what moves without a label: it belongs to the background; its points
/// are left out, where other training frames see through them; or that, and what is seen
/// long enough is an actor with a track of its own (discover_tracks()).
enum class UnlabelledMovers { background, removed, actors };

/// How a scene is initialised from a log.
struct InitialiseOptions {
    double voxel_m = 0.15;  ///< points of all training frames are averaged per voxel
    /// voxel edge grows by this share of the range to the nearest sensor position (0 =
    /// paper)
    double voxel_growth = 0.0;
    /// surfel normals from the k nearest neighbours; false = random orientation
    /// (ablation)
    bool normals = true;
    int normal_neighbours = 6;
    /// points are a surface where their variance across it is less than this share of the
    /// smaller one within; discs of others (leaves, wires, corners) face the sensor
    /// instead of following their points, and those of surfaces lie on the plane of their
    /// neighbours; 1 = all follow their points as they are (paper)
    double flatness = 1.0;
    double opacity = 0.1;
    /// hit logit less drop logit of new surfels, whose mean is 0.5: a surface starts at a
    /// ray-drop probability of 1 / (1 + exp(it)) (M6)
    double hit_margin = 1.0;
    /// hit logits start at 0 and drop logits at their difference
    /// (ImageModel::single_drop_logit)
    bool one_logit = false;
    double max_scale_m = 1000.0;  ///< initial standard deviations are clamped to this, but across gaps
    double scale_factor = 1.0;    ///< times the mean distance to the 3 nearest neighbours
    /// a disc on a surface reaches across the gap to the next scan lines, up to so wide a
    /// one, where that is far wider than the distance to its neighbours on its own line;
    /// 0 = discs are round (paper)
    double max_gap_m = 0.0;
    /// 3D Gaussians: along the normal over in the plane; 1 = spheres, as 3D Gaussian
    /// splatting starts
    double thickness = 1.0;
    bool second_returns = false;  ///< second returns of the log are points too
    UnlabelledMovers unlabelled_movers = UnlabelledMovers::background;  ///< (paper)
    /// comma-separated kinds (object_kind()) or classes of moving boxes that become
    /// actors of their own; all = every class, empty = none
    std::string actor_classes = "all";
    /// moving boxes of other classes are left out; false = they belong to the background
    /// (paper)
    bool mask_others = true;
    /// comma-separated tracks that do, whatever their class and motion; empty = by class
    std::string actor_tracks;
    /// the same of those that follow a gait where their points show one; empty = none
    /// (paper)
    std::string deform = "person,cyclist";
    int actor_points = 8000;  ///< an actor has at most so many surfels
    /// an actor with fewer is filled up with random points of its box; 0 = not (paper:
    /// 8000)
    int actor_pad_to = 0;
    int actor_min_points = 20;  ///< a box with fewer points is masked instead
    std::uint64_t seed = 1;     ///< of random orientations and points; a training takes train.seed
    bool operator==(const InitialiseOptions&) const = default;
};

/// Where an instance is, or that it is absent.
struct InstancePose {
    Pose world_from_model;
    bool present = true;
    double time_s = 0.0;  ///< place_instances: the time at which its track is at world_from_model
    double phase = 0.0;   ///< turns of its model's gait
    PoseMotion motion{};  ///< during the sweep, about world_from_model
};

/// What moves without a label: returns of training frames, within 40 m, that others see
/// through, linked and placed as upright boxes of one size, x along a smooth path; seen
/// in 6 frames, 0.6 m and 0.9 of its size far, no part of the sensor's vehicle. A size is
/// a guess (size_guess) where one side was seen. What a label follows for a while is that
/// box, its id, class and size, with more poses (n_before, n_after), to stand in its
/// place; others are mover-0, mover-1, ... The same in all processes of a group. Each
/// LiDAR is asked by itself: of a mover that several have seen the first one's track,
/// unless another saw it half as long again.
std::vector<BoxTrack> discover_tracks(const Sequence& sequence, const std::vector<int>& train_positions,
                                      const Progress& progress = {}, const ProcessGroup& group = {});

/// Boxes whose points and rays are not the background's: those that move
/// (BoxTrack::moves), and the tracks asked for.
/// @throws DataError for a box without a size or with a pose that is not finite,
/// UsageError for an unknown track
std::vector<BoxTrack> separate_boxes(const Sequence& sequence, const InitialiseOptions& options);

/// Background surfels from the training frames of a log, in the recentred world. Order:
/// kd (recursive object median along the longest axis), which software BVH builders
/// without sorting need.
/// @throws DataError where no training frame has a usable point
Surfels initialise_background(const Sequence& sequence, const std::vector<int>& train_positions,
                              const InitialiseOptions& options, const Progress& progress = {});

/// The background and one model and instance for every moving box of the wanted classes,
/// or for the wanted tracks, in the frame of the box (Eq. 4-5). Points that lie in two
/// boxes go into both models. Points come from training frames only. @throws DataError as
/// initialise_background
/// @param notes  output: which actors of InitialiseOptions::deform are rigid all the
/// same, and why
Scene initialise_scene(const Sequence& sequence, const std::vector<int>& train_positions,
                       const InitialiseOptions& options, const Progress& progress = {},
                       std::vector<std::string>* notes = nullptr);

/// Boxes that separate_boxes() leaves out of the background and no instance stands for:
/// of an unwanted class, or with too few points. Their rays teach nothing and their
/// returns are missing from what is rendered.
std::vector<BoxTrack> masked_boxes(const Scene& scene, const Sequence& sequence,
                                   const InitialiseOptions& options);
/// The same before there is a scene: those of unwanted classes alone.
std::vector<BoxTrack> unwanted_boxes(const Sequence& sequence, const InitialiseOptions& options);
/// Their tracks and classes in a few words, at most eight of them by name: "3
/// (Pedestrian), 7 (Tram)".
std::string names_of(const std::vector<BoxTrack>& boxes);

/// Poses and motions of all instances in a sweep (pose_in_sweep()). A box is absent
/// outside its first and last label.
std::vector<InstancePose> place_instances(const Scene& scene, const Sequence& sequence,
                                          const SweepMoment& sweep);

/// Where actors are, by their tracks' names: centres of their boxes (relidar's world),
/// taken as PoseTrack::at. Others are absent.
using ActorPoses = std::map<std::string, PoseTrack>;
/// The same with the actors where the caller has them. The sequence says how the sensor
/// turns and where it is.
/// @throws UsageError for a name that no instance has, naming the nearest
std::vector<InstancePose> place_instances(const Scene& scene, const Sequence& sequence,
                                          const SweepMoment& sweep, const ActorPoses& world_from_actor);
/// All surfels of a scene at one moment, in the world: actors where they stand, bent as
/// they walk then, their harmonics turned with them; absent ones are left out. @param
/// placed [instances] @throws DataError for another number of poses
Surfels freeze(const Scene& scene, const std::vector<InstancePose>& placed);

/// Recursive object-median order of points along the longest axis, split at (first +
/// last) / 2.
/// @return [n] permutation: position i of the sorted array holds point order[i]
std::vector<std::uint32_t> kd_order(const std::vector<glm::vec3>& points);

/// Where training's extent-relative settings come from, metres: of an actor 4 x the
/// diagonal of its box, else 3 x the 90th percentile of 2 |p - centre| over the model's
/// surfels; 1 where it has none.
double model_extent(const Scene& scene, std::size_t model);
/// The same of a box. @param half_size_m [3]
double box_extent(const glm::vec3& half_size_m);
/// The same of the background.
double background_extent(const Scene& scene);

/// Models, instances, blocks and sensor-level ray-drop of a scene, without its surfels.
Scene layout_of(const Scene& scene);

}  // namespace relidar
