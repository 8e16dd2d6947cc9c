// SPDX-License-Identifier: Apache-2.0
// Reads and changes SPIR-V modules when they are loaded. Adds execution modes, because
// only the device decides which ones are available and glslang may not support their GLSL
// extensions. Marks the parameters as read-only, because the GLSL qualifier would affect
// too much (shaders/base/kernel.glsl).
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <string_view>
#include <vector>

namespace relidar::gpu {

/// An execution mode without operands, and the extension that defines it.
struct ExecutionMode {
    std::uint32_t mode;
    std::string_view extension;
};

/// Lanes of a subgroup reconverge after a branch if all lanes of the subgroup entered it.
inline constexpr ExecutionMode kSubgroupUniformControlFlow{4421, "SPV_KHR_subgroup_uniform_control_flow"};
/// Any set of lanes reconverges after a branch or loop.
inline constexpr ExecutionMode kMaximallyReconverges{6023, "SPV_KHR_maximal_reconvergence"};

/// Returns the module with the execution mode on each entry point.
/// @param words  a module with at least one entry point
std::vector<std::uint32_t> with_execution_mode(std::span<const std::uint32_t> words,
                                               const ExecutionMode& mode);

/// Returns the module with its parameter block (RELIDAR_PARAMS) decorated as NonWritable.
std::vector<std::uint32_t> with_read_only_parameters(std::span<const std::uint32_t> words);

/// Returns the module with all parameters copied to private variables at its start. This
/// is for Mesa's lavapipe: inside a branch or loop it loads a uniform address once per
/// lane, which took two fifths of Adam's time. A GPU chooses a better time for these
/// loads.
std::vector<std::uint32_t> with_parameters_first(std::span<const std::uint32_t> words);

/// Returns the module with array indices that the compiler treats as different in each
/// lane. After version 25.0, Mesa's lavapipe executes a load with a uniform address even
/// in a branch that no lane takes. The index may then be invalid and the load may crash.
/// A load with one address per lane only runs for active lanes. Call this function before
/// with_parameters_first(), which moves parameters.
std::vector<std::uint32_t> with_indices_by_lane(std::span<const std::uint32_t> words);

/// Returns the module with constant branches: branches that specialisation constants
/// decide become unconditional. Unreachable blocks stay in the module. Drivers remove
/// them too, but only after inlining; with this change Mesa's lavapipe compiles
/// diff/forward/trace in half the time.
/// @param constants  values by id; the module's defaults are used for the others
std::vector<std::uint32_t> with_branches_taken(std::span<const std::uint32_t> words,
                                               const std::map<std::uint32_t, std::uint32_t>& constants);

/// Returns the byte offsets of all addresses in the module's parameter block.
std::vector<std::uint32_t> parameter_addresses(std::span<const std::uint32_t> words);

/// Returns the ids of the module's specialisation constants.
std::set<std::uint32_t> constant_ids(std::span<const std::uint32_t> words);

}  // namespace relidar::gpu
