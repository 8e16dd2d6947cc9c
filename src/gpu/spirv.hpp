// SPDX-License-Identifier: Apache-2.0
// What is read from a SPIR-V module, and changed in it, when it is loaded. Execution
// modes: whether a device has them is known only then, and glslang may not know their
// GLSL extensions. That parameters are only read: GLSL's word for it reaches too far
// (shaders/base/kernel.glsl).
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <string_view>
#include <vector>

namespace relidar::gpu {

/// A mode without operands and the extension that defines it.
struct ExecutionMode {
    std::uint32_t mode;
    std::string_view extension;
};

/// Lanes that a subgroup took apart at a branch come together behind it, where all of the
/// subgroup went in.
inline constexpr ExecutionMode kSubgroupUniformControlFlow{4421, "SPV_KHR_subgroup_uniform_control_flow"};
/// The same of any set of lanes, in loops too.
inline constexpr ExecutionMode kMaximallyReconverges{6023, "SPV_KHR_maximal_reconvergence"};

/// The module with the mode on each of its entry points. @param words of a module that
/// has at least one
std::vector<std::uint32_t> with_execution_mode(std::span<const std::uint32_t> words,
                                               const ExecutionMode& mode);

/// The module with its block of parameters (RELIDAR_PARAMS) decorated NonWritable.
std::vector<std::uint32_t> with_read_only_parameters(std::span<const std::uint32_t> words);

/// The module with its parameters read into private variables where it begins. For Mesa's
/// lavapipe: behind a branch or in a loop it loads what has one address for all lanes
/// lane by lane, which was two fifths of Adam's time. A GPU chooses better when to read
/// them.
std::vector<std::uint32_t> with_parameters_first(std::span<const std::uint32_t> words);

/// The module with indices into arrays that the compiler takes for different ones in each
/// lane. Mesa's lavapipe after 25.0 executes a load with one address for all lanes even
/// in a branch that no lane takes. There the index is any number, and the load may crash.
/// A load with an address for each lane is executed for active lanes only. Use it before
/// with_parameters_first(), which moves parameters.
std::vector<std::uint32_t> with_indices_by_lane(std::span<const std::uint32_t> words);

/// The module with branches that its specialisation constants decide made unconditional.
/// The blocks that are not reached stay where they are. A driver drops them too, but only
/// after it has put all functions into one: Mesa's lavapipe makes diff/forward/trace in
/// half the time when they are unreachable from the start. @param constants  values by
/// id; those not given are as the module has them
std::vector<std::uint32_t> with_branches_taken(std::span<const std::uint32_t> words,
                                               const std::map<std::uint32_t, std::uint32_t>& constants);

/// Offsets in bytes of all addresses in the module's block of parameters.
std::vector<std::uint32_t> parameter_addresses(std::span<const std::uint32_t> words);

/// Ids of the module's specialisation constants.
std::set<std::uint32_t> constant_ids(std::span<const std::uint32_t> words);

}  // namespace relidar::gpu
