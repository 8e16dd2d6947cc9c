// SPDX-License-Identifier: Apache-2.0
// The order of a module: capabilities, extensions, ..., entry points, execution modes, ...
#include "gpu/spirv_modes.hpp"

#include <cstring>

namespace relidar::gpu {

namespace {

constexpr std::size_t kHeaderWords = 5;
constexpr std::uint32_t kOpName = 5, kOpMemberDecorate = 72, kOffset = 35, kNonWritable = 24;
constexpr std::uint32_t kOpExtension = 10, kOpEntryPoint = 15, kOpExecutionMode = 16, kOpCapability = 17;

std::vector<std::uint32_t> extension_instruction(std::string_view name) {
    std::vector<std::uint32_t> words(1 + name.size() / 4 + 1, 0u);   // the name ends with a zero byte
    std::memcpy(words.data() + 1, name.data(), name.size());
    words[0] = static_cast<std::uint32_t>(words.size()) << 16 | kOpExtension;
    return words;
}

}  // namespace

std::vector<std::uint32_t> with_execution_mode(std::span<const std::uint32_t> words, const ExecutionMode& mode) {
    std::vector<std::uint32_t> result(words.begin(), words.begin() + kHeaderWords), modes;
    bool extended = false;
    for (std::size_t at = kHeaderWords; at < words.size(); at += words[at] >> 16) {
        const std::uint32_t opcode = words[at] & 0xffffu;
        if (!extended && opcode != kOpCapability && opcode != kOpExtension) {
            const std::vector<std::uint32_t> extension = extension_instruction(mode.extension);
            result.insert(result.end(), extension.begin(), extension.end());
            extended = true;
        }
        if (opcode == kOpEntryPoint) {
            modes.insert(modes.end(), {3u << 16 | kOpExecutionMode, words[at + 2], mode.mode});
        } else {   // behind the last entry point
            result.insert(result.end(), modes.begin(), modes.end());
            modes.clear();
        }
        result.insert(result.end(), words.begin() + at, words.begin() + at + (words[at] >> 16));
    }
    return result;
}

std::vector<std::uint32_t> with_read_only_parameters(std::span<const std::uint32_t> words) {
    std::vector<std::uint32_t> result(words.begin(), words.begin() + kHeaderWords);
    std::uint32_t block = 0;   // names come before decorations
    for (std::size_t at = kHeaderWords; at < words.size(); at += words[at] >> 16) {
        const std::uint32_t opcode = words[at] & 0xffffu;
        if (opcode == kOpName && std::strcmp(reinterpret_cast<const char*>(&words[at + 2]), "ParamsBlock") == 0) block = words[at + 1];
        result.insert(result.end(), words.begin() + at, words.begin() + at + (words[at] >> 16));
        if (opcode == kOpMemberDecorate && words[at + 1] == block && words[at + 3] == kOffset)
            result.insert(result.end(), {4u << 16 | kOpMemberDecorate, block, words[at + 2], kNonWritable});
    }
    return result;
}

}  // namespace relidar::gpu
