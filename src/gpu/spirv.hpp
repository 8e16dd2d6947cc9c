// SPDX-License-Identifier: Apache-2.0
// Reads SPIR-V modules and edits them when they are loaded. Execution modes are added
// here because they depend on the device, and because glslang may not know their GLSL
// extensions. Parameters are marked read-only here because the GLSL qualifier affects too
// many variables (shaders/base/kernel.glsl).
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <string_view>
#include <vector>

namespace relidar::gpu {

/// SPIR-V execution mode without operands, and the extension that defines the mode.
struct ExecutionMode {
    std::uint32_t mode;
    std::string_view extension;
};

/// Guarantees that lanes reconverge after a branch if all lanes of the subgroup entered
/// the branch together.
inline constexpr ExecutionMode kSubgroupUniformControlFlow{4421, "SPV_KHR_subgroup_uniform_control_flow"};
/// Guarantees that all lanes that diverged reconverge, even in loops.
inline constexpr ExecutionMode kMaximallyReconverges{6023, "SPV_KHR_maximal_reconvergence"};

/// Returns a copy of a module in which each entry point has an additional execution mode.
/// @param words module with at least one entry point
std::vector<std::uint32_t> add_execution_mode(std::span<const std::uint32_t> words,
                                              const ExecutionMode& mode);

/// Returns a copy of a module whose parameter block (RELIDAR_PARAMS) is decorated as
/// NonWritable.
std::vector<std::uint32_t> make_parameters_read_only(std::span<const std::uint32_t> words);

/// Returns a copy of a module that loads all parameters into private variables at the
/// start of the kernel. Used only for the CPU driver lavapipe, which repeats a load for
/// each lane if the load is in a loop or branch. A GPU's compiler chooses a better time
/// for each load.
std::vector<std::uint32_t> move_parameters_first(std::span<const std::uint32_t> words);

/// Returns a copy of a module in which the compiler cannot prove that array indices are
/// uniform. Used for lavapipe after 25.0, which executes uniform loads even in a branch
/// that no lane takes. The index is then arbitrary, so the load may crash. Non-uniform
/// loads run only for active lanes.
///
/// Call this function before move_parameters_first(), which moves the loads of
/// parameters.
std::vector<std::uint32_t> use_lane_indices(std::span<const std::uint32_t> words);

/// Returns a copy of a module in which branches that depend only on specialisation
/// constants are unconditional. Unreachable blocks stay in the module. A driver also
/// removes such branches, but only after it has inlined all functions. Therefore lavapipe
/// compiles large kernels faster with this edit.
/// @param constants values by id. Other constants keep the default value of the module
std::vector<std::uint32_t> resolve_branches(std::span<const std::uint32_t> words,
                                            const std::map<std::uint32_t, std::uint32_t>& constants);

/// Returns the byte offset of each device address in the parameter block of a module.
std::vector<std::uint32_t> list_parameter_addresses(std::span<const std::uint32_t> words);

/// Returns the ids of the module's specialisation constants.
std::set<std::uint32_t> list_constant_ids(std::span<const std::uint32_t> words);

}  // namespace relidar::gpu
