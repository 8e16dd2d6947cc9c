// SPDX-License-Identifier: Apache-2.0
// Reads SPIR-V as a sequence of 32-bit words. A header is followed by instructions. The
// first word of each instruction contains its length and opcode.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace relidar::gpu {

inline constexpr std::size_t kHeaderWords = 5;
inline constexpr std::uint32_t kOpName = 5, kOpDecorate = 71, kSpecId = 1;

using SpirvInstruction = std::span<const std::uint32_t>;

/// Calls function(opcode, instruction) for each instruction of a SPIR-V module, in the
/// order of the module.
template <class F>
void for_each_instruction(std::span<const std::uint32_t> words, const F& function) {
    for (std::size_t at = kHeaderWords; at < words.size(); at += words[at] >> 16)
        function(words[at] & 0xffffu, words.subspan(at, words[at] >> 16));
}

inline void append_instruction(std::vector<std::uint32_t>& words, SpirvInstruction instruction) {
    words.insert(words.end(), instruction.begin(), instruction.end());
}

inline const char* get_name_operand(SpirvInstruction op_name) {
    return reinterpret_cast<const char*>(&op_name[2]);
}

}  // namespace relidar::gpu
