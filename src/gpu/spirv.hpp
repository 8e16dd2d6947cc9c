// SPDX-License-Identifier: Apache-2.0
// Reads SPIR-V modules and edits them when they are loaded. Execution modes are added
// here because they depend on the device, and because glslang may not know the GLSL
// extensions for them. Parameters are marked read-only here because the GLSL qualifier
// would affect too many variables (relidar/base/kernel.glsl).
//
// A module is a sequence of 32-bit words. A header is followed by instructions. The first
// word of each instruction contains its length and opcode.
#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
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

inline constexpr std::size_t kHeaderWords = 5;
inline constexpr std::uint32_t kOpName = 5, kOpMemberName = 6, kOpLine = 8, kOpExtension = 10,
                               kOpEntryPoint = 15, kOpExecutionMode = 16, kOpCapability = 17,
                               kOpTypeBool = 20, kOpTypeInt = 21, kOpTypeFloat = 22, kOpTypeVector = 23,
                               kOpTypeArray = 28, kOpTypeRuntimeArray = 29, kOpTypeStruct = 30,
                               kOpTypePointer = 32, kOpConstantTrue = 41, kOpConstantFalse = 42,
                               kOpConstant = 43, kOpConstantComposite = 44, kOpSpecConstant = 50,
                               kOpSpecConstantOp = 52, kOpFunction = 54, kOpFunctionParameter = 55,
                               kOpFunctionEnd = 56, kOpFunctionCall = 57, kOpVariable = 59, kOpLoad = 61,
                               kOpStore = 62, kOpAccessChain = 65, kOpDecorate = 71, kOpMemberDecorate = 72,
                               kOpCompositeConstruct = 80, kOpBitcast = 124, kOpIAdd = 128,
                               kOpLogicalOr = 166, kOpLogicalAnd = 167, kOpLogicalNot = 168, kOpIEqual = 170,
                               kOpINotEqual = 171, kOpBitwiseAnd = 199, kOpControlBarrier = 224,
                               kOpMemoryBarrier = 225, kOpPhi = 245, kOpLoopMerge = 246,
                               kOpSelectionMerge = 247, kOpLabel = 248, kOpBranch = 249,
                               kOpBranchConditional = 250, kOpSwitch = 251, kOpNoLine = 317;
// Decorations, a value of the decoration kBuiltIn, storage classes, and a memory operand.
inline constexpr std::uint32_t kSpecId = 1, kArrayStride = 6, kBuiltIn = 11, kNonWritable = 24, kBinding = 33,
                               kOffset = 35, kCoherent = 23, kAliasedPointer = 5356;
inline constexpr std::uint32_t kLocalInvocationIndex = 29;
inline constexpr std::uint32_t kInput = 1, kPrivateStorage = 6, kPushConstant = 9, kPhysicalStorage = 5349;
inline constexpr std::uint32_t kAligned = 2;

using SpirvInstruction = std::span<const std::uint32_t>;

template <class F>
void for_instructions(std::span<const std::uint32_t> words, const F& function) {
    for (std::size_t at = kHeaderWords; at < words.size(); at += words[at] >> 16)
        function(words[at] & 0xffffu, words.subspan(at, words[at] >> 16));
}

inline void append_instruction(std::vector<std::uint32_t>& words, SpirvInstruction instruction) {
    words.insert(words.end(), instruction.begin(), instruction.end());
}

inline void append_instruction(std::vector<std::uint32_t>& words, std::uint32_t opcode,
                               std::initializer_list<std::uint32_t> operands) {
    words.push_back(std::uint32_t(operands.size() + 1) << 16 | opcode);
    words.insert(words.end(), operands);
}

inline const char* read_spirv_string(SpirvInstruction words) {
    return reinterpret_cast<const char*>(words.data());
}

/// True for the name of the type of a kernel's parameters (RELIDAR_PARAMS). SPIR-V lists
/// names before decorations and types.
inline bool is_parameter_block_name(std::uint32_t opcode, SpirvInstruction instruction) {
    return opcode == kOpName && std::string_view(read_spirv_string(instruction.subspan(2))) == "ParamsBlock";
}

inline bool is_function_head(std::uint32_t opcode) {
    return opcode == kOpFunction || opcode == kOpLabel || opcode == kOpVariable || opcode == kOpLine ||
           opcode == kOpNoLine;
}

}  // namespace relidar::gpu
