// SPDX-License-Identifier: Apache-2.0
// A scene on a device: parameters of all surfels and the table of their groups, the
// records that hits read, and where each model is placed.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include <relidar/scene/surfels.h>
#include <relidar/gpu/stream.hpp>
#include <relidar/scene/scene.hpp>

namespace relidar {

namespace shared {  // what arrays hold, as kernels tell them apart
struct Means;
struct Rotations;
struct LogScales;
struct OpacityLogits;
struct Harmonics;
struct ThirdLogScales;
struct Gaits;
struct RecordGradients;
struct TouchedSurfels;
struct TouchedRows;
struct TouchedCount;
struct ViewGradients;
}  // namespace shared

/// Parameters, gradients or moments of all surfels on a device, one array a group in the
/// layout of Surfels.
struct SurfelArrays {
    Array<float, shared::Means> mean;
    Array<float, shared::Rotations> rotation;
    Array<float, shared::LogScales> log_scale;
    Array<float, shared::OpacityLogits> opacity_logit;
    Array<float, shared::Harmonics> sh;
    Array<float, shared::ThirdLogScales> log_scale_w;  ///< of 3D Gaussians; not allocated for surfels
    Array<float, shared::Gaits> gait;  ///< of scenes with actors that bend; not allocated for others
    std::uint32_t n = 0;               ///< surfels; the arrays may hold more
    Primitive primitive = Primitive::surfel;
    bool bends = false;

    SurfelArrays() = default;
    SurfelArrays(Device& device, std::uint32_t n, const std::string& what, ParameterSet of = {});
    ParameterSet parameters() const { return {primitive, bends}; }
    /// @throws DataError where arrays, primitive or gait disagree
    void upload(const Surfels& surfels);
    Surfels download() const;
    /// Surfels there is room for in every group.
    std::uint32_t capacity() const;
    /// Makes room for so many surfels and keeps those there are; new room is undefined.
    /// Nothing may be in flight that uses the arrays.
    /// @throws DeviceError where memory is exhausted: some groups may then have grown,
    /// none has lost anything
    void reserve(Device& device, std::uint32_t capacity, const std::string& what);
    void fill_zero(Stream& stream);
};

/// Learning rates of one step.
struct LearningRates {
    double mean = 1.6e-4;  ///< metres; the schedule multiplies by the extent
    double rotation = 1e-3;
    double log_scale = 5e-3;  ///< the third of 3D Gaussians too
    double opacity_logit = 0.05;
    double sh = 2.5e-3;             ///< DC coefficient of each channel
    double sh_rest_factor = 0.05;   ///< of the other coefficients
    double gait = 1e-4;             ///< turns, metres
    double intensity_factor = 1.0;  ///< of all coefficients of the intensity, over those of the drop logits
    /// DeviceScene::models(), where there are factors of them
    const Array<shared::ModelEntry>* models = nullptr;
    std::vector<float> mean_factors = {};  ///< [models] of the means of each; none: 1
};

/// A group of parameters: what whoever treats all parameters alike (arrays, optimiser,
/// densification, files) has to know of it.
struct ParameterGroup {
    const char* name;  ///< of its array in files
    /// shape of the floats of one surfel; {3, 1} is a row of 3, {1, 1} a single number
    std::array<std::uint32_t, 2> row;
    double LearningRates::*rate;
    bool harmonics;  ///< the last dimension is the coefficients of the SH basis
    bool scales;     ///< standard deviations, which may be bounded
    /// which surfels have it: all, or those with what is named alone
    enum class Of { all, third_scale, bends } of;
    const Array<float>& (*device)(const SurfelArrays&);  ///< [n, floats()]
    Array<float>& (*mutable_device)(SurfelArrays&);      ///< the same, to be written
    std::span<const float> (*values)(const Surfels&);    ///< [n * floats()] on the host
    std::span<float> (*mutable_values)(Surfels&);        ///< the same, to be written
    void (*resize)(Surfels&, std::size_t n_floats);      ///< of the host's array

