// SPDX-License-Identifier: Apache-2.0
// Edits SPIR-V modules. The instructions of a module have a fixed order: capabilities,
// extensions, ..., entry points, execution modes, ...
#include "gpu/spirv.hpp"

#include <cstring>

#include "gpu/spirv_words.hpp"

namespace relidar::gpu {

/// Returns a copy of a module in which each entry point has an additional execution mode.
SpirvWords add_execution_mode(std::span<const std::uint32_t> words, const ExecutionMode& mode) {
    // The name of the extension ends with a zero byte, which may need another word.
    const std::string_view extension_name = mode.extension;
    std::vector<std::uint32_t> extension_words(1 + extension_name.size() / 4 + 1, 0u);
    std::memcpy(extension_words.data() + 1, extension_name.data(), extension_name.size());
    extension_words[0] = static_cast<std::uint32_t>(extension_words.size()) << 16 | kOpExtension;

    std::vector<std::uint32_t> result(words.begin(), words.begin() + kHeaderWords), modes;
    bool extended = false;
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        // Extensions follow the capabilities and precede all other instructions.
        if (!extended && opcode != kOpCapability && opcode != kOpExtension) {
            append_instruction(result, extension_words);
            extended = true;
        }
        if (opcode == kOpEntryPoint) {
            append_instruction(modes, kOpExecutionMode, {instruction[2], mode.mode});
        } else {  // Inserts the execution mode after the last entry point, as SPIR-V requires.
            append_instruction(result, modes);
            modes.clear();
        }
        append_instruction(result, instruction);
    });
    return result;
}

/// Decorates all members of the parameter block as NonWritable.
SpirvWords mark_params_readonly(std::span<const std::uint32_t> words) {
    std::vector<std::uint32_t> result(words.begin(), words.begin() + kHeaderWords);
    std::uint32_t block = 0;  // Id of the type of the parameter block.
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        if (is_parameter_block_name(opcode, instruction)) block = instruction[1];
        append_instruction(result, instruction);
        if (opcode == kOpMemberDecorate && instruction[1] == block && instruction[3] == kOffset)
            append_instruction(result, kOpMemberDecorate, {block, instruction[2], kNonWritable});
    });
    return result;
}

std::set<std::uint32_t> list_constants(std::span<const std::uint32_t> words) {
    std::set<std::uint32_t> ids;
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        if (opcode == kOpDecorate && instruction[2] == kSpecId) ids.insert(instruction[3]);
    });
    return ids;
}

}  // namespace relidar::gpu
