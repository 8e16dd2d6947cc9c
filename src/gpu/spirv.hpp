// SPDX-License-Identifier: Apache-2.0
// Reads SPIR-V modules and edits them when they are loaded. Execution modes are added
// here, because only then is it known which modes the device supports, and glslang may
// not know their GLSL extensions. Parameters are marked read-only here, because the GLSL
// qualifier applies to too much (shaders/base/kernel.glsl).
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <string_view>
#include <vector>

namespace relidar::gpu {

/// SPIR-V execution mode without operands, and the extension that defines this mode.
struct ExecutionMode {
    std::uint32_t mode;
    std::string_view extension;
};

/// Guarantees that lanes reconverge after a branch, if the full subgroup entered the
/// branch.
inline constexpr ExecutionMode kSubgroupUniformControlFlow{4421, "SPV_KHR_subgroup_uniform_control_flow"};
/// Guarantees that any set of lanes that diverges also reconverges, including in loops.
inline constexpr ExecutionMode kMaximallyReconverges{6023, "SPV_KHR_maximal_reconvergence"};

/// Adds an execution mode to each entry point of a module. Returns the edited module.
/// @param words module with at least one entry point
std::vector<std::uint32_t> with_execution_mode(std::span<const std::uint32_t> words,
                                               const ExecutionMode& mode);

/// Decorates the parameter block of a module (RELIDAR_PARAMS) as NonWritable. Returns the
/// edited module.
std::vector<std::uint32_t> make_parameters_read_only(std::span<const std::uint32_t> words);

/// Copies the parameters of a kernel to private variables at its start. Returns the
/// edited module. Used for Mesa's lavapipe, which otherwise performs a uniform load lane
/// by lane behind a branch or in a loop. A GPU chooses better when to read parameters.
std::vector<std::uint32_t> move_parameters_first(std::span<const std::uint32_t> words);

/// Returns the module with array indices that the compiler cannot prove uniform. For
/// Mesa's lavapipe after 25.0, which executes a uniform load even in a branch that no
/// lane takes. The index is then arbitrary, and the load may crash. A load with an
/// address per lane is executed only for active lanes. Use it before
/// move_parameters_first(), which moves parameters.
std::vector<std::uint32_t> with_indices_by_lane(std::span<const std::uint32_t> words);

/// Replaces each branch that the specialisation constants decide by an unconditional
/// branch. Returns the edited module. Unreachable blocks stay in the module. A driver
/// also removes them, but only after it has inlined all functions, so lavapipe compiles
/// large kernels faster with this edit.
/// @param constants values by id. Other constants keep the default of the module.
std::vector<std::uint32_t> resolve_branches(std::span<const std::uint32_t> words,
                                            const std::map<std::uint32_t, std::uint32_t>& constants);

/// Returns the byte offsets of all device addresses in the module's parameter block.
std::vector<std::uint32_t> parameter_addresses(std::span<const std::uint32_t> words);

/// Returns the ids of the module's specialisation constants.
std::set<std::uint32_t> constant_ids(std::span<const std::uint32_t> words);

}  // namespace relidar::gpu
