// SPDX-License-Identifier: Apache-2.0
// Scene on a device: the parameters of all surfels, the table of parameter groups, the
// surfel records that tracing kernels read, and the placement of each model.
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

// Content types of device arrays. Kernels use them to distinguish arrays of the same
// element type.
namespace shared {
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

/// Parameters, gradients or optimiser moments of all surfels on a device. One array per
/// parameter group, in the layout of Surfels.
struct SurfelArrays {
    Array<float, shared::Means> mean;
    Array<float, shared::Rotations> rotation;
    Array<float, shared::LogScales> log_scale;
    Array<float, shared::OpacityLogits> opacity_logit;
    Array<float, shared::Harmonics> sh;
    /// Third scales of 3D Gaussians; not allocated for surfels.
    Array<float, shared::ThirdLogScales> log_scale_w;
    /// Gaits of scenes with walking actors; not allocated for other scenes.
    Array<float, shared::Gaits> gait;
    std::uint32_t n = 0;  ///< Number of surfels. The arrays may be larger.
    Primitive primitive = Primitive::surfel;
    bool bends = false;

    SurfelArrays() = default;
    SurfelArrays(Device& device, std::uint32_t n, const std::string& what, ParameterSet of = {});
    ParameterSet parameters() const { return {primitive, bends}; }
    /// Uploads all parameter groups.
    /// @throws DataError if array lengths, primitive or gait disagree with these arrays
    void upload(const Surfels& surfels);
    Surfels download() const;
    /// Returns the number of surfels that fit in the arrays of every group.
    std::uint32_t capacity() const;
    /// Grows the arrays to at least `capacity` surfels and keeps the existing values; new
    /// values are undefined. No pending submission may use the arrays.
    /// @throws DeviceError if device memory is exhausted. Some groups may then have
    /// grown, but no values are lost
    void reserve(Device& device, std::uint32_t capacity, const std::string& what);
    void fill_zero(Stream& stream);
};

/// Learning rates of an optimiser step.
struct LearningRates {
    double mean = 1.6e-4;  ///< Rate of the means, metres. The schedule multiplies it by the extent.
    double rotation = 1e-3;
    double log_scale = 5e-3;  ///< Rate of all scales, including the third scale of 3D Gaussians.
    double opacity_logit = 0.05;
    double sh = 2.5e-3;            ///< Rate of the DC coefficient of each channel.
    double sh_rest_factor = 0.05;  ///< Rate of the other SH coefficients, relative to `sh`.
    double gait = 1e-4;            ///< Rate of the gait parameters, in turns and metres.
    /// Rate of all intensity coefficients, relative to the rate of the drop logits.
    double intensity_factor = 1.0;
    /// DeviceScene::models(), required if mean_factors is not empty.
    const Array<shared::ModelEntry>* models = nullptr;
    /// Factor of the rate of the means for each model, [models]; empty = 1.
    std::vector<float> mean_factors = {};
};

/// Description of a parameter group, for code that treats all parameters alike: arrays,
/// optimiser, densification and files.
struct ParameterGroup {
    const char* name;  ///< Name of the group's array in files.
    /// Shape of the floats of a surfel. {3, 1} is a row of 3, {1, 1} is a single
    /// number.
    std::array<std::uint32_t, 2> row;
    double LearningRates::*rate;
    bool harmonics;  ///< True if the last dimension holds coefficients of the SH basis.
    bool scales;     ///< True for standard deviations, which may be bounded.
    /// Surfels that have this group: all, only primitives with a third scale, or only
    /// surfels with a gait.
    enum class Of { all, third_scale, bends } of;
    const Array<float>& (*device)(const SurfelArrays&);  ///< Returns the device array, [n, floats()].
    /// Returns the device array for writing, [n, floats()].
    Array<float>& (*mutable_device)(SurfelArrays&);
    /// Returns the values on the host, [n * floats()].
    std::span<const float> (*values)(const Surfels&);
    /// Returns the values on the host for writing, [n * floats()].
    std::span<float> (*mutable_values)(Surfels&);
    void (*resize)(Surfels&, std::size_t n_floats);  ///< Resizes the array on the host.

