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

template <class F>
void for_each_spirv_instruction(std::span<const std::uint32_t> spirv_words, const F& function) {
    for (std::size_t at = kHeaderWords; at < spirv_words.size(); at += spirv_words[at] >> 16)
        function(spirv_words[at] & 0xffffu, spirv_words.subspan(at, spirv_words[at] >> 16));
}

inline void append_spirv_instruction(std::vector<std::uint32_t>& spirv_words, SpirvInstruction instruction) {
    spirv_words.insert(spirv_words.end(), instruction.begin(), instruction.end());
}

inline const char* get_name_of_op_name_instruction(SpirvInstruction op_name_instruction) {
    return reinterpret_cast<const char*>(&op_name_instruction[2]);
}

}  // namespace relidar::gpu
