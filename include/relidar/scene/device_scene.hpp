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

// Types that name the content of a device array, so that kernels reject the wrong array.
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

/// Arrays on a device with a value for each surfel: parameters, their gradients or their
/// Adam moments. Each parameter group has one array, with the layout of Surfels.
struct SurfelArrays {
    Array<float, shared::Means> mean;
    Array<float, shared::Rotations> rotation;
    Array<float, shared::LogScales> log_scale;
    Array<float, shared::OpacityLogits> opacity_logit;
    Array<float, shared::Harmonics> sh;
    Array<float, shared::ThirdLogScales> log_scale_w;  ///< Only allocated for 3D Gaussians.
    Array<float, shared::Gaits> gait;                  ///< Only allocated if `bends` is true.
    std::uint32_t n = 0;  ///< Number of surfels. The arrays may have memory for more surfels.
    PrimitiveType primitive = PrimitiveType::surfel;
    bool bends = false;

    SurfelArrays() = default;
    SurfelArrays(Device& device, std::uint32_t n, const std::string& text, SurfelParameterSet which = {});
    SurfelParameterSet parameters_used() const { return {primitive, bends}; }
    /// @throws DataError if the number of surfels, the primitive, or the presence of a
    /// gait differs
    void upload(const Surfels& surfels);
    /// @throws DataError if the primitive or the presence of a gait differs
    void check_group(const Surfels& surfels) const;
    /// Replaces the surfels from index `first` on, within the capacity. Does not change
    /// `n`.
    void upload_at(std::uint32_t first, const Surfels& surfels);
    Surfels download() const { return download_range(0, n); }
    Surfels download_range(std::uint32_t first, std::uint32_t count) const;
    /// Returns the number of surfels for which all arrays have memory.
    std::uint32_t capacity() const;
    /// Enlarges the arrays to at least `capacity` surfels. Existing values are kept, and
    /// new values are undefined. No submitted GPU work may use the arrays.
    /// @throws DeviceError if device memory is exhausted; no values are lost
    void reserve(Device& device, std::uint32_t capacity, const std::string& text);
    void fill_zero(Stream& stream);
};

/// Learning rates of an optimiser step.
struct LearningRates {
    double mean = 1.6e-4;  ///< The training schedule multiplies it by the extent of the scene in metres.
    double rotation = 1e-3;
    double log_scale = 5e-3;  ///< all scales, including the third scale of 3D Gaussians
    double opacity_logit = 0.05;
    double sh = 2.5e-3;            ///< the constant (DC) coefficient of each SH channel
    double sh_rest_factor = 0.05;  ///< the other SH coefficients, relative to `sh`
    /// phases and amplitudes (metres) of the walking motion
    double gait = 1e-4;
    /// intensity coefficients, relative to the rate of the drop logits
    double intensity_factor = 1.0;
    /// Surfel range of each model (DeviceScene::model_table()), for `mean_factors`.
    const Array<shared::ModelEntry>* models = nullptr;
    /// Factor for the rate of the mean positions of each model, [models]. Empty = 1.
    std::vector<float> mean_factors = {};
};

/// Description of a group of surfel parameters, for example the rotations. Optimiser,
/// densification and file formats process all groups with the same code.
struct SurfelParameterGroup {
    const char* name;  ///< Name of the group's array in files.
    /// Shape of the values of one surfel, {rows, columns}, for example {3, 1} for a
    /// vector.
    std::array<std::uint32_t, 2> row;
    double LearningRates::*rate;
    bool harmonics;  ///< True if the last dimension holds spherical harmonics (SH) coefficients.
    bool scales;     ///< True if the group holds standard deviations, which may have upper bounds.
    /// Scenes that have these parameters.
    enum class SceneRequirement { all, third_scale, bends } of;
    /// Access to the device array, [n, count_floats()], and to the values on the host, [n
    /// * count_floats()].
    const Array<float>& (*device)(const SurfelArrays&);
    Array<float>& (*mutable_device)(SurfelArrays&);
    std::span<const float> (*values)(const Surfels&);
    std::span<float> (*mutable_values)(Surfels&);
    void (*resize)(Surfels&, std::size_t n_floats);