    constexpr std::uint32_t floats() const { return row[0] * row[1]; }  ///< a surfel
    std::vector<std::size_t> shape(std::size_t n) const;  ///< of the array in files: [n], [n,3] or [n,3,16]
};

/// A group that the host keeps in the member kHost of Surfels.
template <auto kHost, auto kDevice>
constexpr ParameterGroup describe_group(const char* name, std::array<std::uint32_t, 2> row,
                                        double LearningRates::*rate, bool harmonics = false,
                                        bool scales = false,
                                        ParameterGroup::Of of = ParameterGroup::Of::all) {
    using Element = typename std::remove_reference_t<decltype(std::declval<Surfels&>().*kHost)>::value_type;
    constexpr std::size_t kFloats = sizeof(Element) / sizeof(float);
    return {name,
            row,
            rate,
            harmonics,
            scales,
            of,
            [](const SurfelArrays& arrays) -> const Array<float>& { return arrays.*kDevice; },
            [](SurfelArrays& arrays) -> Array<float>& { return arrays.*kDevice; },
            [](const Surfels& s) {
                return std::span(reinterpret_cast<const float*>((s.*kHost).data()),
                                 kFloats * (s.*kHost).size());
            },
            [](Surfels& s) {
                return std::span(reinterpret_cast<float*>((s.*kHost).data()), kFloats * (s.*kHost).size());
            },
            [](Surfels& s, std::size_t n_floats) { (s.*kHost).resize(n_floats / kFloats); }};
}

/// Every group there is; those that not all surfels have are the first and the last, so
/// that the others and any of the two are a range. A new parameter is a member of Surfels
/// and of SurfelArrays, a pointer for kernels, and a row here.
inline constexpr std::array<ParameterGroup, 7> kParameterGroups{{
    describe_group<&Surfels::gait, &SurfelArrays::gait>("gait", {5, 1}, &LearningRates::gait, false, false,
                                                        ParameterGroup::Of::bends),
    describe_group<&Surfels::mean, &SurfelArrays::mean>("mean", {3, 1}, &LearningRates::mean),
    describe_group<&Surfels::rotation, &SurfelArrays::rotation>("rotation", {4, 1}, &LearningRates::rotation),
    describe_group<&Surfels::log_scale, &SurfelArrays::log_scale>("log_scale", {2, 1},
                                                                  &LearningRates::log_scale, false, true),
    describe_group<&Surfels::opacity_logit, &SurfelArrays::opacity_logit>("opacity_logit", {1, 1},
                                                                          &LearningRates::opacity_logit),
    describe_group<&Surfels::sh, &SurfelArrays::sh>("sh", {kShChannels, kShCoefficients}, &LearningRates::sh,
                                                    true),
    describe_group<&Surfels::log_scale_w, &SurfelArrays::log_scale_w>(
        "log_scale_w", {1, 1}, &LearningRates::log_scale, false, true, ParameterGroup::Of::third_scale),
}};

/// The groups of surfels.
constexpr std::span<const ParameterGroup> groups_of(ParameterSet of) {
    const std::size_t first = of.bends ? 0 : 1,
                      last = kParameterGroups.size() - (kind_of(of.primitive).third_scale ? 0 : 1);
    return std::span(kParameterGroups).subspan(first, last - first);
}

/// Where models and checkpoints say what they are made of.
inline constexpr const char* kPrimitiveKey = "primitive";
/// What a file says that it is made of, and whether it has a gait.
/// @param texts  of the file @param key  of the one that says it @param has_array
/// whether the file has an array of a group of this name
/// @throws DataError if the text is missing or names no primitive
ParameterSet stored_parameters(const std::map<std::string, std::string>& texts, const std::string& key,
                               const std::function<bool(const char*)>& has_array);
/// Parameters of a surfel.
constexpr std::uint32_t floats_per_surfel(ParameterSet of) {
    std::uint32_t sum = 0;
    for (const ParameterGroup& group : groups_of(of)) sum += group.floats();
    return sum;
}

namespace shared {
struct SurfelPointers;  // of kernels
}
/// The arrays as kernels are given them.
shared::SurfelPointers pointers_of(const SurfelArrays& arrays);

/// Numbers of the rows that are marked, found in a stream and read by the kernels that
/// follow: lanes of a CPU that have nothing to do cost as much as the others.
class TouchedList {
public:
    explicit TouchedList(Device& device);
    ~TouchedList();
    /// Records the search. Waits for the stream where there are more rows than ever.
    /// @param touched [n_rows] 0 or 1
    void find(Stream& stream, Address<std::uint32_t, shared::TouchedSurfels> touched, std::uint32_t n_rows);
    Address<std::uint32_t, shared::TouchedRows> rows() const;    ///< [count] in no order
    Address<std::uint32_t, shared::TouchedCount> count() const;  ///< [1]
    /// Threads for a step over the list, of which the device alone knows how long it is.
    /// @param most  for the longest list
    std::size_t threads(std::size_t most) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Pose and motion of a tracked box in a sweep, as place_instances() takes them. The pose
/// is the track's own at the first and the last time at which a ray may meet the box, and
/// is interpolated between these times. A box behind a spinning sensor is met at the
/// begin and at the end of the sweep.
/// @param half_size_m [3] of the box; 0: not known, then any ray may meet it
InstancePose pose_in_sweep(const Sequence& sequence, const PoseTrack& world_from_box,
                           const glm::dvec3& half_size_m, const SweepMoment& sweep);

/// What the activation's derivative reads and writes.
struct ActivationGradients {
    const Array<float, shared::RecordGradients>* d_records = nullptr;  ///< [gradient_rows,16] input
    SurfelArrays* d_surfels = nullptr;                                 ///< output
    /// [n] output: 1 where any record gradient is not zero
    Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
    /// [n,3] output with ShDirection::surfel: dL/d(view origin) by way of each surfel,
    /// model frame; null where not wanted
    Array<float, shared::ViewGradients>* d_view = nullptr;
    bool zero_untouched = true;  ///< write zeros for surfels without a gradient
    /// touched is 1 already where a surfel may have a gradient, else 0. With
    /// lists_touched() and without zero_untouched the other surfels are not looked at
    /// then, and what d_view has of them stays.
    bool touched_is_marked = false;
};

/// A scene on a device: parameters, the records that hits read, and the instance table.
class DeviceScene {
public:
    /// @throws DataError where the models are not consecutive ranges that hold all
    /// surfels, or an instance places none of them
    /// @param stage_harmonics  activation and its derivative move harmonics through
    /// shared memory, whole lines at a time, instead of each thread its own surfel's; not
    /// given: on GPUs
    DeviceScene(Device& device, const Scene& scene, std::optional<bool> stage_harmonics = std::nullopt);
    ~DeviceScene();

