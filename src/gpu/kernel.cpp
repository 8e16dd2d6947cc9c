// SPDX-License-Identifier: Apache-2.0
#include "gpu/kernel.hpp"

#include <algorithm>
#include <cstdio>
#include <cstring>

#include <fmt/format.h>

#include "base/fail.hpp"
#include "base/files.hpp"
#include "gpu/pipeline_cache.hpp"
#include "gpu/spirv.hpp"
#include "gpu/stream.hpp"

namespace relidar {

namespace {

std::span<const std::uint32_t> embedded_spirv(std::string_view kernel_name) {
    for (const EmbeddedKernel& kernel : embedded_kernels())
        if (kernel.name == kernel_name) return kernel.words;
    throw Error(ExitCode::bug,
                fmt::format("cannot create kernel {}: src/CMakeLists.txt does not list it", kernel_name));
}

/// Kernels with subgroup operations in branches, or in loops that lanes leave early.
constexpr std::array<std::string_view, 3> kReconvergingKernels{"diff/accel/bvh_cluster",
                                                               "diff/backward/trace", "gpu/check_subgroups"};

/// Returns true for lavapipe up to Mesa 25.0. Later versions execute a load in an untaken
/// branch, which may crash.
bool skips_dead_loads(const std::string& driver_name) {
    int major = 0, minor = 0;
    const std::size_t version = driver_name.find("Mesa ");
    if (version == std::string::npos ||
        std::sscanf(driver_name.c_str() + version, "Mesa %d.%d", &major, &minor) != 2)
        return false;
    return major < 25 || (major == 25 && minor == 0);
}

/// Returns the SPIR-V code of a kernel after the edits that this device needs. Then the
/// driver compiles less code, can load parameters early, and does not crash.
/// @param base name of the kernel without its variant
std::vector<std::uint32_t> kernel_spirv(const Device::Impl& device, std::span<const std::uint32_t> module,
                                        std::string_view base, const KernelConstants& constants) {
    std::map<std::uint32_t, std::uint32_t> values;
    for (const SpecialisationConstant& constant : constants)
        values[static_cast<std::uint32_t>(constant.id)] = constant.value;
    std::vector<std::uint32_t> words = gpu::mark_params_readonly(gpu::remove_branches(module, values));
    // These edits help only the CPU driver lavapipe. make_nonuniform() comes first,
    // because hoist_loads() moves the loads that it must recognise.
    if (device.info.driver.starts_with("llvmpipe")) {
        if (!skips_dead_loads(device.info.driver)) words = gpu::make_nonuniform(words);
        words = gpu::hoist_loads(words);
    }
    // Lanes of these kernels must run together again after a branch. The stronger
    // guarantee is used if the device has it.
    if (std::ranges::find(kReconvergingKernels, base) != kReconvergingKernels.end()) {
        if (device.optional.maximal_reconvergence)
            return gpu::add_execution_mode(words, gpu::kMaximallyReconverges);
        if (device.optional.subgroup_uniform_control_flow)
            return gpu::add_execution_mode(words, gpu::kSubgroupUniformControlFlow);
    }
    return words;
}

VkShaderModule create_module(const Device::Impl& device, std::span<const std::uint32_t> words,
                             const std::string& name) {
    VkShaderModuleCreateInfo info{VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO};
    info.codeSize = words.size_bytes();
    info.pCode = words.data();
    VkShaderModule module = VK_NULL_HANDLE;
    gpu::vk_check(vkCreateShaderModule(device.device, &info, nullptr, &module), "vkCreateShaderModule");
    gpu::set_object_name(device.device, VK_OBJECT_TYPE_SHADER_MODULE, module, name);
    return module;
}

/// Returns the id and the position of each value in an array of constants.
std::vector<VkSpecializationMapEntry> map_constants(const KernelConstants& constants) {
    std::vector<VkSpecializationMapEntry> map;
    for (std::size_t i = 0; i < constants.size(); ++i)
        map.push_back({.constantID = static_cast<std::uint32_t>(constants[i].id),
                       .offset = static_cast<std::uint32_t>(i * sizeof(SpecialisationConstant) +
                                                            offsetof(SpecialisationConstant, value)),
                       .size = sizeof(std::uint32_t)});
    return map;
}

/// Compiles a kernel with its specialisation constants into a Vulkan pipeline. Returns
/// the result code instead of throwing, because this may run in another thread.
/// @param name name of the kernel with its constants, which debuggers show
gpu::CompiledPipeline create_pipeline(Device::Impl& device, std::span<const std::uint32_t> words,
                                      const std::string& name, const KernelConstants& constants,
                                      SubgroupRequirement subgroups) {
    const std::vector<VkSpecializationMapEntry> map = map_constants(constants);
    const VkSpecializationInfo specialisation{static_cast<std::uint32_t>(map.size()), map.data(),
                                              constants.size() * sizeof(SpecialisationConstant),
                                              constants.data()};
    VkComputePipelineCreateInfo info{VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
    // Lets a dispatch begin at any workgroup, because large launches are split.
    info.flags = VK_PIPELINE_CREATE_DISPATCH_BASE_BIT;
    if (device.pipeline_statistics) info.flags |= VK_PIPELINE_CREATE_CAPTURE_STATISTICS_BIT_KHR;
    info.layout = device.pipeline_layout;
    info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
    info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
    info.stage.module = create_module(device, words, name);
    info.stage.pName = "main";
    info.stage.pSpecializationInfo = &specialisation;
    const bool needs_full = subgroups == SubgroupRequirement::full;
    VkPipelineShaderStageRequiredSubgroupSizeCreateInfo lanes{
        VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_REQUIRED_SUBGROUP_SIZE_CREATE_INFO};
    lanes.requiredSubgroupSize = static_cast<std::uint32_t>(device.info.subgroup_size);
    if ((needs_full || device.forced_lanes) && device.optional.subgroup_size) info.stage.pNext = &lanes;
    if (needs_full && device.optional.full_subgroups)
        info.stage.flags = VK_PIPELINE_SHADER_STAGE_CREATE_REQUIRE_FULL_SUBGROUPS_BIT;
    const VkPipelineCache cache = device.pipeline_cache ? device.pipeline_cache->handle() : VK_NULL_HANDLE;
    gpu::CompiledPipeline made{VK_SUCCESS, VK_NULL_HANDLE};
    made.result = vkCreateComputePipelines(device.device, cache, 1, &info, nullptr, &made.pipeline);
    vkDestroyShaderModule(device.device, info.stage.module, nullptr);
    if (made.result == VK_SUCCESS)
        gpu::set_object_name(device.device, VK_OBJECT_TYPE_PIPELINE, made.pipeline, name);
    return made;
}

class CompilerSlot {
public:
    explicit CompilerSlot(std::counting_semaphore<>& free_compiler_slots) : compilers_(free_compiler_slots) {
        compilers_.acquire();
    }
    ~CompilerSlot() { compilers_.release(); }

private:
    std::counting_semaphore<>& compilers_;
};

/// Returns the constants that the module uses as "NAME=value ...", sorted by their ids.
/// The workgroup size is left out, because every kernel has one.
std::string format_constants(std::span<const std::uint32_t> words, KernelConstants constants) {
    std::ranges::sort(constants, {}, &SpecialisationConstant::id);
    const std::set<std::uint32_t> module_constants = gpu::list_constants(words);
    std::string text;
    for (const SpecialisationConstant& constant : constants) {
        const bool is_used = module_constants.contains(static_cast<std::uint32_t>(constant.id));
        if (!is_used || constant.id == SpecialisationConstantId::WORKGROUP_SIZE) continue;
        text += fmt::format("{}{}={}", text.empty() ? "" : " ", constant_name(constant.id), constant.value);
    }
    return text;
}

/// Returns the pipeline of a kernel. Creates it if no kernel with the same name and
/// constants exists.
/// @param mode create at the first use (deferred), or now in another thread (async)
std::shared_future<gpu::CompiledPipeline> find_pipeline(Device::Impl& device, const KernelBase::Impl& kernel,
                                                        std::launch mode) {
    const std::scoped_lock lock(device.pipelines.mutex);
    std::string key = fmt::format("{} {}", kernel.module, kernel.subgroups == SubgroupRequirement::full);
    for (const SpecialisationConstant& constant : kernel.constants)
        key += fmt::format(" {}={}", static_cast<std::uint32_t>(constant.id), constant.value);
    // Modules of programs can have equal names, so the key contains the code.
    if (kernel.loaded_words)
        key.append(reinterpret_cast<const char*>(kernel.words.data()), kernel.words.size_bytes());
    std::shared_future<gpu::CompiledPipeline>& pipeline = device.pipelines.by_key[key];
    if (pipeline.valid()) return pipeline;
    // Copies what it needs, because the kernel may be destroyed before the compilation.
    // The copy of `loaded_words` keeps the memory of `words` alive.
    pipeline = std::async(mode, [&device, module = kernel.module, base = kernel.name, words = kernel.words,
                                 loaded_words = kernel.loaded_words, constants = kernel.constants,
                                 subgroups = kernel.subgroups] {
        const CompilerSlot compiler_slot(device.pipelines.compilers);  // waits for a free slot
        const std::string text = format_constants(words, constants);
        const std::string name = text.empty() ? module : module + " " + text;
        return create_pipeline(device, kernel_spirv(device, words, base, constants), name, constants,
                               subgroups);
    });
    return pipeline;
}

}  // namespace

const char* constant_name(SpecialisationConstantId constant_id) {
    switch (constant_id) {
#define RELIDAR_CONSTANT_ID(name, number) \
    case SpecialisationConstantId::name: return #name;
        RELIDAR_CONSTANTS(RELIDAR_CONSTANT_ID)
#undef RELIDAR_CONSTANT_ID
    }
    return "";
}

KernelBase::KernelBase(Device& owner, std::string_view kernel_name, const KernelConstants& constants,
                       SubgroupRequirement subgroups)
    : impl_(std::make_unique<Impl>()) {
    impl_->module = std::string(kernel_name);
    // A module is NAME or NAME@VARIANT. All variants share the name of the kernel.
    impl_->name = std::string(kernel_name.substr(0, kernel_name.find('@')));
    impl_->words = embedded_spirv(kernel_name);
    impl_->subgroups = subgroups;
    // From its measured speed, slow launches of the kernel are split into pieces.
    if (gpu::can_split(impl_->name)) impl_->speed = &owner.impl().launch_limit.speed_of(impl_->name);
    start_compilation(owner, constants);
}

KernelBase::KernelBase(Device& owner, std::span<const std::uint32_t> spirv_words,
                       const std::string& kernel_name, std::size_t params_bytes)
    : impl_(std::make_unique<Impl>()) {
    gpu::check_module(spirv_words, kernel_name, params_bytes);
    impl_->module = impl_->name = kernel_name;
    // A copy, because the caller may free the words before the kernel is compiled.
    impl_->loaded_words =
        std::make_shared<const std::vector<std::uint32_t>>(spirv_words.begin(), spirv_words.end());
    impl_->words = *impl_->loaded_words;
    // Without a measured `speed`, launches are never split. So thread_count() in the
    // kernel counts all threads.
    start_compilation(owner, KernelConstants{});
}

/// Sets the members that both constructors share, and finds or creates the pipeline. On a
/// GPU, another thread compiles it now (async), otherwise the first launch (deferred).
void KernelBase::start_compilation(Device& owner, const KernelConstants& constants) {
    Device::Impl& device = owner.impl();
    impl_->device = &device;
    impl_->constants = constants;
    constexpr auto kSizeId = SpecialisationConstantId::WORKGROUP_SIZE;
    const auto size = std::ranges::find(constants, kSizeId, &SpecialisationConstant::id);
    impl_->workgroup_size = size == constants.end() ? device.workgroup_size : size->value;
    if (size == constants.end()) impl_->constants.push_back({kSizeId, device.workgroup_size});
    // Byte offsets of the addresses in the parameters. A launch replaces null addresses.
    impl_->addresses = gpu::list_pointers(impl_->words);
    const std::launch mode = device.compiles_ahead ? std::launch::async : std::launch::deferred;
    impl_->made_ = find_pipeline(device, *impl_, mode);
    if (device.compile_only) compile_pipeline();  // there is no launch that would compile it
}

VkPipeline KernelBase::Impl::wait_for_pipeline() {
    if (pipeline_) return pipeline_;
    const gpu::CompiledPipeline made = made_.get();
    if (made.result != VK_SUCCESS)
        gpu::vk_fail(made.result,
                     fmt::format("cannot create kernel {} on {}: the driver returned {}, expected VK_SUCCESS",
                                 module, device->info.name, gpu::vk_result_name(made.result)));
    return pipeline_ = made.pipeline;
}

namespace {

double to_double(const VkPipelineExecutableStatisticKHR& statistic) {
    if (statistic.format == VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_BOOL32_KHR)
        return statistic.value.b32 ? 1.0 : 0.0;
    if (statistic.format == VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_INT64_KHR)
        return double(statistic.value.i64);
    if (statistic.format == VK_PIPELINE_EXECUTABLE_STATISTIC_FORMAT_UINT64_KHR)
        return double(statistic.value.u64);
    return statistic.value.f64;
}

/// Reads the statistics of the driver's compiler, under the names of the driver
/// (VK_KHR_pipeline_executable_properties).
void query_statistics(VkDevice device, VkPipeline pipeline, PipelineStatistics& statistics) {
    VkPipelineInfoKHR info{VK_STRUCTURE_TYPE_PIPELINE_INFO_KHR};
    info.pipeline = pipeline;
    const auto executables = gpu::enumerate<VkPipelineExecutablePropertiesKHR>(
        "vkGetPipelineExecutablePropertiesKHR",
        [&](std::uint32_t* n, auto* values) {
            return vkGetPipelineExecutablePropertiesKHR(device, &info, n, values);
        },
        {VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_PROPERTIES_KHR});
    if (executables.empty()) return;
    // Intel compiles one executable per subgroup size. The last has the largest one.
    statistics.subgroup_size = static_cast<int>(executables.back().subgroupSize);
    VkPipelineExecutableInfoKHR program{VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_INFO_KHR};
    program.pipeline = pipeline;
    program.executableIndex = static_cast<std::uint32_t>(executables.size() - 1);
    const auto values = gpu::enumerate<VkPipelineExecutableStatisticKHR>(
        "vkGetPipelineExecutableStatisticsKHR",
        [&](std::uint32_t* n, auto* of_program) {
            return vkGetPipelineExecutableStatisticsKHR(device, &program, n, of_program);
        },
        {VK_STRUCTURE_TYPE_PIPELINE_EXECUTABLE_STATISTIC_KHR});
    for (const VkPipelineExecutableStatisticKHR& value : values)
        statistics.values[value.name] = to_double(value);
}

}  // namespace

/// Compiles the pipeline without running it, and stores the statistics of the driver's
/// compiler. Skips a kernel whose constants and workgroup size were already compiled.
void KernelBase::compile_pipeline() {
    Device::Impl& device = *impl_->device;
    PipelineStatistics statistics;
    statistics.kernel = impl_->module;
    statistics.constants = format_constants(impl_->words, impl_->constants);
    statistics.workgroup_size = static_cast<int>(impl_->workgroup_size);
    const auto is_same = [&](const PipelineStatistics& known) {
        return known.kernel == statistics.kernel && known.constants == statistics.constants &&
               known.workgroup_size == statistics.workgroup_size;
    };
    if (std::ranges::any_of(device.compiled, is_same)) return;
    const gpu::CompiledPipeline made = impl_->made_.get();
    if (made.result != VK_SUCCESS) statistics.failure = gpu::vk_result_name(made.result);
    else if (device.pipeline_statistics) query_statistics(device.device, made.pipeline, statistics);
    device.compiled.push_back(statistics);
}

KernelBase::~KernelBase() = default;

std::vector<std::uint32_t> read_spirv(const std::filesystem::path& file) {
    const std::string bytes = read_file(file);
    if (bytes.size() % sizeof(std::uint32_t) != 0)
        fail("cannot read the kernel {}: found {} bytes, expected a multiple of 4 (SPIR-V)", file.string(),
             bytes.size());
    std::vector<std::uint32_t> words(bytes.size() / sizeof(std::uint32_t));
    std::memcpy(words.data(), bytes.data(), bytes.size());
    return words;
}

bool lanes_reconverge(const Device& device) {
    const gpu::OptionalFeatures& optional = device.impl().optional;
    return optional.maximal_reconvergence || optional.subgroup_uniform_control_flow;
}

std::string missing_for_networks(const Device& device) {
    const gpu::DeviceProperties properties(device.impl().physical);
    return gpu::missing_for_networks(properties.subgroups, properties.subgroup_sizes, device.impl().optional);
}

KernelVariant atomic_variant(const Device& device, const KernelVariant& base_variant) {
    if (device.impl().wrong_sums)
        fail<DeviceError>("cannot add gradients on {}: it computes wrong sums of floats (`relidar check`)",
                          device.info().name);
    return KernelVariant(base_variant.suffix + (device.info().float_atomics ? "_atomics" : "_swap"));
}

std::size_t validation_count(const Device& device) {
    return device.impl().instance ? device.impl().instance->n_messages.load() : 0;
}

ForcedBehaviourScope::ForcedBehaviourScope(Device& device, const ForcedBehaviour& forced)
    : device_(device), before_(std::exchange(device.impl().forced, forced)) {}
ForcedBehaviourScope::~ForcedBehaviourScope() { device_.impl().forced = before_; }

bool should_coalesce(const Device& device) {
    return device.impl().forced.coalesces.value_or(device.info().type != "CPU");
}
bool is_brute_force(const Device& device) { return device.impl().forced.brute_force; }

}  // namespace relidar