    constexpr std::uint32_t count_floats() const { return row[0] * row[1]; }  ///< per surfel
    /// Returns the shape of the array in files: [n], [n,3] or [n,3,16] for n surfels.
    std::vector<std::size_t> array_shape(std::size_t n_surfels) const;
};

/// Makes the description of a group of parameters.
/// @param kHost, kDevice members of Surfels and SurfelArrays with the parameters
template <auto kHost, auto kDevice>
constexpr SurfelParameterGroup make_group(
    const char* name, std::array<std::uint32_t, 2> shape_per_surfel, double LearningRates::*learning_rate,
    bool has_harmonics = false, bool has_scales = false,
    SurfelParameterGroup::SceneRequirement of = SurfelParameterGroup::SceneRequirement::all) {
    using Element = typename std::remove_reference_t<decltype(std::declval<Surfels&>().*kHost)>::value_type;
    // Element is not a pointer. NOLINTNEXTLINE(bugprone-sizeof-expression)
    constexpr std::size_t kFloatsPerElement = sizeof(Element) / sizeof(float);
    return {name,
            shape_per_surfel,
            learning_rate,
            has_harmonics,
            has_scales,
            of,
            [](const SurfelArrays& arrays) -> const Array<float>& { return arrays.*kDevice; },
            [](SurfelArrays& arrays) -> Array<float>& { return arrays.*kDevice; },
            [](const Surfels& surfels) {
                return std::span(reinterpret_cast<const float*>((surfels.*kHost).data()),
                                 kFloatsPerElement * (surfels.*kHost).size());
            },
            [](Surfels& surfels) {
                return std::span(reinterpret_cast<float*>((surfels.*kHost).data()),
                                 kFloatsPerElement * (surfels.*kHost).size());
            },
            [](Surfels& surfels, std::size_t n_floats) {
                (surfels.*kHost).resize(n_floats / kFloatsPerElement);
            }};
}

/// Table of all groups of surfel parameters. A scene may lack the first and the last, so
/// that the groups of every scene are consecutive. A new parameter needs an entry here, a
/// member of Surfels and of SurfelArrays, and a pointer for the kernels.
inline constexpr std::array<SurfelParameterGroup, 7> kParameterGroups{{
    make_group<&Surfels::gait, &SurfelArrays::gait>("gait", {5, 1}, &LearningRates::gait, false, false,
                                                    SurfelParameterGroup::SceneRequirement::bends),
    make_group<&Surfels::mean, &SurfelArrays::mean>("mean", {3, 1}, &LearningRates::mean),
    make_group<&Surfels::rotation, &SurfelArrays::rotation>("rotation", {4, 1}, &LearningRates::rotation),
    make_group<&Surfels::log_scale, &SurfelArrays::log_scale>("log_scale", {2, 1}, &LearningRates::log_scale,
                                                              false, true),
    make_group<&Surfels::opacity_logit, &SurfelArrays::opacity_logit>("opacity_logit", {1, 1},
                                                                      &LearningRates::opacity_logit),
    make_group<&Surfels::sh, &SurfelArrays::sh>("sh", {kShChannels, kShCoefficients}, &LearningRates::sh,
                                                true),
    make_group<&Surfels::log_scale_w, &SurfelArrays::log_scale_w>(
        "log_scale_w", {1, 1}, &LearningRates::log_scale, false, true,
        SurfelParameterGroup::SceneRequirement::third_scale),
}};

/// Returns the parameter groups that the surfels of a scene have.
constexpr std::span<const SurfelParameterGroup> list_groups(SurfelParameterSet parameters) {
    const std::size_t first = parameters.bends ? 0 : 1,
                      last =
                          kParameterGroups.size() - (properties_of(parameters.primitive).third_scale ? 0 : 1);
    return std::span(kParameterGroups).subspan(first, last - first);
}

