// SPDX-License-Identifier: Apache-2.0
// Edits of SPIR-V modules: the remaining code must not change. Kernels from SPIR-V
// outside of the library: they run like the kernels of the library, and a wrong module is
// an error before it reaches the driver.
#include <algorithm>
#include <cstdlib>
#include <fstream>

#include <unistd.h>

#include <relidar/base/error.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"
#include "diff/shared/loss.h"
#include "gpu/shared/gpu.h"
#include "gpu/spirv.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

namespace fs = std::filesystem;

using namespace gpu;
using Words = std::vector<std::uint32_t>;

std::vector<Words> instructions(std::span<const std::uint32_t> words) {
    std::vector<Words> result;
    for_instructions(words,
                     [&](std::uint32_t, SpirvInstruction i) { result.emplace_back(i.begin(), i.end()); });
    return result;
}

/// Returns the section of an instruction (SPIR-V specification, 2.4), or 7 for later
/// ones.
int section(const Words& instruction) {
    static const std::map<std::uint32_t, int> sections = {{17, 1}, {10, 2}, {11, 3}, {14, 4},
                                                          {15, 5}, {16, 6}, {331, 6}};
    const auto match = sections.find(instruction[0] & 0xffffu);
    return match == sections.end() ? 7 : match->second;
}

std::string text_of(const Words& extension) {
    std::string text(reinterpret_cast<const char*>(extension.data() + 1), 4 * (extension.size() - 1));
    EXPECT_EQ(text.back(), '\0');
    return text.c_str();
}

TEST(SpirvModes, ParametersAreReadOnlyInEveryModule) {
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const std::vector<Words> before = instructions(kernel.words),
                                 after = instructions(mark_params_readonly(kernel.words));
        std::vector<Words> added;
        std::size_t k = 0;
        for (const Words& instruction : after) {
            if (k < before.size() && instruction == before[k]) ++k;
            else added.push_back(instruction);
        }
        EXPECT_EQ(k, before.size()) << kernel.name << ": an instruction is missing";
        ASSERT_EQ(added.size(), 1u) << kernel.name;
        EXPECT_EQ(added[0][0], 4u << 16 | kOpMemberDecorate) << kernel.name;
        EXPECT_EQ(added[0][2], 0u) << kernel.name;
        EXPECT_EQ(added[0][3], kNonWritable) << kernel.name;
    }
}

TEST(SpirvModes, AreAllThatIsAddedToAModule) {
    for (const EmbeddedKernel& kernel : embedded_kernels())
        for (const ExecutionMode& mode : {kSubgroupUniformControlFlow, kMaximallyReconverges}) {
            const std::vector<Words> before = instructions(kernel.words),
                                     after = instructions(add_execution_mode(kernel.words, mode));
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
                else if (opcode == kOpExecutionMode &&
                         instruction == Words{3u << 16 | kOpExecutionMode, entry.at(2), mode.mode})
                    ++n_modes;
                else rest.push_back(instruction);
            }
            EXPECT_EQ(n_extensions, 1) << kernel.name;
            EXPECT_EQ(n_modes, 1) << kernel.name;
            EXPECT_EQ(rest, before) << kernel.name;
        }
}

/// Loads in other functions count as loads after the branch.
std::pair<int, int> count_parameter_loads(std::span<const std::uint32_t> words) {
    std::uint32_t block = 0, pointer = 0, entry = 0;
    std::set<std::uint32_t> addresses, member_pointers;
    bool at_start = false;
    std::pair<int, int> n{0, 0};
    for (const Words& i : instructions(words)) {
        const std::uint32_t opcode = i[0] & 0xffffu;
        if (is_parameter_block_name(opcode, i)) block = i[1];
        if (opcode == kOpEntryPoint) entry = i[2];
        if (opcode == kOpTypePointer && i[3] == block) pointer = i[1];
        if (opcode == kOpFunction) at_start = i[2] == entry;
        if (opcode == kOpSelectionMerge || opcode == kOpLoopMerge || opcode == kOpFunctionCall)
            at_start = false;
        if (opcode == kOpLoad && i[1] == pointer) addresses.insert(i[2]);
        if (opcode == kOpAccessChain && addresses.contains(i[3])) member_pointers.insert(i[2]);
        if (opcode == kOpLoad && member_pointers.contains(i[3])) ++(at_start ? n.first : n.second);
    }
    return n;
}

/// The only exceptions are array elements whose index is computed on the device.
TEST(SpirvParameters, AreReadWhereAModuleBegins) {
    int n_before = 0, n_later = 0;
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const auto [first, later] = count_parameter_loads(hoist_loads(kernel.words));
        EXPECT_GE(first, 1) << kernel.name;
        n_before += count_parameter_loads(kernel.words).second;
        n_later += later;
    }
    EXPECT_LT(n_later, n_before / 100) << "of " << n_before;
}

void write_module(const fs::path& file, std::span<const std::uint32_t> words) {
    std::ofstream(file, std::ios::binary)
        .write(reinterpret_cast<const char*>(words.data()), std::streamsize(4 * words.size()));
}

