// SPDX-License-Identifier: Apache-2.0
// Reads SPIR-V modules and edits them when they are loaded. Execution modes are added
// here because they depend on the device, and because glslang may not know the GLSL
// extensions for them. Parameters are marked read-only here because the GLSL qualifier
// would affect too many variables (shaders/base/kernel.glsl).
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <string_view>
#include <vector>

namespace relidar::gpu {

/// SPIR-V execution mode without operands, and the SPIR-V extension that defines it.
struct ExecutionMode {
    std::uint32_t mode;
    std::string_view extension;
};

/// Guarantees that the lanes of a subgroup reconverge after a branch, if all of them
/// entered it together.
inline constexpr ExecutionMode kSubgroupUniformControlFlow{4421, "SPV_KHR_subgroup_uniform_control_flow"};
/// Guarantees that lanes reconverge after every branch and loop.
inline constexpr ExecutionMode kMaximallyReconverges{6023, "SPV_KHR_maximal_reconvergence"};

/// Adds the mode to each entry point.
std::vector<std::uint32_t> add_execution_mode_to_spirv(std::span<const std::uint32_t> spirv_words,
                                                       const ExecutionMode& execution_mode);

std::vector<std::uint32_t> mark_parameter_block_read_only(std::span<const std::uint32_t> spirv_words);

/// Returns a copy of a SPIR-V module that loads all parameters once, at the start of the
/// kernel. Used only for the CPU driver lavapipe. It would otherwise repeat the loads for
/// each lane in loops and branches. Compilers of GPUs choose a better time for each load.
std::vector<std::uint32_t> hoist_parameter_loads(std::span<const std::uint32_t> spirv_words);

/// Returns a copy of a module in which the compiler cannot prove that array indices are
/// uniform, that is, equal in all lanes. Used for versions of lavapipe after 25.0. They
/// execute a load with a uniform index even in a branch that no lane takes. The index can
/// then have any value, so the load may crash. A load with a non-uniform index runs only
/// for active lanes.
///
/// Call this function before hoist_parameter_loads(), which moves the loads of
/// parameters.
std::vector<std::uint32_t> make_array_indices_nonuniform(std::span<const std::uint32_t> spirv_words);

/// Returns a copy of a SPIR-V module without branches that depend only on specialisation
/// constants. Unreachable blocks stay in the module. lavapipe then compiles large kernels
/// faster. It would remove these branches too, but only after inlining all functions.
/// @param constant_value_by_id values by id. Other constants keep their default value
std::vector<std::uint32_t> remove_constant_branches(
    std::span<const std::uint32_t> spirv_words,
    const std::map<std::uint32_t, std::uint32_t>& constant_value_by_id);

std::vector<std::uint32_t> list_pointer_offsets_in_parameter_block(
    std::span<const std::uint32_t> spirv_words);

std::set<std::uint32_t> list_specialisation_constant_ids(std::span<const std::uint32_t> spirv_words);

}  // namespace relidar::gpu