/// Metadata key in model and checkpoint files that stores the PrimitiveType.
inline constexpr const char* kPrimitiveKey = "primitive";
/// Reads from the metadata of a file which parameters the stored surfels have.
/// @param where text at the beginning of error messages, usually a file name
/// @param has_array returns true if the file has an array with the given name
/// @throws DataError if the key is missing or its value is not a primitive
SurfelParameterSet read_parameter_set(const std::string& where,
                                      const std::map<std::string, std::string>& metadata,
                                      const std::string& key,
                                      const std::function<bool(const char*)>& has_array);
/// Returns the number of floats of a surfel, summed over all parameter groups.
constexpr std::uint32_t floats_per_surfel(SurfelParameterSet parameters) {
    std::uint32_t sum = 0;
    for (const SurfelParameterGroup& group : list_groups(parameters)) sum += group.count_floats();
    return sum;
}

namespace shared {
struct SurfelPointers;  // Device addresses of the parameter arrays.
}
/// Returns the device addresses of all parameter arrays, to be passed to kernels.
shared::SurfelPointers surfel_pointers(const SurfelArrays& arrays);

/// List of the surfels that have a gradient, made by a kernel from an array of flags.
/// This saves time on CPU devices, where idle threads cost as much as active threads.
class TouchedSurfelList {
public:
    explicit TouchedSurfelList(Device& device);
    ~TouchedSurfelList();
    /// Lists the rows whose flag is 1, [n_rows]. Waits for the stream if there are more
    /// rows than in any earlier call.
    void compact(Stream& stream, Address<std::uint32_t, shared::TouchedSurfels> touched, std::uint32_t n);
    /// [count] indices of the listed rows, in no particular order
    Address<std::uint32_t, shared::TouchedRows> rows_address() const;
    Address<std::uint32_t, shared::TouchedCount> count_address() const;  ///< [1]
    /// Returns the number of threads for a kernel that processes the list. It is
    /// constant, because the host does not know the length, so a thread may process
    /// several rows.
    std::size_t choose_threads(std::size_t max_touched_rows) const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Computes the pose and the constant motion of a tracked box during a sweep. They equal
/// the track at the first and the last time at which a ray may hit the box. A box behind
/// a spinning sensor is hit at the start and at the end of the sweep.
/// @param half_size_m [3] half size of the box. 0 = unknown, so any ray may hit the box
InstancePose box_pose_in_sweep(const Log& log, const PoseTrack& world_from_box, const glm::dvec3& half_size_m,
                               const SweepTiming& sweep);

/// Inputs and outputs of DeviceScene::activate_vjp().
struct ActivationGradients {
    /// Input: gradients with respect to the surfel records, [count_rows,16].
    const Array<float, shared::RecordGradients>* d_records = nullptr;
    SurfelArrays* d_surfels = nullptr;  ///< Output: gradients with respect to the parameters.
    /// Output: flags, [n]. 1 for each surfel whose record has a nonzero gradient.
    Array<std::uint32_t, shared::TouchedSurfels>* touched = nullptr;
    /// Output [n,3], model frame, or null: contribution of each surfel to dL/d(sensor
    /// position) through its spherical harmonics (SH), with ShDirection::surfel.
    Array<float, shared::ViewGradients>* d_view = nullptr;
    bool zero_untouched = true;  ///< If true, surfels without a gradient get zeros.
    /// If true, `touched` is also an input: 0 for each surfel that no ray has hit. Such a
    /// surfel is skipped, and nothing is written for it, if zero_untouched is false and
    /// can_skip_surfels() returns true.
    bool touched_is_marked = false;
};

/// Scene on a device: parameters, records that tracing kernels read, table of instances.
class DeviceScene {
public:
    /// @param stage_harmonics if true, kernels copy SH coefficients through shared memory
    /// in full cache lines. Default: true on GPUs
    /// @throws DataError see check_layout()
    DeviceScene(Device& device, const Scene& scene, std::optional<bool> stage_harmonics = std::nullopt);
    ~DeviceScene();

