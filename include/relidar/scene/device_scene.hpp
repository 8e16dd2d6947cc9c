// SPDX-License-Identifier: Apache-2.0
// Scene on a device: the parameters of all surfels, the surfel records that tracing
// kernels read, and the placement of each model.
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

// Empty types that name the content of a device array, used as the second template
// argument of Array. They make it a compile error to pass the wrong array to a kernel.
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

/// Arrays on a device with a value for each surfel. The values are parameters of the
/// surfels, their gradients or their Adam moments. Each parameter group has one array,
/// with the layout of Surfels.
struct SurfelArrays {
    Array<float, shared::Means> mean;
    Array<float, shared::Rotations> rotation;
    Array<float, shared::LogScales> log_scale;
    Array<float, shared::OpacityLogits> opacity_logit;
    Array<float, shared::Harmonics> sh;
    /// Logarithms of the scale along the third axis of 3D Gaussians. Not allocated for
    /// surfels.
    Array<float, shared::ThirdLogScales> log_scale_w;
    /// Walking motion of each surfel (GaitPhaseWindow): in which part of the walking
    /// cycle the surfel is visible, and how far it moves. Allocated only for scenes with
    /// actors whose shape changes, like walking persons.
    Array<float, shared::Gaits> gait;
    std::uint32_t n = 0;  ///< Number of surfels. The arrays may have memory for more surfels.
    PrimitiveType primitive = PrimitiveType::surfel;
    bool bends = false;

    SurfelArrays() = default;
    SurfelArrays(Device& device, std::uint32_t n, const std::string& description,
                 SurfelParameterSet parameter_set = {});
    SurfelParameterSet get_parameter_set() const { return {primitive, bends}; }
    /// Uploads all parameters to the device.
    /// @throws DataError if the number of surfels, the primitive, or the presence of
    /// walking motions (gait) differs
    void upload(const Surfels& surfels);
    Surfels download() const;
    /// Returns the number of surfels for which all arrays have memory.
    std::uint32_t capacity() const;
    /// Enlarges the arrays to at least `capacity` surfels. Existing values are kept, and
    /// new values are undefined. No submitted GPU work may use the arrays during the
    /// call.
    /// @throws DeviceError if device memory is exhausted. Some arrays may then be larger,
    /// but no values are lost
    void reserve(Device& device, std::uint32_t capacity, const std::string& description);
    void record_zero_fill(Stream& stream);
};

/// Learning rates of an optimiser step.
struct LearningRates {
    /// Learning rate of the mean positions. The training schedule multiplies it by the
    /// extent of the scene in metres.
    double mean = 1.6e-4;
    double rotation = 1e-3;
    double log_scale = 5e-3;  ///< Learning rate of all scales, including the third scale of 3D Gaussians.
    double opacity_logit = 0.05;
    double sh = 2.5e-3;            ///< Learning rate of the constant (DC) coefficient of each SH channel.
    double sh_rest_factor = 0.05;  ///< Learning rate of the other SH coefficients, relative to `sh`.
    /// Learning rate of the walking motion (gait): of its phases, and of its amplitudes
    /// in metres.
    double gait = 1e-4;
    /// Learning rate of the intensity coefficients, relative to the rate of the drop
    /// logits.
    double intensity_factor = 1.0;
    /// Surfel range of each model (background or actor): DeviceScene::get_model_table().
    /// Required if `mean_factors`, which has one factor per model, is not empty.
    const Array<shared::ModelEntry>* models = nullptr;
    /// Factor for the learning rate of the mean positions of each model, [models]. Empty
    /// = 1.
    std::vector<float> mean_factors = {};
};

/// Description of a group of surfel parameters, for example the rotations. With this
/// table, optimiser, densification and file formats process all groups with the same
/// code.
struct SurfelParameterGroup {
    const char* name;  ///< Name of the group's array in files.
    /// Shape of the values that one surfel has in this group, {rows, columns}. Examples:
    /// {3, 1} for a vector of 3 floats, {1, 1} for a single float.
    std::array<std::uint32_t, 2> row;
    double LearningRates::*rate;
    bool harmonics;  ///< True if the last dimension holds spherical harmonics (SH) coefficients.
    bool scales;     ///< True if the group holds standard deviations, which may have upper bounds.
    /// Scenes that have these parameters: all scenes, scenes of 3D Gaussians (only these
    /// have a third scale), or scenes with actors that change their shape (`bends`).
    enum class SceneRequirement { all, third_scale, bends } of;
    const Array<float>& (*device)(const SurfelArrays&);  ///< Returns the device array, [n, count_floats()].
    /// Returns the device array for writing, [n, count_floats()].
    Array<float>& (*mutable_device)(SurfelArrays&);
    /// Returns the values on the host, [n * count_floats()].
    std::span<const float> (*values)(const Surfels&);
    /// Returns the values on the host for writing, [n * count_floats()].
    std::span<float> (*mutable_values)(Surfels&);
    void (*resize)(Surfels&, std::size_t n_floats);  ///< Resizes the array on the host.