    /// Poses of all instances, world_from_model, one each: all present. Blocking upload.
    void set_poses(const std::vector<Pose>& world_from_instance);
    /// The same with motions; instances may be absent.
    void set_poses(const std::vector<InstancePose>& placed);
    /// The same as part of a stream, without a wait; instances may be absent. The
    /// acceleration structure follows with its next update or move.
    void place(Stream& stream, const std::vector<InstancePose>& placed);
    const std::vector<InstancePose>& poses() const;
    /// Whether an actor that bends would be at another phase of its gait than it is: then
    /// records are stale once it is placed.
    bool bends_otherwise(const std::vector<InstancePose>& placed) const;
    /// Records the activation kernel: records from parameters (M1, M2, M9), channels too
    /// with ShDirection::surfel.
    /// @throws UsageError where the model is of another primitive than the scene
    /// @param view_origin_m [3] world. A model placed twice sees it from its first
    /// instance (see own_models).
    void activate(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m);
    /// Whether the chain rule can go over a list of surfels: on CPUs, where harmonics are
    /// not staged.
    bool lists_touched() const;
    /// Records the chain rule back from record gradients to parameters. SH gradients are
    /// written with ShDirection::surfel; with ShDirection::ray the hits have accumulated
    /// them already.
    void activate_vjp(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m,
                      const ActivationGradients& gradients);

    /// Makes room for so many surfels in parameters and records. As
    /// SurfelArrays::reserve.
    void reserve(Device& device, std::uint32_t capacity);
    /// New ranges of the same models, after the parameter arrays were rearranged; size()
    /// is then their sum and the records are stale. The instance table follows with the
    /// next place() or set_poses().
    void set_models(const std::vector<Model>& models);

    const Scene& layout() const;  ///< models and instances; its surfels are empty
    SurfelArrays& parameters();
    const SurfelArrays& parameters() const;
    const Array<shared::SurfelRecord>& records() const;  ///< [n]
    float alpha_min() const;                          ///< the records were activated for: where a surfel ends
    const Array<shared::ModelEntry>& models() const;  ///< [models] in the order of their ranges
    const Array<shared::InstanceEntry>& instances() const;  ///< [instances] as placed last
    std::uint32_t size() const;                             ///< surfels
    Primitive primitive() const;
    /// of the record gradients of an instance's surfels
    std::uint32_t first_gradient_row(std::size_t instance) const;
    /// of record gradients: surfels, then those of every further placement of a model
    std::uint32_t gradient_rows() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
