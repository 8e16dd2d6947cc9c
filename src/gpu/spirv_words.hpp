// SPDX-License-Identifier: Apache-2.0
// Reads SPIR-V as a sequence of 32-bit words. A header is followed by instructions. The
// first word of each instruction contains its length and opcode.
#pragma once

#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <span>
#include <string_view>
#include <vector>

namespace relidar::gpu {

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