    constexpr std::uint32_t count_floats() const {
        return row[0] * row[1];
    }  ///< Number of floats per surfel.
    /// Returns the shape of the array in files: [n], [n,3] or [n,3,16] for n surfels.
    std::vector<std::size_t> get_array_shape(std::size_t n_surfels) const;
};

/// Makes the description of a group of parameters.
/// @param kHost member of Surfels with the parameters
/// @param kDevice member of SurfelArrays with the parameters
template <auto kHost, auto kDevice>
constexpr SurfelParameterGroup make_parameter_group(
    const char* name, std::array<std::uint32_t, 2> shape_per_surfel, double LearningRates::*learning_rate,
    bool has_harmonics = false, bool has_scales = false,
    SurfelParameterGroup::SceneRequirement scene_requirement = SurfelParameterGroup::SceneRequirement::all) {
    using Element = typename std::remove_reference_t<decltype(std::declval<Surfels&>().*kHost)>::value_type;
    // Element is not a pointer. NOLINTNEXTLINE(bugprone-sizeof-expression)
    constexpr std::size_t kFloats = sizeof(Element) / sizeof(float);
    return {name,
            shape_per_surfel,
            learning_rate,
            has_harmonics,
            has_scales,
            scene_requirement,
            [](const SurfelArrays& arrays) -> const Array<float>& { return arrays.*kDevice; },
            [](SurfelArrays& arrays) -> Array<float>& { return arrays.*kDevice; },
            [](const Surfels& surfels) {
                return std::span(reinterpret_cast<const float*>((surfels.*kHost).data()),
                                 kFloats * (surfels.*kHost).size());
            },
            [](Surfels& surfels) {
                return std::span(reinterpret_cast<float*>((surfels.*kHost).data()),
                                 kFloats * (surfels.*kHost).size());
            },
            [](Surfels& surfels, std::size_t n_floats) { (surfels.*kHost).resize(n_floats / kFloats); }};
}

/// Table of all groups of surfel parameters. A scene may lack the groups `gait` and
/// `log_scale_w`. They are the first and the last entry, so that the groups of every
/// scene are consecutive entries. A new parameter needs an entry here, a member of
/// Surfels and of SurfelArrays, and a pointer for the kernels.
inline constexpr std::array<SurfelParameterGroup, 7> kParameterGroups{{
    make_parameter_group<&Surfels::gait, &SurfelArrays::gait>(
        "gait", {5, 1}, &LearningRates::gait, false, false, SurfelParameterGroup::SceneRequirement::bends),
    make_parameter_group<&Surfels::mean, &SurfelArrays::mean>("mean", {3, 1}, &LearningRates::mean),
    make_parameter_group<&Surfels::rotation, &SurfelArrays::rotation>("rotation", {4, 1},
                                                                      &LearningRates::rotation),
    make_parameter_group<&Surfels::log_scale, &SurfelArrays::log_scale>(
        "log_scale", {2, 1}, &LearningRates::log_scale, false, true),
    make_parameter_group<&Surfels::opacity_logit, &SurfelArrays::opacity_logit>(
        "opacity_logit", {1, 1}, &LearningRates::opacity_logit),
    make_parameter_group<&Surfels::sh, &SurfelArrays::sh>("sh", {kShChannels, kShCoefficients},
                                                          &LearningRates::sh, true),
    make_parameter_group<&Surfels::log_scale_w, &SurfelArrays::log_scale_w>(
        "log_scale_w", {1, 1}, &LearningRates::log_scale, false, true,
        SurfelParameterGroup::SceneRequirement::third_scale),
}};

/// Returns the parameter groups that the surfels of a scene have.
constexpr std::span<const SurfelParameterGroup> list_parameter_groups(SurfelParameterSet parameter_set) {
    const std::size_t first = parameter_set.bends ? 0 : 1,
                      last = kParameterGroups.size() -
                             (get_primitive_properties(parameter_set.primitive).third_scale ? 0 : 1);
    return std::span(kParameterGroups).subspan(first, last - first);
}

