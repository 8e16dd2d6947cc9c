// SPDX-License-Identifier: Apache-2.0
// Creates compute pipelines from embedded SPIR-V modules and specialisation constants.
#include "gpu/kernel.hpp"

#include <algorithm>
#include <array>
#include <cstdio>
#include <map>
#include <set>

#include <fmt/format.h>

#include <relidar/base/error.hpp>

#include "gpu/pipeline_cache.hpp"
#include "gpu/pipeline_statistics.hpp"
#include "gpu/spirv.hpp"
#include "gpu/stream.hpp"

namespace relidar {

namespace {

std::span<const std::uint32_t> find_embedded_spirv(std::string_view name) {
    for (const EmbeddedKernel& kernel : embedded_kernels())
        if (kernel.name == name) return kernel.words;
    throw Error(
        ExitCode::bug,
        fmt::format("cannot create kernel {}: it is not embedded in this build; add it to src/CMakeLists.txt",
                    name));
}

/// Kernels that need reconvergence of lanes. They use subgroup operations in branches, or
/// in loops that lanes leave at different times.
constexpr std::array<std::string_view, 3> kReconverging{"diff/accel/bvh_cluster", "diff/backward/trace",
                                                        "gpu/check_subgroups"};

/// Returns true for lavapipe up to version 25.0. In these versions, a load in a branch
/// does nothing if no lane takes the branch.
bool skips_loads_in_branches(const std::string& driver) {
    int major = 0, minor = 0;
    const std::size_t version = driver.find("Mesa ");
    if (version == std::string::npos ||
        std::sscanf(driver.c_str() + version, "Mesa %d.%d", &major, &minor) != 2)
        return false;
    return major < 25 || (major == 25 && minor == 0);
}

/// Returns the SPIR-V code of a kernel, after the edits that this device needs.
std::vector<std::uint32_t> load_module_words(const Device::Impl& device, std::string_view name,
                                             std::string_view stem, const std::vector<Constant>& constants) {
    std::map<std::uint32_t, std::uint32_t> values;
    for (const Constant& c : constants) values[static_cast<std::uint32_t>(c.id)] = c.value;
    std::vector<std::uint32_t> words =
        gpu::make_parameters_read_only(gpu::resolve_branches(find_embedded_spirv(name), values));
    if (device.info.driver.starts_with("llvmpipe")) {
        if (!skips_loads_in_branches(device.info.driver)) words = gpu::make_indices_nonuniform(words);
        words = gpu::move_parameters_first(words);
    }
    if (std::find(kReconverging.begin(), kReconverging.end(), stem) != kReconverging.end()) {
        if (device.optional.maximal_reconvergence)
            return gpu::add_execution_mode(words, gpu::kMaximallyReconverges);
        if (device.optional.subgroup_uniform_control_flow)
            return gpu::add_execution_mode(words, gpu::kSubgroupUniformControlFlow);
    }
    return words;
}

/// Creates the Vulkan pipeline of a kernel.
/// @param name name of the kernel with its constants, for debuggers
gpu::Pipelines::Made make_pipeline(Device::Impl& device, std::span<const std::uint32_t> words,
                                   const std::string& name, const std::vector<Constant>& constants,
                                   Subgroups subgroups) {
    VkShaderModuleCreateInfo module_info{VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO};
    module_info.codeSize = words.size_bytes();
    module_info.pCode = words.data();
    VkShaderModule module = VK_NULL_HANDLE;
    gpu::check(vkCreateShaderModule(device.device, &module_info, nullptr, &module), "vkCreateShaderModule");
    gpu::name_object(device.device, VK_OBJECT_TYPE_SHADER_MODULE, module, name);
    std::vector<VkSpecializationMapEntry> map;
    for (std::size_t i = 0; i < constants.size(); ++i)
        map.push_back({static_cast<std::uint32_t>(constants[i].id),
                       static_cast<std::uint32_t>(i * sizeof(Constant) + offsetof(Constant, value)),
                       sizeof(std::uint32_t)});
    const VkSpecializationInfo specialisation{static_cast<std::uint32_t>(map.size()), map.data(),
                                              constants.size() * sizeof(Constant), constants.data()};
    VkComputePipelineCreateInfo info{VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
    // Large launches are split into several dispatches. This flag lets a dispatch begin
    // at any workgroup.
    info.flags = VK_PIPELINE_CREATE_DISPATCH_BASE_BIT;
    if (device.pipeline_statistics) info.flags |= VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR;
    info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
    info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
    info.stage.module = module;
    info.stage.pName = "main";
    info.stage.pSpecializationInfo = &specialisation;
    VkPipelineShaderStageRequiredSubgroupSizeCreateInfo lanes{
        VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_REQUIRED_SUBGROUP_SIZE_CREATE_INFO};
    lanes.requiredSubgroupSize = static_cast<std::uint32_t>(device.info.subgroup_size);
    if ((subgroups == Subgroups::full || device.forced_lanes) && device.optional.subgroup_size)
        info.stage.pNext = &lanes;
    if (subgroups == Subgroups::full && device.optional.full_subgroups)
        info.stage.flags = VK_PIPELINE_SHADER_STAGE_CREATE_REQUIRE_FULL_SUBGROUPS_BIT;
    info.layout = device.pipeline_layout;
    const VkPipelineCache cache = device.pipeline_cache ? device.pipeline_cache->handle() : VK_NULL_HANDLE;
    gpu::Pipelines::Made made{VK_SUCCESS, VK_NULL_HANDLE};
    made.result = vkCreateComputePipelines(device.device, cache, 1, &info, nullptr, &made.pipeline);
    vkDestroyShaderModule(device.device, module, nullptr);
    if (made.result == VK_SUCCESS)
        gpu::name_object(device.device, VK_OBJECT_TYPE_PIPELINE, made.pipeline, name);
    return made;
}

std::string make_pipeline_key(std::string_view name, const std::vector<Constant>& constants,
                              Subgroups subgroups) {
    std::string key = fmt::format("{} {}", name, subgroups == Subgroups::full);
    for (const Constant& c : constants)
        key += fmt::format(" {}={}", static_cast<std::uint32_t>(c.id), c.value);
    return key;
}

/// Limits the number of pipelines that are compiled at the same time. While this object
/// exists, it occupies one of the allowed compilations. The constructor waits for a free
/// one.
class Turn {
public:
    explicit Turn(std::counting_semaphore<>& compilers) : compilers_(compilers) { compilers_.acquire(); }
    ~Turn() { compilers_.release(); }

private:
    std::counting_semaphore<>& compilers_;
};

std::string format_constants(std::span<const std::uint32_t> words, std::vector<Constant> constants) {
    std::sort(constants.begin(), constants.end(),
              [](const Constant& first, const Constant& second) { return first.id < second.id; });
    const std::set<std::uint32_t> of_module = gpu::list_constant_ids(words);
    std::string text;
    for (const Constant& c : constants) {
        if (c.id == ConstantId::WORKGROUP_SIZE || !of_module.contains(static_cast<std::uint32_t>(c.id)))
            continue;
        text += fmt::format("{}{}={}", text.empty() ? "" : " ", get_name(c.id), c.value);
    }
    return text;
}

/// Returns the pipeline of a kernel. Creates it if no kernel with the same name and
/// constants exists.
/// @param launch_mode create the pipeline at its first use (deferred), or immediately in
/// another thread (async)
std::shared_future<gpu::Pipelines::Made> find_or_begin_pipeline(Device::Impl& device,
                                                                const KernelBase::Impl& kernel,
                                                                std::launch launch_mode) {
    const std::scoped_lock lock(device.pipelines.mutex);
    std::shared_future<gpu::Pipelines::Made>& made =
        device.pipelines.by_key[make_pipeline_key(kernel.module, kernel.constants, kernel.subgroups)];
    if (!made.valid())
        made = std::async(launch_mode, [&device, module = kernel.module, stem = kernel.name,
                                        constants = kernel.constants, subgroups = kernel.subgroups] {
            const Turn turn(device.pipelines.compilers);
            const std::string constants_shown = format_constants(find_embedded_spirv(module), constants);
            return make_pipeline(device, load_module_words(device, module, stem, constants),
                                 constants_shown.empty() ? module : module + " " + constants_shown, constants,
                                 subgroups);
        });
    return made;
}

}  // namespace

const char* get_name(ConstantId id) {
    switch (id) {
#define RELIDAR_CONSTANT_ID(name, number) \
    case ConstantId::name:                \
        return #name;
        RELIDAR_CONSTANTS(RELIDAR_CONSTANT_ID)
#undef RELIDAR_CONSTANT_ID
    }
    return "";
}

KernelBase::KernelBase(Device& owner, std::string_view name, const std::vector<Constant>& constants,
                       Subgroups subgroups)
    : impl_(std::make_unique<Impl>()) {
    Device::Impl& device = owner.impl();
    impl_->device = &device;
    impl_->module = std::string(name);
    impl_->name = std::string(name.substr(0, name.find('@')));
    impl_->constants = constants;
    impl_->subgroups = subgroups;
    std::vector<Constant>& all = impl_->constants;
    const auto size = std::find_if(all.begin(), all.end(),
                                   [](const Constant& c) { return c.id == ConstantId::WORKGROUP_SIZE; });
    impl_->workgroup_size = size == all.end() ? device.workgroup_size : size->value;
    if (size == all.end()) all.push_back({ConstantId::WORKGROUP_SIZE, device.workgroup_size});
    impl_->addresses = gpu::list_parameter_addresses(find_embedded_spirv(name));
    if (gpu::can_split_launch(impl_->name)) impl_->speed = &device.launch_limit.speed(impl_->name);
    impl_->made_ = find_or_begin_pipeline(device, *impl_,
                                          device.compiles_ahead ? std::launch::async : std::launch::deferred);
    if (device.compile_only) compile_only();
}

VkPipeline KernelBase::Impl::pipeline() {
    if (pipeline_) return pipeline_;
    const gpu::Pipelines::Made made = made_.get();
    if (made.result != VK_SUCCESS)
        gpu::fail(made.result,
                  fmt::format("cannot create kernel {} on {}: the driver returned {}, expected VK_SUCCESS",
                              module, device->info.name, gpu::get_result_name(made.result)));
    return pipeline_ = made.pipeline;
}

void KernelBase::compile_only() {
    Device::Impl& device = *impl_->device;
    PipelineStatistics s;
    s.kernel = impl_->module;
    s.constants = format_constants(find_embedded_spirv(impl_->module), impl_->constants);
    s.workgroup_size = static_cast<int>(impl_->workgroup_size);
    const auto is_same = [&](const PipelineStatistics& known) {
        return known.kernel == s.kernel && known.constants == s.constants &&
               known.workgroup_size == s.workgroup_size;
    };
    if (std::any_of(device.compiled.begin(), device.compiled.end(), is_same)) return;
    const gpu::Pipelines::Made made = impl_->made_.get();
    if (made.result != VK_SUCCESS) s.failure = gpu::get_result_name(made.result);
    else if (device.pipeline_statistics) gpu::read_statistics(device.device, made.pipeline, s);
    device.compiled.push_back(s);
}

KernelBase::~KernelBase() = default;

bool has_maximal_reconvergence(const Device& device) {
    const gpu::OptionalFeatures& optional = device.impl().optional;
    return optional.maximal_reconvergence || optional.subgroup_uniform_control_flow;
}

std::string list_missing_for_networks(const Device& device) {
    VkPhysicalDeviceSubgroupSizeControlProperties sizes{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_SIZE_CONTROL_PROPERTIES};
    VkPhysicalDeviceSubgroupProperties subgroup{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES,
                                                &sizes};
    VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &subgroup};
    vkGetPhysicalDeviceProperties2(device.impl().physical, &properties);
    return gpu::list_missing_for_networks(subgroup, sizes, device.impl().optional);
}

KernelVariant choose_accumulating_variant(const Device& device, const KernelVariant& variant) {
    if (device.impl().wrong_sums)
        throw DeviceError(
            fmt::format("cannot add gradients on {}: the device gives wrong sums of floats; `relidar check` "
                        "shows details",
                        device.info().name));
    return KernelVariant(variant.suffix + (device.info().float_atomics ? "_atomics" : "_swap"));
}

}  // namespace relidar