    /// Sets the pose world_from_model of every instance. All are present. Waits until the
    /// upload is finished.
    void upload_poses(const std::vector<Pose>& world_from_instance);
    /// Sets the poses and motions of all instances, some of which may be absent. Waits
    /// until the upload is finished.
    void upload_poses(const std::vector<InstancePose>& instance_poses);
    /// Records GPU commands that set the poses and motions of all instances. Does not
    /// wait. The acceleration structure has the new poses only after record_refit() or
    /// record_top_level().
    void stage_poses(Stream& stream, const std::vector<InstancePose>& instance_poses);
    const std::vector<InstancePose>& poses() const;
    /// Returns true if the new poses change the phase of an actor's walking cycle, so
    /// that activate() must be called again.
    bool moves_gait(const std::vector<InstancePose>& instance_poses) const;
    /// Computes the record of each surfel (axes, opacity), the only input of tracing
    /// kernels, from its parameters. With ShDirection::surfel, also evaluates intensity,
    /// hit logit and drop logit, as seen from the sensor.
    /// @param view_origin_m [3] sensor position, world frame. If a model has several
    /// instances, it is used relative to the first of them
    /// @throws UsageError if `model` has another primitive than the scene
    void activate(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m);
    /// Returns true if activate_vjp() can skip surfels without a gradient, which is the
    /// case on CPU devices.
    bool can_skip_surfels() const;
    /// Converts gradients with respect to the SurfelRecords to gradients with respect to
    /// the parameters (chain rule). Writes the gradients of the SH coefficients only with
    /// ShDirection::surfel. Otherwise the backward pass has already written them.
    void activate_vjp(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m,
                      const ActivationGradients& gradients);

    /// Enlarges all arrays to at least `capacity` surfels. Existing values are kept.
    void reserve(Device& device, std::uint32_t capacity);
    /// Sets the surfel range of each model after the arrays were rearranged. Afterwards,
    /// activate() must update the surfel records, and stage_poses() or upload_poses() the
    /// instances, which contain these ranges too.
    void set_models(const std::vector<SurfelModel>& models);
    /// Adds a copy of the only model of another scene at the end, with its surfels and
    /// its surfel records. Adds no instance. No submitted GPU work may use the arrays.
    /// @param added  activated, with the same parameter groups
    /// @throws OutOfDeviceMemory if memory is exhausted. Nothing changes.
    void append_model(Device& device, const DeviceScene& added);
    /// Adds an absent instance of a model. No submitted GPU work may use the arrays.
    void append_instance(Device& device, const ModelInstance& instance);

    const Scene& layout() const;  ///< Models and instances of the scene, without surfels.
    SurfelArrays& surfel_parameters();
    const SurfelArrays& surfel_parameters() const;
    const Array<shared::SurfelRecord>& surfel_records() const;  ///< Surfel records, [n].
    /// ImageModel::alpha_min of the last activation. Rays skip hits with a
    /// smaller alpha.
    float alpha_min() const;
    /// [models], in the order of their surfel ranges
    const Array<shared::ModelEntry>& model_table() const;
    /// [instances], with the most recent poses
    const Array<shared::InstanceEntry>& instance_table() const;
    std::uint32_t size() const;  ///< Number of surfels.
    PrimitiveType primitive() const;
    /// Returns the first row of an instance in the array of gradients with respect to
    /// SurfelRecords, which has a row for each surfel of each instance.
    std::uint32_t first_gradient_row(std::size_t instance) const;
    /// Number of rows in this array, at least one per surfel.
    std::uint32_t count_rows() const;

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
