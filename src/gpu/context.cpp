// SPDX-License-Identifier: Apache-2.0
// Opens a Vulkan device. Creates the instance, checks the required features, gets one
// compute queue and creates the pipeline layout of all kernels. One error lists all
// missing features.
#include "gpu/context.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>
#include <tuple>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <relidar/gpu/out_of_memory.hpp>

#include "base/fail.hpp"
#include "gpu/buffer.hpp"
#include "gpu/external_memory.hpp"
#include "gpu/missing_drivers.hpp"
#include "gpu/pipeline_cache.hpp"
#include "gpu/trust.hpp"

namespace relidar::gpu {

void vk_check(VkResult result, const char* call_name) {
    if (result >= 0) return;
    vk_fail(result, fmt::format("{} failed: the driver returned {}, expected VK_SUCCESS", call_name,
                                vk_result_name(result)));
}

void vk_fail(VkResult result, const std::string& message) {
    if (result == VK_ERROR_DEVICE_LOST) throw DeviceLost(message);
    if (result == VK_ERROR_OUT_OF_DEVICE_MEMORY || result == VK_ERROR_OUT_OF_HOST_MEMORY)
        throw OutOfDeviceMemory(message);
    throw DeviceError(message);
}

/// Returns the name of a result code, or its number if it is unusual.
std::string vk_result_name(VkResult result) {
    static const std::map<VkResult, const char*> kNames = {
        {VK_TIMEOUT, "VK_TIMEOUT"},
        {VK_ERROR_OUT_OF_HOST_MEMORY, "VK_ERROR_OUT_OF_HOST_MEMORY"},
        {VK_ERROR_OUT_OF_DEVICE_MEMORY, "VK_ERROR_OUT_OF_DEVICE_MEMORY"},
        {VK_ERROR_INITIALIZATION_FAILED, "VK_ERROR_INITIALIZATION_FAILED"},
        {VK_ERROR_DEVICE_LOST,
         "VK_ERROR_DEVICE_LOST (the device hung or was removed, or its driver was restarted)"},
        {VK_ERROR_LAYER_NOT_PRESENT, "VK_ERROR_LAYER_NOT_PRESENT"},
        {VK_ERROR_EXTENSION_NOT_PRESENT, "VK_ERROR_EXTENSION_NOT_PRESENT"},
        {VK_ERROR_FEATURE_NOT_PRESENT, "VK_ERROR_FEATURE_NOT_PRESENT"},
        {VK_ERROR_INCOMPATIBLE_DRIVER, "VK_ERROR_INCOMPATIBLE_DRIVER"}};
    const auto name = kNames.find(result);
    return name == kNames.end() ? fmt::format("VkResult {}", static_cast<int>(result)) : name->second;
}

namespace {

VkBool32 on_validation(VkDebugUtilsMessageSeverityFlagBitsEXT, VkDebugUtilsMessageTypeFlagsEXT,
                       const VkDebugUtilsMessengerCallbackDataEXT* message, void* instance) {
    static_cast<VulkanInstance*>(instance)->n_messages++;
    std::fprintf(stderr, "validation: %s\n", message->pMessage);
    return VK_FALSE;
}

/// Returns the description of a messenger that counts and prints warnings and errors of
/// the validation layer.
VkDebugUtilsMessengerCreateInfoEXT messenger_info(VulkanInstance* instance) {
    VkDebugUtilsMessengerCreateInfoEXT info{VK_STRUCTURE_TYPE_DEBUG_UTILS_MESSENGER_CREATE_INFO_EXT};
    info.messageSeverity =
        VK_DEBUG_UTILS_MESSAGE_SEVERITY_WARNING_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_SEVERITY_ERROR_BIT_EXT;
    info.messageType =
        VK_DEBUG_UTILS_MESSAGE_TYPE_VALIDATION_BIT_EXT | VK_DEBUG_UTILS_MESSAGE_TYPE_PERFORMANCE_BIT_EXT;
    info.pfnUserCallback = on_validation;
    info.pUserData = instance;
    return info;
}

bool has_debug_utils() {
    const auto extensions = enumerate<VkExtensionProperties>(
        "vkEnumerateInstanceExtensionProperties", [](std::uint32_t* n, auto* properties) {
            return vkEnumerateInstanceExtensionProperties(nullptr, n, properties);
        });
    return std::ranges::any_of(extensions, [](const VkExtensionProperties& e) {
        return std::strcmp(e.extensionName, VK_EXT_DEBUG_UTILS_EXTENSION_NAME) == 0;
    });
}

}  // namespace

/// Loads the Vulkan loader. Further calls have no effect.
void load_vulkan() {
    if (volkInitialize() != VK_SUCCESS)
        throw DeviceError(
            "cannot use Vulkan: the Vulkan loader (libvulkan.so.1) is not installed; install it with the "
            "package manager of your system");
}

/// Creates a Vulkan instance, which gives access to the drivers.
/// @param validation true: enables the validation layer, which checks all calls
VulkanInstance::VulkanInstance(bool validation) {
    load_vulkan();
    VkApplicationInfo app{VK_STRUCTURE_TYPE_APPLICATION_INFO};
    app.pApplicationName = "relidar";
    app.apiVersion = VK_API_VERSION_1_3;
    const char* layer = "VK_LAYER_KHRONOS_validation";
    const char* extension = VK_EXT_DEBUG_UTILS_EXTENSION_NAME;
    VkInstanceCreateInfo info{VK_STRUCTURE_TYPE_INSTANCE_CREATE_INFO};
    info.pApplicationInfo = &app;
    VkDebugUtilsMessengerCreateInfoEXT debug = messenger_info(this);
    // Enables VK_EXT_debug_utils always, so that debuggers show the names of objects.
    if (validation || has_debug_utils()) {
        info.enabledExtensionCount = 1;
        info.ppEnabledExtensionNames = &extension;
    }
    if (validation) {
        info.pNext = &debug;
        info.enabledLayerCount = 1;
        info.ppEnabledLayerNames = &layer;
    }
    const VkResult result = vkCreateInstance(&info, nullptr, &handle);
    if (result == VK_ERROR_INCOMPATIBLE_DRIVER) {
        if (const std::vector<std::string> problems = find_broken_drivers(); !problems.empty())
            throw DeviceError(fmt::format("cannot use Vulkan: {}", fmt::join(problems, "; ")));
        throw DeviceError(
            "cannot use Vulkan: no Vulkan driver is installed; install the driver of the GPU, or the "
            "software driver of Mesa; VK_DRIVER_FILES can also select a driver");
    }
    if (result == VK_ERROR_LAYER_NOT_PRESENT)
        throw DeviceError(
            "cannot enable Vulkan validation: VK_LAYER_KHRONOS_validation is not installed; install the "
            "package vulkan-validationlayers");
    vk_check(result, "vkCreateInstance");
    volkLoadInstance(handle);
    if (!validation) return;
    destroy_messenger = vkDestroyDebugUtilsMessengerEXT;
    vk_check(vkCreateDebugUtilsMessengerEXT(handle, &debug, nullptr, &messenger),
             "vkCreateDebugUtilsMessengerEXT");
}

VulkanInstance::~VulkanInstance() {
    if (messenger) destroy_messenger(handle, messenger, nullptr);
    if (handle) vkDestroyInstance(handle, nullptr);
}

std::vector<VkPhysicalDevice> list_physical_devices(VkInstance instance) {
    return enumerate<VkPhysicalDevice>("vkEnumeratePhysicalDevices", [&](std::uint32_t* n, auto* devices) {
        return vkEnumeratePhysicalDevices(instance, n, devices);
    });
}

}  // namespace relidar::gpu

