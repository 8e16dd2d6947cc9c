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

/// Returns true for lavapipe up to version 25.0. In these versions, a load in a branch is
/// skipped if no lane takes the branch.
bool has_safe_loads_in_branches(const std::string& driver_name) {
    int major = 0, minor = 0;
    const std::size_t version = driver_name.find("Mesa ");
    if (version == std::string::npos ||
        std::sscanf(driver_name.c_str() + version, "Mesa %d.%d", &major, &minor) != 2)
        return false;
    return major < 25 || (major == 25 && minor == 0);
}

/// Returns the SPIR-V code of a kernel, after the edits that this device needs.
std::vector<std::uint32_t> load_spirv_words(const Device::Impl& device, std::string_view name,
                                            std::string_view base_name,
                                            const std::vector<SpecialisationConstant>& constants) {
    std::map<std::uint32_t, std::uint32_t> values;
    for (const SpecialisationConstant& c : constants) values[static_cast<std::uint32_t>(c.id)] = c.value;
    std::vector<std::uint32_t> words =
        gpu::make_parameters_read_only(gpu::remove_constant_branches(find_embedded_spirv(name), values));
    if (device.info.driver.starts_with("llvmpipe")) {
        if (!has_safe_loads_in_branches(device.info.driver)) words = gpu::make_indices_nonuniform(words);
        words = gpu::hoist_parameter_loads(words);
    }
    if (std::find(kReconverging.begin(), kReconverging.end(), base_name) != kReconverging.end()) {
        if (device.optional.maximal_reconvergence)
            return gpu::add_execution_mode(words, gpu::kMaximallyReconverges);
        if (device.optional.subgroup_uniform_control_flow)
            return gpu::add_execution_mode(words, gpu::kSubgroupUniformControlFlow);
    }
    return words;
}

/// Creates the Vulkan pipeline of a kernel.
/// @param name name of the kernel with its constants, for debuggers
gpu::ComputePipelines::CompiledPipeline make_pipeline(Device::Impl& device,
                                                      std::span<const std::uint32_t> words,
                                                      const std::string& name,
                                                      const std::vector<SpecialisationConstant>& constants,
                                                      SubgroupRequirement subgroups) {
    VkShaderModuleCreateInfo module_info{VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO};
    module_info.codeSize = words.size_bytes();
    module_info.pCode = words.data();
    VkShaderModule module = VK_NULL_HANDLE;
    gpu::check_vulkan_result(vkCreateShaderModule(device.device, &module_info, nullptr, &module),
                             "vkCreateShaderModule");
    gpu::set_object_name(device.device, VK_OBJECT_TYPE_SHADER_MODULE, module, name);
    std::vector<VkSpecializationMapEntry> map;
    for (std::size_t i = 0; i < constants.size(); ++i)
        map.push_back({static_cast<std::uint32_t>(constants[i].id),
                       static_cast<std::uint32_t>(i * sizeof(SpecialisationConstant) +
                                                  offsetof(SpecialisationConstant, value)),
                       sizeof(std::uint32_t)});
    const VkSpecializationInfo specialisation{static_cast<std::uint32_t>(map.size()), map.data(),
                                              constants.size() * sizeof(SpecialisationConstant),
                                              constants.data()};
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
    if ((subgroups == SubgroupRequirement::full || device.forced_lanes) && device.optional.subgroup_size)
        info.stage.pNext = &lanes;
    if (subgroups == SubgroupRequirement::full && device.optional.full_subgroups)
        info.stage.flags = VK_PIPELINE_SHADER_STAGE_CREATE_REQUIRE_FULL_SUBGROUPS_BIT;
    info.layout = device.pipeline_layout;
    const VkPipelineCache cache = device.pipeline_cache ? device.pipeline_cache->handle() : VK_NULL_HANDLE;
    gpu::ComputePipelines::CompiledPipeline made{VK_SUCCESS, VK_NULL_HANDLE};
    made.result = vkCreateComputePipelines(device.device, cache, 1, &info, nullptr, &made.pipeline);
    vkDestroyShaderModule(device.device, module, nullptr);
    if (made.result == VK_SUCCESS)
        gpu::set_object_name(device.device, VK_OBJECT_TYPE_PIPELINE, made.pipeline, name);
    return made;
}

std::string make_pipeline_key(std::string_view name, const std::vector<SpecialisationConstant>& constants,
                              SubgroupRequirement subgroups) {
    std::string key = fmt::format("{} {}", name, subgroups == SubgroupRequirement::full);
    for (const SpecialisationConstant& c : constants)
        key += fmt::format(" {}={}", static_cast<std::uint32_t>(c.id), c.value);
    return key;
}

/// Limits the number of pipelines that are compiled at the same time. Each object of this
/// class occupies one slot. The constructor waits until a slot is free.
class CompilerSlot {
public:
    explicit CompilerSlot(std::counting_semaphore<>& compilers) : compilers_(compilers) {
        compilers_.acquire();
    }
    ~CompilerSlot() { compilers_.release(); }

private:
    std::counting_semaphore<>& compilers_;
};

std::string format_constants(std::span<const std::uint32_t> words,
                             std::vector<SpecialisationConstant> constants) {
    std::sort(constants.begin(), constants.end(),
              [](const SpecialisationConstant& first, const SpecialisationConstant& second) {
                  return first.id < second.id;
              });
    const std::set<std::uint32_t> of_module = gpu::list_specialisation_constant_ids(words);
    std::string text;
    for (const SpecialisationConstant& c : constants) {
        if (c.id == SpecialisationConstantId::WORKGROUP_SIZE ||
            !of_module.contains(static_cast<std::uint32_t>(c.id)))
            continue;
        text += fmt::format("{}{}={}", text.empty() ? "" : " ", get_name(c.id), c.value);
    }
    return text;
}

