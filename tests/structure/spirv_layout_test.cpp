// SPDX-License-Identifier: Apache-2.0
#include "spirv_layout.hpp"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace relidar::structure {
namespace {

namespace fs = std::filesystem;
using testing::Pair;
using testing::UnorderedElementsAre;

constexpr const char* kShader = R"(#version 460
#extension GL_EXT_scalar_block_layout : require
#extension GL_EXT_buffer_reference2 : require
#extension GL_EXT_shader_explicit_arithmetic_types_int64 : require
layout(local_size_x = 1) in;
struct Sample { vec3 direction; float range_m; uint channel; };
layout(buffer_reference, scalar, buffer_reference_align = 4) buffer Samples { Sample at[]; };
struct Params { Samples samples; uint64_t address; uint n; vec3 origin; float gain; };
layout(buffer_reference, scalar) buffer ParamsPointer { Params params; };
layout(push_constant, scalar) uniform Push { ParamsPointer pointer; };
void main() {
    Params p = pointer.params;               // a local copy: the second, undecorated struct
    Sample s = p.samples.at[p.n];
    p.samples.at[0].range_m = s.range_m * p.gain + p.origin.x + float(p.address);
})";

/// Compiles GLSL. Returns an empty vector if no compiler is installed.
std::vector<std::uint32_t> compile(const std::string& source) {
    if (std::system("glslangValidator --version >/dev/null 2>&1") != 0) return {};
    std::string folder = (fs::temp_directory_path() / "relidar-spirv-XXXXXX").string();
    if (mkdtemp(folder.data()) == nullptr) throw std::runtime_error("no temporary folder");
    const fs::path in = fs::path(folder) / "a.comp", out = fs::path(folder) / "a.spv";
    std::ofstream(in) << source;
    const int status = std::system(
        ("glslangValidator --quiet --target-env vulkan1.3 -o " + out.string() + " " + in.string()).c_str());
    std::ifstream file(out, std::ios::binary);
    const std::string bytes{std::istreambuf_iterator<char>(file), {}};
    fs::remove_all(folder);
    if (status != 0) throw std::runtime_error("the test shader does not compile");
    std::vector<std::uint32_t> words(bytes.size() / 4);
    std::copy_n(bytes.data(), words.size() * 4, reinterpret_cast<char*>(words.data()));
    return words;
}

TEST(SpirvLayout, ReadsScalarOffsets) {
    const std::vector<std::uint32_t> words = compile(kShader);
    if (words.empty()) GTEST_SKIP() << "no glslangValidator";
    const std::map<std::string, StructLayout> layouts = read_spirv_layouts(words);
    ASSERT_TRUE(layouts.contains("Params"));
    EXPECT_THAT(layouts.at("Params"),
                UnorderedElementsAre(Pair("samples", 0u), Pair("address", 8u), Pair("n", 16u),
                                     Pair("origin", 20u), Pair("gain", 32u)));
    ASSERT_TRUE(layouts.contains("Sample"));
    EXPECT_THAT(layouts.at("Sample"),
                UnorderedElementsAre(Pair("direction", 0u), Pair("range_m", 12u), Pair("channel", 16u)));
}

TEST(SpirvLayout, ReadsCapabilities) {
    const std::vector<std::uint32_t> words = compile(kShader);
    if (words.empty()) GTEST_SKIP() << "no glslangValidator";
    EXPECT_TRUE(read_spirv_capabilities(words).contains(kCapabilityInt64)) << "the shader has a uint64_t";
}

TEST(SpirvLayout, RefusesWhatIsNoModule) {
    EXPECT_THROW(read_spirv_layouts(std::vector<std::uint32_t>{}), std::runtime_error);
    EXPECT_THROW(read_spirv_layouts(std::vector<std::uint32_t>{1, 2, 3, 4, 5, 6}), std::runtime_error);
    EXPECT_THROW(read_spirv_layouts(std::vector<std::uint32_t>{0x07230203u, 0, 0, 0, 0, (9u << 16) | 5u}),
                 std::runtime_error);
    EXPECT_THROW(read_spirv_layouts(std::vector<std::uint32_t>{0x07230203u, 0, 0, 0, 0, 0}),
                 std::runtime_error);
}

TEST(SpirvLayout, RefusesTwoLayoutsOfOneStruct) {
    const std::uint32_t a = 'A';
    const auto type = [&](std::uint32_t id, std::uint32_t offset) {
        return std::vector<std::uint32_t>{
            (3u << 16) | 5u,  id, a, (4u << 16) | 6u, id, 0, 'x', (5u << 16) | 72u, id, 0, 35, offset,
            (3u << 16) | 30u, id, 9};
    };
    std::vector<std::uint32_t> words = {0x07230203u, 0, 0, 0, 0};
    for (const auto& part : {type(1, 0), type(2, 0)}) words.insert(words.end(), part.begin(), part.end());
    EXPECT_THAT(read_spirv_layouts(words),
                UnorderedElementsAre(Pair("A", UnorderedElementsAre(Pair("x", 0u)))));
    const auto other = type(3, 4);
    words.insert(words.end(), other.begin(), other.end());
    EXPECT_THROW(read_spirv_layouts(words), std::runtime_error);
}

}  // namespace
}  // namespace relidar::structure