void expect_valid(const std::function<Words(std::span<const std::uint32_t>)>& change) {
    if (std::system("command -v spirv-val > /dev/null") != 0) GTEST_SKIP() << "no spirv-val";
    const fs::path file =
        fs::temp_directory_path() / ("relidar-modules-" + std::to_string(::getpid()) + ".spv");
    const std::string command =
        "spirv-val --target-env vulkan1.3 --scalar-block-layout " + file.string() + " 2>&1";
    const auto complaint = [&](std::span<const std::uint32_t> words) {
        write_module(file, words);
        std::string text;
        FILE* const output = ::popen(command.c_str(), "r");
        for (int c; (c = std::fgetc(output)) != EOF;) text += char(c);
        const int status = ::pclose(output);
        return status == 0 ? std::string() : text + "(exit status " + std::to_string(status) + ")";
    };
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const std::string validation_errors = complaint(change(kernel.words));
        EXPECT_TRUE(validation_errors.empty()) << kernel.name << ": " << validation_errors;
    }
    fs::remove(file);
}

TEST(SpirvModes, AreAcceptedBySpirvVal) {
    expect_valid([](std::span<const std::uint32_t> words) {
        return add_execution_mode(words, kSubgroupUniformControlFlow);
    });
}

TEST(SpirvParameters, AreAcceptedBySpirvVal) {
    expect_valid(
        [](std::span<const std::uint32_t> words) { return hoist_loads(mark_params_readonly(words)); });
}

TEST(SpirvLanes, AreAcceptedBySpirvVal) {
    expect_valid([](std::span<const std::uint32_t> words) { return hoist_loads(make_nonuniform(words)); });
}

/// Every index into an array must be a sum, and every index of parameters a constant.
TEST(SpirvLanes, AreInEveryIndex) {
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        std::uint32_t block = 0, block_pointer = 0;
        std::set<std::uint32_t> addresses, parameters, sums;
        int n_indices = 0;
        for (const Words& i : instructions(make_nonuniform(kernel.words))) {
            const std::uint32_t opcode = i[0] & 0xffffu;
            if (is_parameter_block_name(opcode, i)) block = i[1];
            if (opcode == kOpTypePointer && i[2] == kPhysicalStorage) addresses.insert(i[1]);
            if (opcode == kOpTypePointer && i[2] == kPhysicalStorage && i[3] == block) block_pointer = i[1];
            if (opcode == kOpLoad && i[1] == block_pointer) parameters.insert(i[2]);
            if (opcode == kOpIAdd) sums.insert(i[2]);
            if (opcode != kOpAccessChain || !addresses.contains(i[1]) || parameters.contains(i[3])) continue;
            ++n_indices;
            EXPECT_TRUE(i.size() > 5 && sums.contains(i[5])) << kernel.name;
        }
        EXPECT_GT(n_indices, 0) << kernel.name;
    }
}

std::map<std::uint32_t, std::uint32_t> change_constants(std::span<const std::uint32_t> words) {
    const auto id_of = [](SpecialisationConstantId id) { return static_cast<std::uint32_t>(id); };
    std::map<std::uint32_t, std::uint32_t> constants;
    for (const std::uint32_t id : list_constants(words))
        constants[id] = id == id_of(SpecialisationConstantId::CHUNK) ? 16u : 1u;
    constants.erase(id_of(SpecialisationConstantId::WORKGROUP_SIZE));
    return constants;
}

TEST(SpirvBranches, AreAcceptedBySpirvVal) {
    expect_valid([](std::span<const std::uint32_t> words) { return remove_branches(words, {}); });
    expect_valid(
        [](std::span<const std::uint32_t> words) { return remove_branches(words, change_constants(words)); });
}

std::string optimise_words(std::span<const std::uint32_t> words,
                           const std::map<std::uint32_t, std::uint32_t>& constants) {
    const fs::path file =
        fs::temp_directory_path() / ("relidar-branches-" + std::to_string(::getpid()) + ".spv");
    write_module(file, words);
    std::string values;
    for (const auto& [id, value] : constants)
        values += std::to_string(id) + ":" + std::to_string(value) + " ";
    const std::string command =
        "spirv-opt --set-spec-const-default-value='" + values + "' --freeze-spec-const " +
        "--fold-spec-const-op-composite --eliminate-dead-branches --eliminate-dead-functions " +
        "--eliminate-dead-const --compact-ids " + file.string() + " -o " + file.string() + ".out";
    EXPECT_EQ(std::system(command.c_str()), 0) << command;
    std::ifstream in(file.string() + ".out", std::ios::binary);
    const std::string result((std::istreambuf_iterator<char>(in)), std::istreambuf_iterator<char>());
    fs::remove(file);
    fs::remove(file.string() + ".out");
    return result;
}