namespace relidar {

namespace {

std::vector<DeviceInfo> describe_devices(const std::vector<VkPhysicalDevice>& physical_devices) {
    std::vector<DeviceInfo> infos;
    for (std::size_t i = 0; i < physical_devices.size(); ++i)
        infos.push_back(gpu::make_device_info(physical_devices[i], static_cast<int>(i)));
    return infos;
}

/// Returns the index of the requested device. If none is requested, prefers usable
/// devices that support the traversal, then GPUs, then those with ray queries.
int choose_device(const std::vector<DeviceInfo>& device_infos, const DeviceOptions& options) {
    if (device_infos.empty())
        throw DeviceError(
            "cannot open a device: this machine has no Vulkan device, expected at least one; install a GPU "
            "driver or the software driver of Mesa");
    const int n = static_cast<int>(device_infos.size());
    if (options.index >= n)
        fail<DeviceError>(
            "cannot open device {}: this machine has {} devices, expected a number from 0 to {}",
            options.index, n, n - 1);
    if (options.index >= 0) return options.index;
    const auto preference = [&](const DeviceInfo& device) {
        // For `automatic`, the device must support at least one traversal method.
        bool can_trace = best_backend(device) != RayTracingBackend::automatic;
        if (options.traversal == RayTracingBackend::ray_query) can_trace = device.ray_query;
        if (options.traversal == RayTracingBackend::software) can_trace = device.software;
        const bool is_usable = device.why_not_usable.empty(), is_gpu = device.type != "CPU";
        return std::tuple(is_usable, can_trace, is_gpu, device.ray_query);
    };
    return std::ranges::max_element(device_infos, {}, preference)->index;  // the first of equal devices
}

/// Checks that a device has the features that relidar and the traversal method need.
/// @param is_lent true if another program has opened the device
/// @throws DeviceError with the names of the missing features
void check_backend(const DeviceInfo& info, RayTracingBackend requested_backend, bool is_lent) {
    if (!info.why_not_usable.empty())
        fail<DeviceError>("cannot open device {} ({}): {} these required features: {}", info.index, info.name,
                          is_lent ? "the program that lends it has not enabled" : "it lacks",
                          info.why_not_usable);
    if (requested_backend == RayTracingBackend::ray_query && !info.ray_query)
        fail<DeviceError>("cannot open device {} ({}) with ray query: it lacks {}; use --traversal auto",
                          info.index, info.name, info.why_not_ray_query);
    if (requested_backend == RayTracingBackend::software && !info.software)
        fail<DeviceError>(
            "cannot open device {} ({}) with software traversal: it lacks {}; use --traversal auto",
            info.index, info.name, info.why_not_software);
    // SwiftShader cannot run the tracing kernels, but tests run all other kernels on it.
    const bool can_trace = best_backend(info) != RayTracingBackend::automatic;
    if (requested_backend == RayTracingBackend::automatic && !can_trace && !gpu::is_swiftshader(info))
        fail<DeviceError>(
            "cannot open device {} ({}): for ray query it lacks {}, and for software traversal {}",
            info.index, info.name, info.why_not_ray_query, info.why_not_software);
}

}  // namespace

std::vector<DeviceInfo> list_devices() {
    const gpu::VulkanInstance instance(false);
    return describe_devices(gpu::list_physical_devices(instance.handle));
}

RayTracingBackend parse_backend(const std::string& name) {
    const std::optional<std::string> matching_name = find_name(name, {"auto", "ray_query", "software"});
    if (!matching_name)
        fail<UsageError>("cannot select the traversal: found \"{}\", expected auto, ray_query or software",
                         name);
    if (matching_name == "auto") return RayTracingBackend::automatic;
    return matching_name == "software" ? RayTracingBackend::software : RayTracingBackend::ray_query;
}

RayTracingBackend best_backend(const DeviceInfo& info) {
    if (info.software && (info.type == "CPU" || !info.ray_query)) return RayTracingBackend::software;
    return info.ray_query ? RayTracingBackend::ray_query : RayTracingBackend::automatic;
}

Device::Device(const DeviceOptions& options) : impl_(std::make_unique<Impl>()) {
    impl_->instance = std::make_unique<gpu::VulkanInstance>(options.validation);
    const std::vector<VkPhysicalDevice> physical = gpu::list_physical_devices(impl_->instance->handle);
    const std::vector<DeviceInfo> infos = describe_devices(physical);
    const int index = choose_device(infos, options);
    impl_->info = infos[static_cast<std::size_t>(index)];
    if (options.report_missing_drivers && options.index < 0 && impl_->info.type == "CPU")
        for (const std::string& line : find_driverless(infos))
            gpu::report_note(line + "; relidar uses " + impl_->info.name);
    impl_->physical = physical[static_cast<std::size_t>(index)];
    impl_->open_device(options);
}

Device::Device(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

Device Device::from_vulkan(const LentVulkan& lent, const DeviceOptions& options) {
    gpu::Missing handles;
    handles.require(lent.instance != nullptr, "instance");
    handles.require(lent.physical_device != nullptr, "physical_device");
    handles.require(lent.device != nullptr, "device");
    handles.require(lent.queue != nullptr, "queue");
    if (!handles.text.empty())
        fail<DeviceError>("cannot use the Vulkan device of another program: these handles are null: {}",
                          handles.text);
    gpu::load_vulkan();
    const auto instance = static_cast<VkInstance>(lent.instance);
    volkLoadInstance(instance);
    auto impl = std::make_unique<Impl>();
    impl->lent = lent;
    impl->physical = static_cast<VkPhysicalDevice>(lent.physical_device);
    impl->device = static_cast<VkDevice>(lent.device);
    impl->queue = static_cast<VkQueue>(lent.queue);
    impl->queue_family = lent.queue_family;
    const auto devices = gpu::list_physical_devices(instance);
    const auto index = std::ranges::find(devices, impl->physical) - devices.begin();
    impl->info = gpu::make_device_info(impl->physical, int(index), &lent);
    impl->open_device(options);
    return Device(std::move(impl));
}

Device::~Device() = default;
void Device::check_process() const { impl_->check_process(); }
const DeviceInfo& Device::info() const { return impl_->info; }
RayTracingBackend Device::backend() const { return impl_->traversal; }
std::uint64_t Device::allocated_bytes() const { return impl_->allocated; }
std::uint64_t Device::peak_bytes() const { return impl_->peak; }
TransferCounts Device::transfers() const {
    return {impl_->n_uploads, impl_->upload_bytes, impl_->n_downloads, impl_->download_bytes,
            impl_->staged_bytes};
}
const std::vector<PipelineStatistics>& Device::statistics() const { return impl_->compiled; }

void Device::Impl::check_process() const {
    if (is_forked())
        fail<DeviceError>(
            "cannot use {}: process {} opened the device, and process {}, which was forked from it, cannot "
            "use "
            "it; start workers with spawn instead, in Python with multiprocessing.get_context(\"spawn\")",
            info.name, process, ::getpid());
}

void Device::Impl::select_traversal(RayTracingBackend requested) {
    check_backend(info, requested, lent.has_value());
    traversal = requested == RayTracingBackend::automatic ? best_backend(info) : requested;
    // If no traversal method works, selects the software tree. The constructor of the
    // software tree then throws an error with the reason.
    if (traversal == RayTracingBackend::automatic) traversal = RayTracingBackend::software;
}

/// Opens the selected physical device, or uses the lent one. Creates the objects that all
/// streams and kernels share: allocator, transfers, pipeline cache.
void Device::Impl::open_device(const DeviceOptions& options) {
    select_traversal(options.traversal);
    memory_limit_bytes = options.memory_limit_bytes;
    share_memory = options.share_memory;
    compile_only = options.compile_only;
    // May change `traversal` and `info`, on which the enabled features depend.
    gpu::disable_failed(*this, gpu::check_results(*this, options));
    select_queue();
    optional = gpu::query_features(physical, lender());
    if (!lent) create_device();
    gpu::set_object_name(device, VK_OBJECT_TYPE_DEVICE, device, "relidar");
    gpu::set_object_name(device, VK_OBJECT_TYPE_QUEUE, queue, "compute queue");
    query_limits();
    create_layout();
    if (compile_only) return;  // A driver without hardware lacks the functions that are called below.
    pipeline_cache = std::make_unique<gpu::PipelineCache>(physical, device, options.pipeline_cache);
    // Other programs get the host address of arrays of a CPU. A GPU exports its memory.
    const bool map_arrays = share_memory && info.type == "CPU";
    memory = std::make_unique<gpu::DeviceMemoryAllocator>(physical, device, map_arrays, exports_memory);
    transfers = std::make_unique<gpu::BufferTransfers>(*this);
    // Kernels get the address of these zeros instead of arrays that a launch leaves out.
    constexpr std::size_t kNothingBytes = 64 << 10;
    nothing = std::make_unique<Buffer::Impl>(*this, kNothingBytes, gpu::BufferPurpose::parameters,
                                             "placeholder for optional arrays");
    std::memset(nothing->mapped, 0, kNothingBytes);
}

namespace {

/// Extensions and features with which a device is created. The features are a linked
/// list: first those of Vulkan 1.0, 1.2 and 1.3, then those of extensions.
struct EnabledFeatures {
    std::vector<const char*> extensions;
    VkPhysicalDeviceVulkan13Features v13{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_3_FEATURES};
    VkPhysicalDeviceVulkan12Features v12{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_VULKAN_1_2_FEATURES, &v13};
    VkPhysicalDeviceFeatures2 base{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_FEATURES_2, &v12};
    VkPhysicalDeviceAccelerationStructureFeaturesKHR accel{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_ACCELERATION_STRUCTURE_FEATURES_KHR};
    VkPhysicalDeviceRayQueryFeaturesKHR query{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_RAY_QUERY_FEATURES_KHR};
    VkPhysicalDeviceShaderAtomicFloatFeaturesEXT atomics{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_ATOMIC_FLOAT_FEATURES_EXT};
    VkPhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR uniform{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_SUBGROUP_UNIFORM_CONTROL_FLOW_FEATURES_KHR};
    VkPhysicalDevicePipelineExecutablePropertiesFeaturesKHR executables{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PIPELINE_EXECUTABLE_PROPERTIES_FEATURES_KHR};
#ifdef VK_KHR_shader_maximal_reconvergence
    VkPhysicalDeviceShaderMaximalReconvergenceFeaturesKHR maximal{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SHADER_MAXIMAL_RECONVERGENCE_FEATURES_KHR};
#endif

    EnabledFeatures() {
        v13.maintenance4 = VK_TRUE;
        v12.bufferDeviceAddress = VK_TRUE;
        v12.scalarBlockLayout = VK_TRUE;
        v12.timelineSemaphore = VK_TRUE;
        v12.hostQueryReset = VK_TRUE;
    }
    EnabledFeatures(const EnabledFeatures&) = delete;
    EnabledFeatures& operator=(const EnabledFeatures&) = delete;

    /// Adds an extension, and the feature that it needs.
    template <class Features>
    void enable(const char* extension, Features& features, VkBool32 Features::*flag) {
        extensions.push_back(extension);
        features.*flag = VK_TRUE;
        *end_ = &features;
        end_ = &features.pNext;
    }

private:
    void** end_ = &v13.pNext;
};

/// Enables the optional features that the device has and relidar can use.
void enable_optional(const Device::Impl& device, EnabledFeatures& features) {
    features.base.features.sparseBinding = device.binds_sparse;
    features.v13.subgroupSizeControl = device.optional.subgroup_size;
    features.v13.computeFullSubgroups = device.optional.full_subgroups;
    if (device.traversal == RayTracingBackend::ray_query) {
        features.extensions.push_back(VK_KHR_DEFERRED_HOST_OPERATIONS_EXTENSION_NAME);
        features.enable(VK_KHR_ACCELERATION_STRUCTURE_EXTENSION_NAME, features.accel,
                        &VkPhysicalDeviceAccelerationStructureFeaturesKHR::accelerationStructure);
        features.enable(VK_KHR_RAY_QUERY_EXTENSION_NAME, features.query,
                        &VkPhysicalDeviceRayQueryFeaturesKHR::rayQuery);
    }
    if (device.pipeline_statistics)
        features.enable(VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME, features.executables,
                        &VkPhysicalDevicePipelineExecutablePropertiesFeaturesKHR::pipelineExecutableInfo);
    if (device.info.float_atomics)
        features.enable(VK_EXT_SHADER_ATOMIC_FLOAT_EXTENSION_NAME, features.atomics,
                        &VkPhysicalDeviceShaderAtomicFloatFeaturesEXT::shaderBufferFloat32AtomicAdd);
    if (device.optional.subgroup_uniform_control_flow)
        features.enable(
            VK_KHR_SHADER_SUBGROUP_UNIFORM_CONTROL_FLOW_EXTENSION_NAME, features.uniform,
            &VkPhysicalDeviceShaderSubgroupUniformControlFlowFeaturesKHR::shaderSubgroupUniformControlFlow);
#ifdef VK_KHR_shader_maximal_reconvergence
    if (device.optional.maximal_reconvergence)
        features.enable(VK_KHR_SHADER_MAXIMAL_RECONVERGENCE_EXTENSION_NAME, features.maximal,
                        &VkPhysicalDeviceShaderMaximalReconvergenceFeaturesKHR::shaderMaximalReconvergence);
#endif
    if (device.exports_memory) features.extensions.push_back(VK_KHR_EXTERNAL_MEMORY_FD_EXTENSION_NAME);
}

}  // namespace

/// Selects the first queue family that can compute, or the lent one. Reads whether it can
/// bind sparse buffers, and how many bits of its time stamps are valid.
void Device::Impl::select_queue() {
    std::uint32_t n = 0;
    vkGetPhysicalDeviceQueueFamilyProperties(physical, &n, nullptr);
    std::vector<VkQueueFamilyProperties> families(n);
    vkGetPhysicalDeviceQueueFamilyProperties(physical, &n, families.data());
    const auto can_compute = [](const VkQueueFamilyProperties& family) {
        return (family.queueFlags & VK_QUEUE_COMPUTE_BIT) != 0;
    };
    if (!lent) queue_family = std::uint32_t(std::ranges::find_if(families, can_compute) - families.begin());
    if (queue_family >= n || !can_compute(families[queue_family]))
        fail<DeviceError>("cannot open device {} ({}): the queue family {} cannot compute", info.index,
                          info.name, queue_family);
    const VkQueueFamilyProperties& family = families[queue_family];
    VkPhysicalDeviceFeatures features;
    vkGetPhysicalDeviceFeatures(physical, &features);
    binds_sparse = features.sparseBinding && gpu::is_enabled(lender(), "sparseBinding") &&
                   (family.queueFlags & VK_QUEUE_SPARSE_BINDING_BIT) != 0;
    const std::uint32_t n_bits = family.timestampValidBits;
    if (n_bits > 0 && n_bits < 64) timestamp_mask = (std::uint64_t(1) << n_bits) - 1;
}

/// Creates the Vulkan device with one queue. Enables the required features, and those
/// optional features that the device has and relidar can use.
void Device::Impl::create_device() {
    pipeline_statistics =
        compile_only && gpu::has_extension(physical, VK_KHR_PIPELINE_EXECUTABLE_PROPERTIES_EXTENSION_NAME);
    exports_memory = share_memory && info.type != "CPU" && gpu::can_export(physical, binds_sparse);
    EnabledFeatures features;
    enable_optional(*this, features);
    extensions = features.extensions;

    const float priority = 1.0f;
    VkDeviceQueueCreateInfo queue_info{VK_STRUCTURE_TYPE_DEVICE_QUEUE_CREATE_INFO};
    queue_info.queueFamilyIndex = queue_family;
    queue_info.queueCount = 1;
    queue_info.pQueuePriorities = &priority;
    VkDeviceCreateInfo device_info{VK_STRUCTURE_TYPE_DEVICE_CREATE_INFO, &features.base};
    device_info.queueCreateInfoCount = 1;
    device_info.pQueueCreateInfos = &queue_info;
    device_info.enabledExtensionCount = static_cast<std::uint32_t>(extensions.size());
    device_info.ppEnabledExtensionNames = extensions.data();
    gpu::vk_check(vkCreateDevice(physical, &device_info, nullptr, &device), "vkCreateDevice");
    vkGetDeviceQueue(device, queue_family, 0, &queue);
}

/// Reads limits of the driver. Chooses how kernels are compiled and launched on this
/// device, and computes the sizes of the largest buffer and of the largest allocation.
void Device::Impl::query_limits() {
    const gpu::DeviceProperties properties(physical);
    const VkPhysicalDeviceLimits& limits = properties.base.properties.limits;
    const bool is_cpu = info.type == "CPU";
    timestamp_period_ns = limits.timestampPeriod;
    compiles_ahead = !is_cpu && !compile_only;
    // Long dispatches are split into pieces of 0.25 s, so that the watchdog of the
    // operating system does not reset the GPU. CPU devices have no watchdog.
    if (!is_cpu) launch_limit.piece_s = 0.25;
    workgroup_size = std::max(32u, static_cast<std::uint32_t>(info.subgroup_size));
    if (traversal == RayTracingBackend::ray_query)
        scratch_alignment = std::max(1u, properties.accel.minAccelerationStructureScratchOffsetAlignment);

    largest_allocation = {properties.maintenance3.maxMemoryAllocationSize, "maxMemoryAllocationSize"};
    largest_buffer = {properties.maintenance4.maxBufferSize, "maxBufferSize"};
    const auto limit_buffer = [&](const DriverMemoryLimit& limit) {
        if (limit.n_bytes < largest_buffer.n_bytes) largest_buffer = limit;
    };
    if (info.memory_bytes) limit_buffer({info.memory_bytes, "the device memory"});  // 0: unknown
    // Only a sparse buffer can consist of several allocations. lavapipe ("llvmpipe")
    // reports a limit of 2 GiB for sparse buffers, but larger buffers work.
    if (!binds_sparse) limit_buffer(largest_allocation);
    else if (!info.driver.starts_with("llvmpipe"))
        limit_buffer({limits.sparseAddressSpaceSize, "sparseAddressSpaceSize"});
}

void Device::Impl::create_layout() {
    const VkPushConstantRange range{VK_SHADER_STAGE_COMPUTE_BIT, 0, 2 * sizeof(std::uint64_t)};
    VkPipelineLayoutCreateInfo layout{VK_STRUCTURE_TYPE_PIPELINE_LAYOUT_CREATE_INFO};
    layout.pushConstantRangeCount = 1;
    layout.pPushConstantRanges = &range;
    gpu::vk_check(vkCreatePipelineLayout(device, &layout, nullptr, &pipeline_layout),
                  "vkCreatePipelineLayout");
    gpu::set_object_name(device, VK_OBJECT_TYPE_PIPELINE_LAYOUT, pipeline_layout, "two addresses");
}

Device::Impl::Impl() = default;

Device::Impl::~Impl() {
    if (!device) return;
    if (is_forked()) {
        // Leaks everything, because driver calls could wait for its missing threads.
        static_cast<void>(nothing.release());
        static_cast<void>(transfers.release());
        static_cast<void>(memory.release());
        static_cast<void>(pipeline_cache.release());
        static_cast<void>(instance.release());
        static_cast<void>(new auto(std::move(pipelines.by_key)));
        return;
    }
    // Buffers return their memory to the allocator, so they are destroyed before it.
    nothing.reset();
    transfers.reset();
    for (const OrphanedBuffer& orphan : orphans) destroy_buffer(orphan);
    memory.reset();
    for (const auto& [key, made] : pipelines.by_key) {
        // Deferred: the kernel was never launched, so its pipeline does not exist.
        if (made.wait_for(std::chrono::seconds(0)) == std::future_status::deferred) continue;
        try {
            vkDestroyPipeline(device, made.get().pipeline, nullptr);
        } catch (const Error&) {}
    }
    pipeline_cache.reset();
    if (pipeline_layout) vkDestroyPipelineLayout(device, pipeline_layout, nullptr);
    if (!lent) vkDestroyDevice(device, nullptr);
}

void Device::Impl::wait_idle() noexcept {
    // A driver without hardware has no work and cannot wait.
    if (compile_only || is_forked()) return;
    const std::lock_guard lock(queue_mutex);
    // The owner of a lent device may use its other queues.
    if (lent) vkQueueWaitIdle(queue);
    else vkDeviceWaitIdle(device);
}

void Device::Impl::submit_to_queue(const VkSubmitInfo& submit_info, VkFence fence) {
    check_process();
    const std::lock_guard lock(queue_mutex);
    gpu::vk_check(vkQueueSubmit(queue, 1, &submit_info, fence), "vkQueueSubmit");
}

}  // namespace relidar
