// SPDX-License-Identifier: Apache-2.0
// A scene on a device: parameters of all surfels, the records that hits read, and where each model is placed.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <relidar/scene.hpp>
#include <relidar/shared/surfels.h>
#include <relidar/stages/gpu.hpp>

namespace relidar {

/// Parameters, gradients or moments of all surfels on a device, one array a group in the layout of Surfels.
struct SurfelArrays {
    Array<float> mean, rotation, log_scale, opacity_logit, sh;
    Array<float> log_scale_w;   ///< of 3D Gaussians; not allocated for surfels
    std::uint32_t n = 0;        ///< surfels; the arrays may hold more
    Primitive primitive = Primitive::surfel;

    SurfelArrays() = default;
    SurfelArrays(Device& device, std::uint32_t n, const std::string& what, Primitive primitive = Primitive::surfel);
    /// @throws DataError where arrays or primitive disagree
    void upload(const Surfels& surfels);
    Surfels download() const;
    /// Surfels there is room for in every group.
    std::uint32_t capacity() const;
    /// Makes room for so many surfels and keeps those there are; new room is undefined. Nothing may be in flight that uses the arrays.
    /// @throws DeviceError where memory is exhausted: some groups may then have grown, none has lost anything
    void reserve(Device& device, std::uint32_t capacity, const std::string& what);
    void fill_zero(Stream& stream);
};

/// What the activation's derivative reads and writes.
struct ActivationGradients {
    const Array<float>* d_records = nullptr;       ///< [gradient_rows,16] input
    SurfelArrays* d_surfels = nullptr;             ///< output
    Array<std::uint32_t>* touched = nullptr;       ///< [n] output: 1 where any record gradient is not zero
    Array<float>* d_view = nullptr;                ///< [n,3] output with ShDirection::surfel: dL/d(view origin) by way of each surfel, model frame; null where not wanted
    bool zero_untouched = true;                    ///< write zeros for surfels without a gradient
};

/// A scene on a device: parameters, the records that hits read, and the instance table.
class DeviceScene {
public:
    /// @param stage_harmonics  activation and its derivative move harmonics through shared memory, whole lines at a time, instead of each thread
    ///                         its own surfel's; not given: on GPUs
    DeviceScene(Device& device, const Scene& scene, std::optional<bool> stage_harmonics = std::nullopt);
    ~DeviceScene();

    /// Poses of all instances, world_from_model, one each: all present. Blocking upload.
    void set_poses(const std::vector<Pose>& world_from_instance);
    /// The same as part of a stream, without a wait; instances may be absent. The acceleration structure follows with its next update or move.
    void place(Stream& stream, const std::vector<InstancePose>& placed);
    const std::vector<InstancePose>& poses() const;
    /// Records the activation kernel: records from parameters (M1, M2, M9), channels too with ShDirection::surfel.
    /// @throws UsageError where the model is of another primitive than the scene
    /// @param view_origin_m [3] world. A model placed twice sees it from its first instance (see own_models).
    void activate(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m);
    /// Records the chain rule back from record gradients to parameters.
    /// SH gradients are written with ShDirection::surfel; with ShDirection::ray the hits have accumulated them already.
    void activate_vjp(Stream& stream, const ImageModel& model, const glm::vec3& view_origin_m, const ActivationGradients& gradients);

    /// Makes room for so many surfels in parameters and records. As SurfelArrays::reserve.
    void reserve(Device& device, std::uint32_t capacity);
    /// New ranges of the same models, after the parameter arrays were rearranged; size() is then their sum and the records are stale.
    /// The instance table follows with the next place() or set_poses().
    void set_models(const std::vector<Model>& models);

    const Scene& layout() const;   ///< models and instances; its surfels are empty
    SurfelArrays& parameters();
    const SurfelArrays& parameters() const;
    const Array<shared::SurfelRecord>& records() const;        ///< [n]
    float alpha_min() const;                  ///< the records were activated for: where a surfel ends
    const Array<shared::InstanceEntry>& instances() const;     ///< [instances] as placed last
    std::uint32_t size() const;               ///< surfels
    Primitive primitive() const;
    std::uint32_t first_gradient_row(std::size_t instance) const;   ///< of the record gradients of an instance's surfels
    std::uint32_t gradient_rows() const;      ///< of record gradients: surfels, then those of every further placement of a model

private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace relidar