/// spirv-opt must give the same code with and without the removal of branches.
TEST(SpirvBranches, LeaveWhatSpirvOptLeaves) {
    if (std::system("command -v spirv-opt > /dev/null") != 0) GTEST_SKIP() << "no spirv-opt";
    std::size_t n_shorter = 0;
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const std::map<std::uint32_t, std::uint32_t> constants = change_constants(kernel.words);
        if (constants.empty()) continue;
        const Words resolved_words = remove_branches(kernel.words, constants);
        EXPECT_TRUE(optimise_words(resolved_words, constants) == optimise_words(kernel.words, constants))
            << kernel.name;
        n_shorter += resolved_words.size() < kernel.words.size();
    }
    EXPECT_GT(n_shorter, 20u);
}

using CopyKernel = Kernel<shared::CopyParams>;

class LoadedKernel : public test::DeviceTest {};

Words module_of(std::string_view name) {
    for (const EmbeddedKernel& kernel : embedded_kernels())
        if (kernel.name == name) return {kernel.words.begin(), kernel.words.end()};
    return {};
}

/// Returns the module without the instructions with this opcode.
Words without(const Words& words, std::uint32_t removed_opcode) {
    Words result(words.begin(), words.begin() + gpu::kHeaderWords);
    gpu::for_instructions(words, [&](std::uint32_t opcode, gpu::SpirvInstruction instruction) {
        if (opcode != removed_opcode) gpu::append_instruction(result, instruction);
    });
    return result;
}

TEST_F(LoadedKernel, RunsLikeAKernelOfTheLibrary) {
    const ScratchFolder folder;
    const std::filesystem::path file = folder.path / "mine.spv";
    const Words words = module_of("gpu/copy");
    write_module(file, words);
    std::vector<glm::vec4> values(1000);
    for (std::size_t i = 0; i < values.size(); ++i) values[i] = glm::vec4(float(i));
    const Array<glm::vec4, shared::CopySource> from(device(), values, "source");
    // Another module with the same name must not get the pipeline of this module.
    const auto other =
        Kernel<shared::ListTouchedParams>::from_spirv(device(), module_of("scene/list_touched"), "mine.spv");
    Stream stream(device(), true);
    for (const bool from_file : {false, true}) {
        const CopyKernel kernel = from_file ? CopyKernel::from_spirv(device(), file)
                                            : CopyKernel::from_spirv(device(), words, "mine.spv");
        const Array<glm::vec4, shared::CopyTarget> to(device(), std::vector<glm::vec4>(1000), "target");
        run(stream, kernel, 999, {.from = from.address(), .to = to.address(), .n = 999});
        stream.submit_and_wait();
        std::vector<glm::vec4> expected = values;
        expected[999] = glm::vec4(0.0f);
        EXPECT_EQ(to.download(), expected);
    }
    if (device().info().timestamps) {
        EXPECT_EQ(stream.times().totals.at("mine.spv").launches, 2.0);
    }
}

TEST(SpirvParameters, HaveTheSizeOfTheStruct) {
    EXPECT_EQ(gpu::find_params_size(module_of("gpu/copy")), sizeof(shared::CopyParams));
    EXPECT_EQ(gpu::find_params_size(module_of("diff/loss/ssim_vjp")), sizeof(shared::SsimParams));
    EXPECT_EQ(gpu::find_params_size(module_of("diff/loss/chamfer_nearest")),
              sizeof(shared::ChamferNearestParams));
    EXPECT_EQ(gpu::find_params_size(module_of("diff/loss/surfel_loss@_swap")),
              sizeof(shared::SurfelLossParams));
    for (const EmbeddedKernel& kernel : embedded_kernels())
        EXPECT_GT(gpu::find_params_size(kernel.words), 0u) << kernel.name;
}

TEST_F(LoadedKernel, WrongModulesAreErrors) {
    const Words words = module_of("gpu/copy");
    Words other_magic = words, newer = words, truncated = words, other_name = words;
    other_magic[0] = 0x03022307;  // the other byte order
    newer[1] = 0x00010700;
    truncated.pop_back();
    const std::uint32_t main_text = 0x6e69616d;  // "main"
    const auto entry = std::find(other_name.begin(), other_name.end(), main_text);
    ASSERT_NE(entry, other_name.end());
    *entry = 0x656e6f6e;  // "none"
    for (const Words& wrong :
         {Words{}, Words(words.begin(), words.begin() + 4), other_magic, newer, truncated, other_name,
          without(words, gpu::kOpEntryPoint), without(words, gpu::kOpName), without(words, gpu::kOpDecorate)})
        EXPECT_THROW(CopyKernel::from_spirv(device(), wrong, "wrong"), DataError);
    EXPECT_THROW(Kernel<shared::SsimParams>::from_spirv(device(), words, "wrong"), UsageError);
    const ScratchFolder folder;
    EXPECT_THROW(CopyKernel::from_spirv(device(), folder.path / "missing.spv"), DataError);
    std::ofstream(folder.path / "five.spv") << "SPIRV";
    EXPECT_THROW(CopyKernel::from_spirv(device(), folder.path / "five.spv"), DataError);
}

}  // namespace
}  // namespace relidar
