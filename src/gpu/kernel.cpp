// SPDX-License-Identifier: Apache-2.0
// Pipelines from embedded SPIR-V with specialisation constants.
#include "gpu/kernel.hpp"

#include <algorithm>

#include <fmt/format.h>

#include <relidar/error.hpp>

#include "gpu/stream.hpp"

namespace relidar {

namespace {

std::span<const std::uint32_t> find_words(std::string_view name) {
    for (const EmbeddedKernel& kernel : embedded_kernels())
        if (kernel.name == name) return kernel.words;
    throw Error(ExitCode::bug, fmt::format("making kernel {}: it is not embedded in this build, expected a line in src/CMakeLists.txt", name));
}

}  // namespace

KernelBase::KernelBase(Device& owner, std::string_view name, const std::vector<Constant>& constants) : impl_(std::make_unique<Impl>()) {
    Device::Impl& device = owner.impl();
    impl_->device = &device;
    impl_->name = std::string(name.substr(0, name.find('@')));
    const std::span<const std::uint32_t> words = find_words(name);
    VkShaderModuleCreateInfo module_info{VK_STRUCTURE_TYPE_SHADER_MODULE_CREATE_INFO};
    module_info.codeSize = words.size_bytes();
    module_info.pCode = words.data();
    VkShaderModule module = VK_NULL_HANDLE;
    gpu::check(vkCreateShaderModule(device.device, &module_info, nullptr, &module), "vkCreateShaderModule");

    std::vector<Constant> all(constants);
    const auto size = std::find_if(all.begin(), all.end(), [](const Constant& c) { return c.id == 0u; });
    impl_->workgroup_size = size == all.end() ? device.workgroup_size : size->value;
    if (size == all.end()) all.push_back({0u, device.workgroup_size});
    std::vector<VkSpecializationMapEntry> map;
    for (std::size_t i = 0; i < all.size(); ++i)
        map.push_back({all[i].id, static_cast<std::uint32_t>(i * sizeof(Constant) + offsetof(Constant, value)), sizeof(std::uint32_t)});
    const VkSpecializationInfo specialisation{static_cast<std::uint32_t>(map.size()), map.data(), all.size() * sizeof(Constant), all.data()};
    VkComputePipelineCreateInfo info{VK_STRUCTURE_TYPE_COMPUTE_PIPELINE_CREATE_INFO};
    info.stage.sType = VK_STRUCTURE_TYPE_PIPELINE_SHADER_STAGE_CREATE_INFO;
    info.stage.stage = VK_SHADER_STAGE_COMPUTE_BIT;
    info.stage.module = module;
    info.stage.pName = "main";
    info.stage.pSpecializationInfo = &specialisation;
    info.layout = device.pipeline_layout;
    const VkResult result = vkCreateComputePipelines(device.device, VK_NULL_HANDLE, 1, &info, nullptr, &impl_->pipeline);
    vkDestroyShaderModule(device.device, module, nullptr);
    if (result != VK_SUCCESS)
        throw DeviceError(fmt::format("making kernel {} on {}: the driver answered {}, expected VK_SUCCESS", name, device.info.name, gpu::result_name(result)));
}

KernelBase::Impl::~Impl() {
    if (pipeline) vkDestroyPipeline(device->device, pipeline, nullptr);
}

KernelBase::~KernelBase() = default;

bool coalesces(const Device& device) { return device.info().type != "CPU"; }

std::string accumulating_variant(const Device& device, std::string_view name) {
    return std::string(name) + (device.info().float_atomics ? "_atomics" : "_swap");
}

}  // namespace relidar