    constexpr std::uint32_t floats() const { return row[0] * row[1]; }  ///< Number of floats per surfel.
    /// Returns the shape of the array in files: [n], [n,3] or [n,3,16].
    std::vector<std::size_t> shape(std::size_t n) const;
};

/// Describes the parameter group that is stored in member kHost of Surfels and member
/// kDevice of SurfelArrays.
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

/// All parameter groups. The two optional groups are the first and the last, so that each
/// combination is a contiguous range. A new parameter needs a member of Surfels, a member
/// of SurfelArrays, a pointer for kernels and a row here.
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

/// Returns the parameter groups of a parameter set.
constexpr std::span<const ParameterGroup> groups_of(ParameterSet of) {
    const std::size_t first = of.bends ? 0 : 1,
                      last = kParameterGroups.size() - (kind_of(of.primitive).third_scale ? 0 : 1);
    return std::span(kParameterGroups).subspan(first, last - first);
}

/// Metadata key of the primitive in model and checkpoint files.
inline constexpr const char* kPrimitiveKey = "primitive";
/// Reads the primitive of a file, and whether its surfels have a gait.
/// @param texts metadata of the file
/// @param key metadata key of the primitive
/// @param has_array returns true if the file has an array of this group name
/// @throws DataError if the key is missing or names no primitive
ParameterSet stored_parameters(const std::map<std::string, std::string>& texts, const std::string& key,
                               const std::function<bool(const char*)>& has_array);
/// Returns the number of parameters per surfel.
constexpr std::uint32_t floats_per_surfel(ParameterSet of) {
    std::uint32_t sum = 0;
    for (const ParameterGroup& group : groups_of(of)) sum += group.floats();
    return sum;
}

namespace shared {
struct SurfelPointers;  // Pointers to surfel parameters, for kernels.
}
/// Returns the device addresses of all parameter arrays, for kernels.
shared::SurfelPointers pointers_of(const SurfelArrays& arrays);

/// List of the rows marked in an array. A kernel builds it, and later kernels of the
/// stream read it. It helps on a CPU device, where idle lanes cost as much as active
/// lanes.
class TouchedList {
public:
    explicit TouchedList(Device& device);
    ~TouchedList();
    /// Records the search for marked rows. Waits for the stream if there are more rows
    /// than in any earlier call.
    /// @param touched [n_rows] 0 or 1
    void find(Stream& stream, Address<std::uint32_t, shared::TouchedSurfels> touched, std::uint32_t n_rows);
    /// Indices of the marked rows, [count], unordered.
    Address<std::uint32_t, shared::TouchedRows> rows() const;
    Address<std::uint32_t, shared::TouchedCount> count() const;  ///< Number of marked rows, [1].
    /// Returns the number of threads for a kernel over the list, because only the device
    /// knows the length of the list.
    /// @param most threads needed for the longest possible list
    std::size_t threads(std::size_t most) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Computes pose and motion of a tracked box in a sweep, for place_instances(). The pose
/// equals the track at the first and the last time at which a ray may hit the box. It is
/// interpolated between these times. A box behind a spinning sensor is hit at the start
/// and at the end of the sweep.
/// @param half_size_m [3] half size of the box; 0 = unknown, then any ray may hit the box
InstancePose pose_in_sweep(const Sequence& sequence, const PoseTrack& world_from_box,
                           const glm::dvec3& half_size_m, const SweepMoment& sweep);

/// Inputs and outputs of activate_vjp(), the derivative of the activation.
struct ActivationGradients {
    /// Input: gradients with respect to the records, [gradient_rows,16].
    const Array<float, shared::RecordGradients>* d_records = nullptr;
    SurfelArrays* d_surfels = nullptr;  ///< Output: gradients with respect to the surfel parameters.
    /// Output: 1 for each surfel whose record gradient is not zero, [n].
    Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
    /// Output with ShDirection::surfel: dL/d(view origin) through each surfel, [n,3],
    /// model frame. Null if not needed.
    Array<float, shared::ViewGradients>* d_view = nullptr;
    bool zero_untouched = true;  ///< If true, writes zeros for surfels without a gradient.
    /// If true, `touched` already contains 1 for each surfel that may have a gradient,
    /// otherwise 0. With lists_touched() and without zero_untouched, other surfels are
    /// then skipped, and their entries of d_view are not written.
    bool touched_is_marked = false;
};

/// Scene on a device: surfel parameters, the records that tracing kernels read, and the
/// instance table.
class DeviceScene {
public:
    /// Uploads a scene.
    /// @param stage_harmonics if true, the activation and its derivative move SH
    /// coefficients through shared memory in full cache lines. If false, each thread
    /// reads the coefficients of its surfel directly. Default: true on GPUs
    /// @throws DataError if the models are not consecutive ranges that contain all
    /// surfels, or an instance refers to a model that does not exist
    DeviceScene(Device& device, const Scene& scene, std::optional<bool> stage_harmonics = std::nullopt);
    ~DeviceScene();

