// SPDX-License-Identifier: Apache-2.0
// Reads SPIR-V modules and edits them when they are loaded. Execution modes are added
// here because they depend on the device, and because glslang may not know the GLSL
// extensions for them. Parameters are marked read-only here because the GLSL qualifier
// would affect too many variables (relidar/base/kernel.glsl).
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace relidar::gpu {

using SpirvWords = std::vector<std::uint32_t>;
/// Values of specialisation constants by id.
using SpirvConstants = std::map<std::uint32_t, std::uint32_t>;

struct ExecutionMode {
    std::uint32_t mode;
    std::string_view extension;
};

/// If all lanes entered the branch together.
inline constexpr ExecutionMode kSubgroupUniformControlFlow{4421, "SPV_KHR_subgroup_uniform_control_flow"};
/// Guarantees that lanes reconverge after every branch and loop.
inline constexpr ExecutionMode kMaximallyReconverges{6023, "SPV_KHR_maximal_reconvergence"};

SpirvWords add_execution_mode(std::span<const std::uint32_t> words, const ExecutionMode& mode);

SpirvWords mark_params_readonly(std::span<const std::uint32_t> words);

/// Loads all parameters once, at the start of the kernel. Only for lavapipe, which would
/// repeat the loads for each lane in loops and branches.
SpirvWords hoist_loads(std::span<const std::uint32_t> words);

/// Makes array indices non-uniform for the compiler. lavapipe after 25.0 executes a load
/// with a uniform index even in a branch that no lane takes, and may crash. Call this
/// before hoist_loads(), which moves the loads of parameters.
SpirvWords make_nonuniform(std::span<const std::uint32_t> words);

/// Unreachable blocks stay in the module. lavapipe would remove the branches only after
/// inlining all functions, which is slow.
/// @param constants other constants keep their default value
SpirvWords remove_branches(std::span<const std::uint32_t> words, const SpirvConstants& constants);

SpirvWords list_pointers(std::span<const std::uint32_t> words);

/// Returns the size of the parameter struct, or 0 if the module has none or if C++ cannot
/// share its type.
std::uint32_t find_params_size(std::span<const std::uint32_t> words);

/// Checks that a module of a program has the interface of a kernel.
/// @throws errors of Kernel::from_spirv()
void check_module(std::span<const std::uint32_t> words, const std::string& kernel_name,
                  std::size_t params_bytes);

std::set<std::uint32_t> list_constants(std::span<const std::uint32_t> words);

}  // namespace relidar::gpu