/// Metadata key in model and checkpoint files that stores the PrimitiveType.
inline constexpr const char* kPrimitiveKey = "primitive";
/// Reads from the metadata of a file which parameters the stored surfels have.
/// @param error_location text at the beginning of error messages, usually a file name
/// @param metadata metadata of the file
/// @param primitive_key metadata key of the primitive
/// @param has_array returns true if the file has an array with the given name
/// @throws DataError if the key is missing or its value is not a primitive
SurfelParameterSet read_surfel_parameter_set(const std::string& error_location,
                                             const std::map<std::string, std::string>& metadata,
                                             const std::string& primitive_key,
                                             const std::function<bool(const char*)>& has_array);
/// Returns the number of floats that the parameters of one surfel have in total.
constexpr std::uint32_t count_floats_per_surfel(SurfelParameterSet parameter_set) {
    std::uint32_t sum = 0;
    for (const SurfelParameterGroup& group : list_parameter_groups(parameter_set))
        sum += group.count_floats();
    return sum;
}

namespace shared {
struct SurfelPointers;  // Device addresses of the parameter arrays.
}
/// Returns the device addresses of all parameter arrays, to be passed to kernels.
shared::SurfelPointers get_surfel_pointers(const SurfelArrays& arrays);

/// List of the surfels that have a gradient. A kernel makes this list from an array of
/// flags. Later kernels process only the listed surfels. This saves time on CPU devices,
/// where idle threads cost as much as active threads.
class TouchedSurfelList {
public:
    explicit TouchedSurfelList(Device& device);
    ~TouchedSurfelList();
    /// Records GPU commands that list the rows whose flag is 1. Waits for the stream if
    /// there are more rows than in any earlier call.
    /// @param touched_flags [n_rows] flags, 0 or 1
    void record_compaction_of_touched_rows(Stream& stream,
                                           Address<std::uint32_t, shared::TouchedSurfels> touched_flags,
                                           std::uint32_t n_rows);
    /// Returns the address of the list that record_compaction_of_touched_rows() makes:
    /// [count] indices of the rows whose flag is 1, in no particular order.
    Address<std::uint32_t, shared::TouchedRows> get_touched_rows_address() const;
    Address<std::uint32_t, shared::TouchedCount> get_touched_count_address()
        const;  ///< Number of marked rows, [1].
    /// Returns the number of threads for a kernel that processes the list. The host
    /// cannot read the length of the list without waiting. Therefore the number is
    /// constant, and each thread processes several rows if necessary.
    /// @param max_touched_rows length of the longest possible list
    std::size_t choose_thread_count_for_touched_rows(std::size_t max_touched_rows) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Computes the pose and the constant motion of a tracked box during a sweep. The
/// computed pose equals the track at two times: the first and the last time at which a
/// ray may hit the box. Between these times, the pose is interpolated. A box behind a
/// spinning sensor is hit at the start and at the end of the sweep.
/// @param half_size_m [3] half size of the box. 0 = unknown, so any ray may hit the box
InstancePose compute_box_pose_in_sweep(const LidarSequence& sequence, const PoseTrack& world_from_box,
                                       const glm::dvec3& half_size_m, const SweepTiming& sweep);

/// Inputs and outputs of DeviceScene::record_activation_backpropagation(). Tracing
/// kernels read SurfelRecords, which are computed from the trained parameters. The
/// function applies the chain rule: from dL/d(SurfelRecord) to dL/d(parameters).
struct ActivationGradients {
    /// Input: gradients with respect to the surfel records, [count_gradient_rows,16].
    const Array<float, shared::RecordGradients>* d_records = nullptr;
    SurfelArrays* d_surfels = nullptr;  ///< Output: gradients with respect to the surfel parameters.
    /// Output: flags, [n]. 1 for each surfel whose record has a nonzero gradient.
    Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
    /// Output [n,3], model frame: contribution of each surfel to dL/d(sensor position),
    /// because its spherical harmonics (SH) depend on the viewing direction. Null if not
    /// needed. Used only if SH are evaluated once per surfel (ShDirection::surfel).
    Array<float, shared::ViewGradients>* d_view = nullptr;
    bool zero_untouched =
        true;  ///< If true, record_activation_backpropagation() writes zeros for surfels without a gradient.
    /// If true, `touched` is also an input: 0 for each surfel that no ray has hit,
    /// otherwise 1. A surfel with 0 has no gradient. It is skipped if zero_untouched is
    /// false and can_skip_surfels_without_gradient() returns true. Then nothing is
    /// written for it, not even to d_view.
    bool touched_is_marked = false;
};

/// Scene on a device. Stores the surfel parameters, the surfel records that tracing
/// kernels read, and the table of instances.
class DeviceScene {
public:
    /// Uploads a scene to the device.
    /// @param stage_harmonics if true, kernels copy SH coefficients through shared memory
    /// in full cache lines. If false, each thread reads the coefficients of its surfel
    /// directly. Default: true on GPUs
    /// @throws DataError if the models are not consecutive ranges that contain all
    /// surfels, or if an instance refers to a model that does not exist
    DeviceScene(Device& device, const Scene& scene, std::optional<bool> stage_harmonics = std::nullopt);
    ~DeviceScene();

