// SPDX-License-Identifier: Apache-2.0
#include <relidar/diff/differentiable_renderer.hpp>

#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>

#include <pybind11/stl.h>

#include <relidar/run/stage_options.hpp>
#include "base/fail.hpp"
#include "conversions.hpp"
#include "device_array.hpp"
#include "integers.hpp"
#include "module.hpp"
#include "run.hpp"

namespace relidar::python {
namespace {

struct PythonRenderer {
    DeviceObject<DifferentiableRenderer> differentiable;
    std::vector<InstancePose> placed;  ///< [instances] pose of each instance.
    std::size_t n_rays = 0;            ///< Number of rays of the last forward pass.
    /// Rays and measured values that other libraries write. Destroyed before the
    /// renderer, which no longer uses them, because every call waits for the device.
    Array<DeviceRay> rays;
    Array<shared::DeviceTarget> measured;
    float likelihood_scale_m = 0.0f;  ///< 0 if the renderer does not compute likelihoods.

    Renderer& drawn() { return differentiable->renderer(); }
    const SharedDevice& device() const { return differentiable.device(); }
    /// Calls a function with the renderer while the device is locked.
    template <class Call>
    auto use(const Call& call) {
        return differentiable.use([&](DifferentiableRenderer& both) { return call(both.renderer()); });
    }
};

/// Creates a renderer for Python, which traces rays as the training does.
/// @param config  settings of the training; none: the default preset
/// @param for_poses, for_rays  also compute gradients of instance poses, or of rays
/// @param sparse  leave gradients of surfels without hits undefined, instead of 0
/// @param margin  factor and metres by which the boxes of surfels in the tree are larger
std::unique_ptr<PythonRenderer> make_renderer(const Scene& scene, const std::optional<Config>& config,
                                              bool for_poses, bool for_rays, bool sparse,
                                              const std::optional<std::pair<float, float>>& margin,
                                              SharedDevice device) {
    const Config settings = config.value_or(make_preset("default"));
    ImageModel image = settings.image;
    // The scene has a fixed primitive, whatever the settings say.
    image.primitive = scene.surfels.primitive;
    RendererOptions options{.trace = training_options(settings),
                            .keep_hits = static_cast<std::uint32_t>(settings.trace.keep_hits)};
    if (margin) std::tie(options.accel.margin_scale, options.accel.margin_m) = *margin;
    // As in training, except for the requested gradients.
    const GradientOptions gradients{.sums = backward_options(settings),
                                    .requested_gradients = {.rays = for_rays, .poses = for_poses},
                                    .zero_untouched = !sparse};
    auto renderer = std::make_unique<PythonRenderer>();
    renderer->differentiable = DeviceObject<DifferentiableRenderer>::create(
        device_or_default(std::move(device)), scene, image, options, gradients);
    renderer->placed.resize(scene.instances.size());  // until the first call of place()
    if (options.trace.likelihood) renderer->likelihood_scale_m = options.trace.likelihood->scale_m;
    return renderer;
}

glm::vec3 read_view(const py::object& view_origin) {
    const std::vector<double> v = copy_array<double, double>(view_origin, "view_origin", {3});
    return {v[0], v[1], v[2]};
}

/// Places the instances of the scene and sets the origin of the view.
/// @param refit if true, also updates the acceleration structure
void place_instances(PythonRenderer& renderer, std::vector<InstancePose>&& placed, const glm::vec3& view,
                     bool refit) {
    renderer.use([&](Renderer& drawn) {
        // With SH directions of rays, only update() computes the values that rays read.
        if (refit || drawn.model().sh_direction == ShDirection::ray) drawn.update(placed, view);
        else drawn.record_poses(placed, view);
    });
    renderer.placed = std::move(placed);
}

/// Sets the poses and the presence of all instances, and the origin of the view. Values
/// that are None keep their previous values.
/// @param refit if true, also updates the acceleration structure
void set_poses(PythonRenderer& renderer, const py::object& poses, const py::object& view_origin,
               const std::optional<std::vector<bool>>& present, bool refit) {
    std::vector<InstancePose> placed = renderer.placed;
    const auto check_count = [&](std::size_t found, const char* text) {
        if (found != placed.size())
            fail("{}: found {} entries, expected {}, one for each instance of the scene", text, found,
                 placed.size());
    };
    if (!poses.is_none()) {
        const std::vector<Pose> model_poses = to_poses(poses, "poses");
        check_count(model_poses.size(), "poses");
        for (std::size_t i = 0; i < placed.size(); ++i) placed[i].world_from_model = model_poses[i];
    }
    if (present) {
        check_count(present->size(), "present");
        for (std::size_t i = 0; i < placed.size(); ++i) placed[i].present = (*present)[i];
    }
    const glm::vec3 view = view_origin.is_none() ? renderer.drawn().view_origin_m() : read_view(view_origin);
    place_instances(renderer, std::move(placed), view, refit);
}

/// Places the instances where the tracks of a run have them during a frame.
void place_frame(PythonRenderer& renderer, const LoadedRun& run,
                 IntegerArgument<std::uint32_t, "position"> position, const py::object& view_origin,
                 bool refit) {
    const Log& log = run.run.log;
    if (position >= log.frames.size())
        fail<UsageError>("place_frame: found the position {}, expected at most {}", position.value,
                         log.frames.size() - 1);
    const Frame& frame = log.frames[position];
    const Scene& layout = renderer.drawn().scene().layout();
    std::vector<InstancePose> placed = pose_instances(layout, log, timing_of(frame));
    const Pose& mounting = log.lidar_of(frame).vehicle_from_sensor;
    glm::vec3 view(log.world_from_vehicle.mounted_pose_at(frame.time_s, mounting).translation);
    if (!view_origin.is_none()) view = read_view(view_origin);
    place_instances(renderer, std::move(placed), view, refit);
}

/// Renders rays from numpy arrays. Returns the values of each ray as numpy arrays.
py::dict run_forward(PythonRenderer& renderer, const py::object& origins, const py::object& directions) {
    const WorldRays rays{copy_array<float, glm::vec3>(origins, "origins", {kAnyLength, 3}),
                         copy_array<float, glm::vec3>(directions, "directions", {kAnyLength, 3})};
    if (rays.origin.size() != rays.direction.size())
        fail("directions: found {} directions and {} origins, expected the same number",
             rays.direction.size(), rays.origin.size());
    constexpr float kLengthTolerance = 1e-3f;
    for (std::size_t i = 0; i < rays.size(); ++i) {
        const glm::vec3 &origin = rays.origin[i], &direction = rays.direction[i];
        const bool is_finite = std::isfinite(origin.x + origin.y + origin.z);
        if (!is_finite || !(std::abs(glm::length(direction) - 1.0f) < kLengthTolerance))
            fail(
                "directions: ray {} starts at ({}, {}, {}) and has a direction of length {}, expected finite "
                "numbers and length 1",
                i, origin.x, origin.y, origin.z, glm::length(direction));
    }
    RenderedRayValues rendered = renderer.use([&](Renderer& drawn) { return drawn.render_rays(rays); });
    // backward() needs this number for the shape of its gradients.
    renderer.n_rays = rays.size();
    const NumpyShape shape{static_cast<py::ssize_t>(rays.size())};
    py::dict dict;
    // One such line for each value of the image, such as dict["depth"].
#define RELIDAR_VALUES(name, ...) dict[#name] = move_to_numpy<float>(std::move(rendered.name), shape);
    RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
    dict["transmittance"] = move_to_numpy<float>(std::move(rendered.transmittance), shape);
    dict["median_depth"] = move_to_numpy<float>(std::move(rendered.median_depth), shape);
    dict["hits"] = move_to_numpy<std::uint32_t>(std::move(rendered.hits), shape);
    dict["instance"] = move_to_numpy<std::int32_t>(std::move(rendered.instance), shape);
    return dict;
}

// Macros for RELIDAR_IMAGE_VALUES(m), which expands m once for each rendered value. They
// make texts for error messages and help: a list of names, or of names with meanings.
#define RELIDAR_NAME(name, ...) #name ", "
#define RELIDAR_MEANING(name, built, value, input, slope, meaning) #name " (" meaning "), "

/// Reads the gradients dL/d(value) of the rendered values, one array per value with one
/// number per ray. Missing gradients stay empty and count as 0.
RenderedGradients read_gradients(const py::dict& arrays, std::size_t n_rays) {
    RenderedGradients gradients;
    // The macro expands to one entry per value: {"depth", &gradients.depth}, ...
#define RELIDAR_VALUES(name, ...) {#name, &gradients.name},
    const std::map<std::string, std::vector<float>*> array_of_name{RELIDAR_IMAGE_VALUES(RELIDAR_VALUES)};
#undef RELIDAR_VALUES
    for (const auto& [key, array] : arrays) {
        const std::string name = py::str(key);
        const auto destination = array_of_name.find(name);
        if (destination == array_of_name.end())
            fail<UsageError>(
                "the dict d_rendered has the unknown entry \"{}\"; expected only entries with "
                "the names " RELIDAR_IMAGE_VALUES(RELIDAR_NAME) "which are the rendered values",
                name);
        *destination->second =
            copy_array<float, float>(array, "d_rendered: " + name, {static_cast<py::ssize_t>(n_rays)});
    }
    return gradients;
}

/// Computes the gradients of the last forward pass from dL/d(value) of each ray.
py::dict backward(PythonRenderer& renderer, const py::dict& gradients_of_values) {
    const RenderedGradients d_values = read_gradients(gradients_of_values, renderer.n_rays);
    HostGradients gradients = renderer.differentiable.use(
        [&](DifferentiableRenderer& both) { return both.backpropagate(d_values); });
    const auto rows = [](std::size_t count) { return static_cast<py::ssize_t>(count); };
    const std::size_t n_surfels = gradients.surfels.size();
    py::dict dict = to_array_dict(std::move(gradients.surfels));
    dict["touched"] = move_to_numpy<std::uint32_t>(std::move(gradients.touched), {rows(n_surfels)});
    // Gradients that were not enabled are empty. The six numbers of a row belong to
    // shift and rotation, or to origin and direction of a ray.
    if (!gradients.poses.empty())
        dict["poses"] = move_to_numpy<float>(std::move(gradients.poses), {rows(renderer.placed.size()), 6});
    if (!gradients.sensor.empty()) dict["sensor"] = move_to_numpy<float>(std::move(gradients.sensor), {6});
    if (!gradients.rays.empty())
        dict["rays"] = move_to_numpy<float>(std::move(gradients.rays), {rows(renderer.n_rays), 6});
    return dict;
}

void upload_surfels(PythonRenderer& renderer, const py::dict& arrays) {
    const Surfels surfels = read_surfels(arrays);
    renderer.use([&](Renderer& drawn) { drawn.upload_surfels(surfels); });
}

py::dict download_surfels(PythonRenderer& renderer) {
    Scene scene = renderer.use([](Renderer& drawn) { return drawn.download_scene(); });
    return to_array_dict(std::move(scene.surfels));
}

/// Wraps the arrays of all surfel parameters, or of their gradients.
py::dict wrap_surfels(const SharedDevice& device, const SurfelArrays& arrays) {
    py::dict dict;
    for (const SurfelParameterGroup& group : list_groups(arrays.parameters_used())) {
        const std::vector<std::size_t> shape = group.array_shape(arrays.n);
        dict[group.name] =
            wrap_array<float>(device, group.device(arrays), NumpyShape(shape.begin(), shape.end()));
    }
    return dict;
}

py::dict device_parameters(PythonRenderer& renderer) {
    renderer.use([](Renderer& drawn) { drawn.stream().submit_and_wait(); });
    return wrap_surfels(renderer.device(), renderer.drawn().scene().surfel_parameters());
}

/// Returns the memory of n structs for forward_device(). The memory never shrinks.
template <class Row>
DeviceArray reserve_rows(PythonRenderer& renderer, Array<Row>& rows, std::uint32_t n, const Row& initial) {
    if (rows.size() < n)
        renderer.use([&](Renderer& drawn) {
            drawn.stream().submit_and_wait();
            rows = {renderer.device()->device, std::vector<Row>(n, initial), "rays"};
        });
    return wrap_array<float>(renderer.device(), rows, {py::ssize_t(n), sizeof(Row) / 4});
}

/// Fails if a ray was not traced completely. Copies nothing if the host can read the
/// counter of such rays.
void check_truncation(Renderer& renderer) {
    const MemoryAddress counter = renderer.forward_pass().n_truncated_rays().buffer().address_for_others();
    const bool visible = counter.interface == MemoryAddress::Interface::host;
    if (!visible || *reinterpret_cast<const std::uint32_t*>(counter.pointer) != 0)
        renderer.check_truncation();
}

/// Renders the first n rays of device_rays(). The results stay in device memory: one
/// array per rendered value, and `d_rendered` for their gradients.
/// @param columns  width of the image of these rays; 0 if they are no image
/// @param measured  if true, computes likelihoods of the values in device_measured()
py::dict forward_device(PythonRenderer& renderer, IntegerArgument<std::uint32_t, "n"> n,
                        IntegerArgument<std::uint32_t, "columns"> columns, bool measured) {
    const std::size_t n_written =
        measured ? std::min(renderer.rays.size(), renderer.measured.size()) : renderer.rays.size();
    if (n == 0 || n > n_written)
        fail<UsageError>("cannot render {} rays: expected 1 to {}, the rows of device_rays(){}", n.value,
                         n_written, measured ? " and device_measured()" : "");
    if (measured && renderer.likelihood_scale_m == 0.0f)
        throw UsageError("cannot compute likelihoods: found loss.likelihood=0, expected a value above 0");
    if (columns != 0 && n % columns != 0)
        fail<UsageError>("cannot render {} rays in {} columns: expected a multiple", n.value, columns.value);
    renderer.use([&](Renderer& drawn) {
        drawn.record_forward({.rays = &renderer.rays,
                              .first = 0,
                              .stride = 1,
                              .n_rays = n,
                              .columns = columns,
                              .targets = measured ? &renderer.measured : nullptr});
        drawn.stream().submit_and_wait();
        check_truncation(drawn);
    });
    renderer.n_rays = n;
    const RenderedBatch batch = renderer.differentiable->last_batch();
    const auto wrap = [&](auto member) { return wrap_member(renderer.device(), *batch.rendered, member, n); };
    using shared::RenderedRay;
    py::dict dict;
    // One such line for each blended value, such as dict["depth"].
#define RELIDAR_VALUES(name, ...) dict[#name] = wrap(&RenderedRay::name);
    RELIDAR_BLENDED_VALUES(RELIDAR_VALUES)
#undef RELIDAR_VALUES
    dict["transmittance"] = wrap(&RenderedRay::transmittance);
    dict["median_depth"] = wrap(&RenderedRay::median_depth);
    dict["hits"] = wrap(&RenderedRay::n_hits);
    dict["instance"] = wrap(&RenderedRay::instance);
    // The caller writes dL/d(value) here before it calls backward_device().
    constexpr py::ssize_t kGradients = sizeof(shared::RayGradient) / sizeof(float);
    dict["d_rendered"] =
        wrap_array<float>(renderer.device(), *batch.upstream, {py::ssize_t(n.value), kGradients});
    return dict;
}

/// Computes gradients of the last forward pass from `d_rendered`, in device memory.
py::dict backward_device(PythonRenderer& renderer) {
    if (renderer.n_rays == 0)
        throw UsageError("cannot compute gradients: no rays were rendered; run the forward pass first");
    renderer.differentiable.use([](DifferentiableRenderer& both) {
        both.record_backward();
        both.renderer().stream().submit_and_wait();
    });
    const DeviceGradients& gradients = renderer.differentiable->gradients();
    const SharedDevice& device = renderer.device();
    py::dict dict = wrap_surfels(device, gradients.surfels);
    // 1 for each surfel with a gradient, as int32, because PyTorch has no uint32.
    dict["touched"] = wrap_array<std::int32_t>(device, gradients.touched, {py::ssize_t(gradients.surfels.n)});
    // Gradients that were not enabled are empty. See backward() for the six numbers.
    const auto n_instances = py::ssize_t(renderer.placed.size()), n_rays = py::ssize_t(renderer.n_rays);
    if (gradients.poses.size()) dict["poses"] = wrap_array<float>(device, gradients.poses, {n_instances, 6});
    if (gradients.sensor.size()) dict["sensor"] = wrap_array<float>(device, gradients.sensor, {6});
    if (gradients.rays.size()) dict["rays"] = wrap_array<float>(device, gradients.rays, {n_rays, 6});
    return dict;
}

}  // namespace

void bind_renderer(py::module_& module) {
    py::class_<PythonRenderer>(module, "DifferentiableRenderer",
                             "Renders rays and computes gradients for custom losses: forward() returns rendered values, and backward() converts their gradients to gradients of all parameters.\n"
                             "Call place(), forward() and backward(). After a change of parameters, call upload() and place() again. Scales, opacities and channels are\n"
                             "stored before their activation: scale = exp(log_scale), opacity = sigmoid(opacity_logit), channel = 0.5 + SH basis . sh.")
        .def(py::init(&make_renderer), py::arg("scene"), py::arg("config") = py::none(),
             py::kw_only(), py::arg("poses") = false, py::arg("rays") = false, py::arg("sparse") = false,
             py::arg("margin") = py::none(), py::arg("device") = py::none(),
             "scene: copied to the device\n"
             "config: its settings image.*, trace.* and train.deterministic define how rays are rendered and gradients are summed. If loss.likelihood is above 0,\n"
             "    forward_device() computes likelihoods. None: preset \"default\"\n"
             "poses, rays: if True, backward() also returns the gradients of poses and rays\n"
             "sparse: if True, the gradients of surfels with touched = 0 are undefined, which is faster\n"
             "margin: (factor, metres) by which the boxes of surfels are larger in the ray-tracing tree, so that surfels may grow and move before it must be\n"
             "    updated; None: only for rounding errors\n\n"
             "Raises DataError if models or instances of the scene are out of range.")
        .def_property_readonly("device", [](const PythonRenderer& renderer) { return renderer.device(); }, "The device of the renderer.")
        .def_readonly("likelihood_scale_m", &PythonRenderer::likelihood_scale_m, "Scale s of likelihoods, metres; 0: they are not computed.")
        .def("place", &set_poses, py::arg("poses") = py::none(), py::arg("view_origin") = py::none(),
             py::arg("present") = py::none(), py::kw_only(), py::arg("refit") = true,
             "Sets all poses. Call it before forward(), and again after poses, view_origin or parameters have changed.\n\n"
             "poses: [instances,4,4] float64, world from model, metres; None: unchanged, initially all at the origin\n"
             "view_origin: [3] float64, the sensor's position, from which SH directions start with image.sh_direction=surfel;\n"
             "    None: unchanged, initially the origin\n"
             "present: one bool per instance; None: unchanged, initially all are present\n"
             "refit: if False, does not update the ray-tracing tree of surfels. Their parameters must then be within `margin` of the last update")
        .def("place_frame", &place_frame, py::arg("run"), py::arg("position"), py::arg("view_origin") = py::none(),
             py::kw_only(), py::arg("refit") = true,
             "The same as place(), with the poses and motions that the actors of a run have during a frame. The scene must be of this run.\n\n"
             "position: of the frame in `times`\n"
             "view_origin: None: the sensor's position at the time of the frame")
        .def("forward", &run_forward, py::arg("origins"), py::arg("directions"),
             "Renders rays.\n\n"
             "origins: [n,3] float32, C order, world, metres\n"
             "directions: [n,3] float32, C order, world, length 1\n\n"
             "Returns arrays [n], where w is the weight of a hit: " RELIDAR_IMAGE_VALUES(
                 RELIDAR_MEANING) "transmittance, median_depth (metres, 0: none) float32;\n"
                                  "hits uint32 (blended surfels); instance int32 (-1: none).\n"
                                  "Raises UsageError if place() was not called.")
        .def("backward", &backward, py::arg("d_rendered"),
             "Computes gradients of a loss of the last forward pass. Poses, view_origin and parameters must be unchanged since then.\n\n"
             "d_rendered: dict of dL/d(value), [n] float32 each, for any of " RELIDAR_IMAGE_VALUES(
                 RELIDAR_NAME) "where missing gradients count as 0\n\n"
                               "Returns a dict of gradients dL/d(parameter), float32, where s is the number of surfels:\n"
                               "    mean [s,3], rotation [s,4], log_scale [s,2], opacity_logit [s], sh [s,3,16]\n"
                               "    log_scale_w [s]: only for 3D Gaussians\n"
                               "    touched [s] uint32: 1 if a surfel has a gradient\n"
                               "    poses [instances,6], sensor [6], if enabled by `poses`: dL/d(v, w) of small motions along the world's axes. v: shift in metres,\n"
                               "        w: rotation in radians about the origin of the model (poses) or about view_origin (sensor)\n"
                               "    rays [n,6], if enabled by `rays`: dL/d(origin, direction)")
        .def("upload", &upload_surfels, py::arg("surfels"),
             "Replaces the values of all parameters. The number of surfels must be the same. Call place() afterwards.")
        .def("download", &download_surfels,
             "Returns the current parameters as a dict of float32 arrays that relidar.Scene accepts.")
        .def("device_parameters", &device_parameters,
             "Returns the parameters in the memory of the device: dict of DeviceArray with the names and shapes of download(). Call place() after a change.")
        .def("device_rays", [](PythonRenderer& renderer, IntegerArgument<std::uint32_t, "n"> n) {
                 // Without firing times, no instance moves during the sweep.
                 return reserve_rows(renderer, renderer.rays, n, {{}, {}, RELIDAR_NO_TIME});
             }, py::arg("n"),
             "Returns memory for n rays, DeviceArray [n,7] float32: origin, direction (length 1), time in seconds (3e38: unknown). Further calls return the same\n"
             "memory, but a call with more rays than before allocates new memory.")
        .def("device_measured", [](PythonRenderer& renderer, IntegerArgument<std::uint32_t, "n"> n) {
                 return reserve_rows(renderer, renderer.measured, n, {0.0f, 0.0f, 1.0f});
             }, py::arg("n"),
             "Like device_rays(), for measured values, DeviceArray [n,3] float32: range in metres (0: no return), intensity (not used), weight (0: unknown).")
        .def("forward_device", &forward_device, py::arg("n"), py::arg("columns") = 0, py::arg("measured") = false,
             "Renders the first n rays of device_rays().\n\n"
             "columns: number of columns if the rays are an image in row order, which is faster on a GPU; 0: a list\n"
             "measured: if True, computes likelihoods of device_measured()\n\n"
             "Returns DeviceArrays: the values of forward(), valid until the next forward pass; hits and instance are int32. likelihood: sum of w / (1 + (e / s)^2) over\n"
             "the hits, where e is the distance to the measured range and s is likelihood_scale_m. d_rendered [n,k] float32: memory for the gradients of depth, weight,\n"
             "intensity, hit_logit, drop_logit and likelihood, in this order; set further columns to 0.")
        .def("backward_device", &backward_device,
             "Computes gradients of the last forward pass from d_rendered. Returns DeviceArrays with the names and shapes of backward(), valid until the next backward\n"
             "pass; touched is int32.");
}

}  // namespace relidar::python
