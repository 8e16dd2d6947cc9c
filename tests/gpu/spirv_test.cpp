// SPDX-License-Identifier: Apache-2.0
// Execution modes added to every module of the library: nothing else changes, and spirv-val, where there is one, accepts the result.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>

#include <unistd.h>

#include <gtest/gtest.h>

#include "gpu/kernel.hpp"
#include "gpu/spirv.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

using Words = std::vector<std::uint32_t>;

constexpr std::uint32_t kOpExtension = 10, kOpEntryPoint = 15, kOpExecutionMode = 16;

/// Instructions of a module. @return nothing where one is cut
std::vector<Words> instructions(std::span<const std::uint32_t> words) {
    std::vector<Words> result;
    for (std::size_t at = 5; at < words.size();) {
        const std::size_t n = words[at] >> 16;
        if (n == 0 || at + n > words.size()) return {};
        result.emplace_back(words.begin() + at, words.begin() + at + n);
        at += n;
    }
    return result;
}

/// Section of a module in which an instruction stands (SPIR-V specification, 2.4); 7 for the rest.
int section(const Words& instruction) {
    static const std::map<std::uint32_t, int> sections = {{17, 1}, {10, 2}, {11, 3}, {14, 4}, {15, 5}, {16, 6}, {331, 6}};
    const auto found = sections.find(instruction[0] & 0xffffu);
    return found == sections.end() ? 7 : found->second;
}

std::string text_of(const Words& extension) {
    std::string text(reinterpret_cast<const char*>(extension.data() + 1), 4 * (extension.size() - 1));
    EXPECT_EQ(text.back(), '\0');
    return text.c_str();
}

TEST(SpirvModes, ParametersAreReadOnlyInEveryModule) {
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const std::vector<Words> before = instructions(kernel.words), after = instructions(gpu::with_read_only_parameters(kernel.words));
        std::vector<Words> added;
        std::size_t k = 0;
        for (const Words& instruction : after) {
            if (k < before.size() && instruction == before[k]) ++k;
            else added.push_back(instruction);
        }
        EXPECT_EQ(k, before.size()) << kernel.name << ": an instruction is missing";
        ASSERT_EQ(added.size(), 1u) << kernel.name;
        EXPECT_EQ(added[0][0], 4u << 16 | 72u) << kernel.name;   // OpMemberDecorate
        EXPECT_EQ(added[0][2], 0u) << kernel.name;
        EXPECT_EQ(added[0][3], 24u) << kernel.name;              // NonWritable
    }
}

TEST(SpirvModes, AreAllThatIsAddedToAModule) {
    for (const EmbeddedKernel& kernel : embedded_kernels())
        for (const gpu::ExecutionMode& mode : {gpu::kSubgroupUniformControlFlow, gpu::kMaximallyReconverges}) {
            const std::vector<Words> before = instructions(kernel.words),
                                     after = instructions(gpu::with_execution_mode(kernel.words, mode));
            ASSERT_FALSE(after.empty()) << kernel.name;
            int n_extensions = 0, n_modes = 0, last = 0;
            std::vector<Words> rest;
            Words entry;
            for (const Words& instruction : after) {
                ASSERT_GE(section(instruction), last) << kernel.name << ": out of order";
                last = section(instruction);
                const std::uint32_t opcode = instruction[0] & 0xffffu;
                if (opcode == kOpEntryPoint) entry = instruction;
                if (opcode == kOpExtension && text_of(instruction) == mode.extension) ++n_extensions;
                else if (opcode == kOpExecutionMode && instruction == Words{3u << 16 | kOpExecutionMode, entry.at(2), mode.mode}) ++n_modes;
                else rest.push_back(instruction);
            }
            EXPECT_EQ(n_extensions, 1) << kernel.name;
            EXPECT_EQ(n_modes, 1) << kernel.name;
            EXPECT_EQ(rest, before) << kernel.name;
        }
}

TEST(SpirvModes, AreAcceptedBySpirvVal) {
    if (std::system("command -v spirv-val > /dev/null") != 0) GTEST_SKIP() << "no spirv-val";
    const fs::path file = fs::temp_directory_path() / ("relidar-modes-" + std::to_string(::getpid()) + ".spv");
    const std::string command = "spirv-val --target-env vulkan1.3 --scalar-block-layout " + file.string();
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const Words words = gpu::with_execution_mode(kernel.words, gpu::kSubgroupUniformControlFlow);
        std::ofstream(file, std::ios::binary).write(reinterpret_cast<const char*>(words.data()), std::streamsize(4 * words.size()));
        EXPECT_EQ(std::system(command.c_str()), 0) << kernel.name;
    }
    fs::remove(file);
}

}  // namespace
}  // namespace relidar