    /// Sets the poses of all instances, world_from_model, one per instance. All instances
    /// become present. Blocks until the upload is done.
    void set_poses(const std::vector<Pose>& world_from_instance);
    /// Sets the poses and motions of all instances. Instances may be absent. Blocks until
    /// the upload is done.
    void set_poses(const std::vector<InstancePose>& placed);
    /// Sets the poses and motions of all instances as part of a stream, without waiting.
    /// Instances may be absent. The acceleration structure uses the new poses after its
    /// next update or move.
    void place(Stream& stream, const std::vector<InstancePose>& placed);
    const std::vector<InstancePose>& poses() const;
    /// Returns true if these poses change the gait phase of a walking actor. The records
    /// are then out of date once the poses are set.
    bool bends_otherwise(const std::vector<InstancePose>& placed) const;
    /// Records the activation kernel, which computes surfel records from parameters (M1,
    /// M2, M9). With ShDirection::surfel it also computes the channel values.
    /// @param view_origin_m [3] world frame. A model with several instances uses the view
    /// of its first instance (see own_models)
    /// @throws UsageError if the primitive of `model` is not the primitive of the scene
    void activate(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m);
    /// Returns true if activate_vjp() can process a list of touched surfels. This is
    /// possible on CPUs, where SH coefficients are not staged.
    bool lists_touched() const;
    /// Records the kernel that computes parameter gradients from record gradients by the
    /// chain rule. It writes SH gradients only with ShDirection::surfel. With
    /// ShDirection::ray, the backward pass has already accumulated the SH gradients for
    /// each hit.
    void activate_vjp(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m,
                      const ActivationGradients& gradients);

    /// Grows the arrays of parameters and records to at least `capacity` surfels, like
    /// SurfelArrays::reserve().
    void reserve(Device& device, std::uint32_t capacity);
    /// Sets new surfel ranges of the models after the parameter arrays were rearranged.
    /// size() becomes the sum of the ranges, and the records are out of date. The
    /// instance table is updated by the next place() or set_poses().
    void set_models(const std::vector<Model>& models);

    const Scene& layout() const;  ///< Models and instances of the scene, without surfels.
    SurfelArrays& parameters();
    const SurfelArrays& parameters() const;
    const Array<shared::SurfelRecord>& records() const;  ///< Surfel records, [n].
    /// alpha_min of the last activation, which determines the size of the surfels.
    float alpha_min() const;
    /// Table of models, [models], in the order of their surfel ranges.
    const Array<shared::ModelEntry>& models() const;
    /// Table of instances, [instances], with the most recent poses.
    const Array<shared::InstanceEntry>& instances() const;
    std::uint32_t size() const;  ///< Number of surfels.
    Primitive primitive() const;
    /// Returns the first row of the record gradients of an instance.
    std::uint32_t first_gradient_row(std::size_t instance) const;
    /// Number of rows of the record gradients: one per surfel, plus one per surfel of
    /// each further instance of a model.
    std::uint32_t gradient_rows() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