    /// Sets the pose world_from_model of every instance. All instances are marked as
    /// present. Waits until the upload is finished.
    void upload_instance_poses_and_wait(const std::vector<Pose>& world_from_instance);
    /// Sets the poses and motions of all instances. An instance may be marked as absent.
    /// Waits until the upload is finished.
    void upload_instance_poses_and_wait(const std::vector<InstancePose>& instance_poses);
    /// Records GPU commands that set the poses and motions of all instances. Does not
    /// wait. An instance may be marked as absent. The acceleration structure has the new
    /// poses only after its next update (record_bvh_refit_or_build() or
    /// record_top_level_bvh_update()).
    void record_upload_of_instance_poses(Stream& stream, const std::vector<InstancePose>& instance_poses);
    const std::vector<InstancePose>& get_instance_poses() const;
    /// Returns true if the new poses change the phase of an actor's walking cycle. This
    /// changes its surfels, so record_activation_of_surfel_parameters() must be called
    /// again.
    bool would_change_gait_phases(const std::vector<InstancePose>& instance_poses) const;
    /// Records the kernel that computes the SurfelRecord of each surfel from its
    /// parameters (docs/method.md M1, M2, M9). Tracing kernels read only these records.
    /// With ShDirection::surfel, the kernel also computes intensity, hit logit and drop
    /// logit.
    /// @param view_origin_m [3] sensor position, world frame. If a model has several
    /// instances, it is used relative to the first of them
    /// @throws UsageError if `model` has another primitive than the scene
    void record_activation_of_surfel_parameters(Stream& stream, const ImageFormationModel& model,
                                                const glm::vec3& view_origin_m);
    /// Returns true if record_activation_backpropagation() can skip surfels that have
    /// no gradient. This is the case on CPU devices. On a GPU, no thread can be left out,
    /// because all threads copy SH coefficients through shared memory together.
    bool can_skip_surfels_without_gradient() const;
    /// Records the kernel that converts gradients with respect to the SurfelRecords to
    /// gradients with respect to the parameters (chain rule). With ShDirection::surfel,
    /// it also writes the gradients of the SH coefficients. With ShDirection::ray, the
    /// backward pass has already written them.
    void record_activation_backpropagation(Stream& stream, const ImageFormationModel& model,
                                           const glm::vec3& view_origin_m,
                                           const ActivationGradients& gradients);

    /// Enlarges the arrays of parameters and records to at least `capacity` surfels.
    /// Existing values are kept.
    void reserve(Device& device, std::uint32_t capacity);
    /// Sets the range of each model in the surfel arrays, after the arrays were
    /// rearranged. Two calls must follow. record_activation_of_surfel_parameters()
    /// updates the surfel records. record_upload_of_instance_poses() or
    /// upload_instance_poses_and_wait() updates the instance table.
    void set_models(const std::vector<SurfelModel>& models);

    const Scene& get_scene_layout() const;  ///< Models and instances of the scene, without surfels.
    SurfelArrays& get_surfel_parameters();
    const SurfelArrays& get_surfel_parameters() const;
    const Array<shared::SurfelRecord>& get_surfel_records() const;  ///< Surfel records, [n].
    /// ImageFormationModel::alpha_min of the last
    /// record_activation_of_surfel_parameters(). Rays skip hits with a smaller alpha
    /// (opacity of the surfel times its Gaussian).
    float alpha_min() const;
    /// Table of models, [models], in the order of their surfel ranges.
    const Array<shared::ModelEntry>& get_model_table() const;
    /// Table of instances, [instances], with the most recent poses.
    const Array<shared::InstanceEntry>& get_instance_table() const;
    std::uint32_t size() const;  ///< Number of surfels.
    PrimitiveType primitive() const;
    /// Returns the first row of an instance in the array of gradients with respect to
    /// SurfelRecords. The array has a row for each surfel of each instance.
    std::uint32_t get_first_gradient_row_of_instance(std::size_t instance_index) const;
    /// Number of rows in the array of gradients with respect to SurfelRecords. Each
    /// surfel has a row for each instance of its model, and at least one row.
    std::uint32_t count_gradient_rows() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
