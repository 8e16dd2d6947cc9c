// SPDX-License-Identifier: Apache-2.0
// Kernels from SPIR-V outside of the library: they run like the kernels of the library,
// and a wrong module is an error before it reaches the driver.
#include <algorithm>
#include <fstream>

#include <relidar/base/error.hpp>

#include "../base/codecs/temporary_folder.hpp"
#include "../support/device.hpp"
#include "diff/shared/loss.h"
#include "gpu/shared/gpu.h"
#include "gpu/spirv.hpp"
#include "gpu/spirv_words.hpp"
#include "gpu/stream.hpp"

namespace relidar {
namespace {

using Words = std::vector<std::uint32_t>;
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
    std::ofstream(file, std::ios::binary)
        .write(reinterpret_cast<const char*>(words.data()), std::streamsize(4 * words.size()));
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