/// Returns the pipeline of a kernel. Creates it if no kernel with the same name and
/// constants exists.
/// @param launch_mode create the pipeline at its first use (deferred), or immediately in
/// another thread (async)
std::shared_future<gpu::ComputePipelines::CompiledPipeline> find_or_start_pipeline_build(
    Device::Impl& device, const KernelBase::Impl& kernel, std::launch launch_mode) {
    const std::scoped_lock lock(device.pipelines.mutex);
    std::shared_future<gpu::ComputePipelines::CompiledPipeline>& made =
        device.pipelines.by_key[make_pipeline_key(kernel.module, kernel.constants, kernel.subgroups)];
    if (!made.valid())
        made = std::async(launch_mode, [&device, module = kernel.module, stem = kernel.name,
                                        constants = kernel.constants, subgroups = kernel.subgroups] {
            const CompilerSlot compiler_slot(device.pipelines.compilers);
            const std::string constants_shown = format_constants(find_embedded_spirv(module), constants);
            return make_pipeline(device, load_spirv_words(device, module, stem, constants),
                                 constants_shown.empty() ? module : module + " " + constants_shown, constants,
                                 subgroups);
        });
    return made;
}

}  // namespace

const char* get_name(SpecialisationConstantId id) {
    switch (id) {
#define RELIDAR_CONSTANT_ID(name, number) \
    case SpecialisationConstantId::name:  \
        return #name;
        RELIDAR_CONSTANTS(RELIDAR_CONSTANT_ID)
#undef RELIDAR_CONSTANT_ID
    }
    return "";
}

KernelBase::KernelBase(Device& owner, std::string_view name,
                       const std::vector<SpecialisationConstant>& constants, SubgroupRequirement subgroups)
    : impl_(std::make_unique<Impl>()) {
    Device::Impl& device = owner.impl();
    impl_->device = &device;
    impl_->module = std::string(name);
    impl_->name = std::string(name.substr(0, name.find('@')));
    impl_->constants = constants;
    impl_->subgroups = subgroups;
    std::vector<SpecialisationConstant>& all = impl_->constants;
    const auto size = std::find_if(all.begin(), all.end(), [](const SpecialisationConstant& c) {
        return c.id == SpecialisationConstantId::WORKGROUP_SIZE;
    });
    impl_->workgroup_size = size == all.end() ? device.workgroup_size : size->value;
    if (size == all.end()) all.push_back({SpecialisationConstantId::WORKGROUP_SIZE, device.workgroup_size});
    impl_->addresses = gpu::list_parameter_address_offsets(find_embedded_spirv(name));
    if (gpu::can_split_launch(impl_->name)) impl_->speed = &device.launch_limit.get_kernel_speed(impl_->name);
    impl_->made_ = find_or_start_pipeline_build(
        device, *impl_, device.compiles_ahead ? std::launch::async : std::launch::deferred);
    if (device.compile_only) compile_without_running();
}

VkPipeline KernelBase::Impl::get_compiled_pipeline() {
    if (pipeline_) return pipeline_;
    const gpu::ComputePipelines::CompiledPipeline made = made_.get();
    if (made.result != VK_SUCCESS)
        gpu::throw_vulkan_error(
            made.result,
            fmt::format("cannot create kernel {} on {}: the driver returned {}, expected VK_SUCCESS", module,
                        device->info.name, gpu::get_result_name(made.result)));
    return pipeline_ = made.pipeline;
}

void KernelBase::compile_without_running() {
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
    const gpu::ComputePipelines::CompiledPipeline made = impl_->made_.get();
    if (made.result != VK_SUCCESS) s.failure = gpu::get_result_name(made.result);
    else if (device.pipeline_statistics) gpu::read_pipeline_statistics(device.device, made.pipeline, s);
    device.compiled.push_back(s);
}

KernelBase::~KernelBase() = default;

bool has_maximal_reconvergence(const Device& device) {
    const gpu::OptionalFeatures& optional = device.impl().optional;
    return optional.maximal_reconvergence || optional.subgroup_uniform_control_flow;
}

std::string list_features_missing_for_networks(const Device& device) {
    VkPhysicalDeviceSubgroupSizeControlProperties sizes{
        VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_SIZE_CONTROL_PROPERTIES};
    VkPhysicalDeviceSubgroupProperties subgroup{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_SUBGROUP_PROPERTIES,
                                                &sizes};
    VkPhysicalDeviceProperties2 properties{VK_STRUCTURE_TYPE_PHYSICAL_DEVICE_PROPERTIES_2, &subgroup};
    vkGetPhysicalDeviceProperties2(device.impl().physical, &properties);
    return gpu::list_features_missing_for_networks(subgroup, sizes, device.impl().optional);
}

KernelVariant choose_float_atomics_variant(const Device& device, const KernelVariant& base_variant) {
    if (device.impl().wrong_sums)
        throw DeviceError(
            fmt::format("cannot add gradients on {}: the device computes wrong sums of floating-point "
                        "numbers; `relidar check` shows details",
                        device.info().name));
    return KernelVariant(base_variant.suffix + (device.info().float_atomics ? "_atomics" : "_swap"));
}

}  // namespace relidar
