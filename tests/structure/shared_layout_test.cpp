// SPDX-License-Identifier: Apache-2.0
// Host and shaders see the same bytes: every struct of include/relidar/shared and shaders/shared, in every kernel that uses it. And no
// kernel needs what not every device has.
#include <cstddef>
#include <map>
#include <set>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "gpu/kernel.hpp"
#include "shared_layouts.inc"
#include "spirv_layout.hpp"

namespace relidar::structure {
namespace {

std::map<std::string, StructLayout> host_layouts() {
    std::map<std::string, StructLayout> layouts;
    for (const HostMember& row : kHostMembers) layouts[row.type][row.member] = static_cast<std::uint32_t>(row.offset);
    return layouts;
}

TEST(SharedLayout, KernelsSeeWhatTheHostWrites) {
    const std::map<std::string, StructLayout> host = host_layouts();
    ASSERT_FALSE(host.empty());
    std::set<std::string> unseen;
    for (const auto& [type, layout] : host) unseen.insert(type);
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const std::map<std::string, StructLayout> seen = read_spirv_layouts(kernel.words);
        for (const auto& [type, layout] : seen) {
            const auto ours = host.find(type);
            if (ours == host.end()) continue;   // a block of the shader's own
            EXPECT_EQ(layout, ours->second) << type << " in " << kernel.name;
            unseen.erase(type);
        }
    }
    EXPECT_THAT(unseen, testing::IsEmpty()) << "shared structs that no kernel uses";
}

TEST(Kernels, HaveNo64BitIntegers) {
    ASSERT_FALSE(embedded_kernels().empty());
    for (const EmbeddedKernel& kernel : embedded_kernels())
        EXPECT_FALSE(read_spirv_capabilities(kernel.words).contains(kCapabilityInt64))
            << kernel.name << ": see is_null() in relidar/shared/lang.h";
}

}  // namespace
}  // namespace relidar::structure
