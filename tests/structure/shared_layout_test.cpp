// SPDX-License-Identifier: Apache-2.0
// Tests that host and shaders use the same layout for every shared struct, in every
// kernel that uses the struct. Also tests that kernels use only features that every
// device has.
#include <algorithm>
#include <cstddef>
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "gpu/kernel.hpp"
#include "gpu/spirv.hpp"
#include "shared_layouts.inc"
#include "spirv_layout.hpp"

namespace relidar::structure {
namespace {

std::map<std::string, StructLayout> list_host_layouts() {
    std::map<std::string, StructLayout> layouts;
    for (const HostMember& row : kHostMembers)
        layouts[row.type][row.member] = static_cast<std::uint32_t>(row.offset);
    return layouts;
}

TEST(SharedLayout, KernelsSeeWhatTheHostWrites) {
    const std::map<std::string, StructLayout> host = list_host_layouts();
    ASSERT_FALSE(host.empty());
    std::set<std::string> unseen;
    for (const auto& [type, layout] : host) unseen.insert(type);
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const std::map<std::string, StructLayout> kernel_layouts = read_spirv_layouts(kernel.words);
        for (const auto& [type, layout] : kernel_layouts) {
            const auto ours = host.find(type);
            if (ours == host.end()) continue;  // a private block of the shader
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
            << kernel.name << ": see RELIDAR_DECLARE_POINTER in relidar/base/lang.h";
}

/// Uses of addresses in a module.
struct Addresses {
    int n_compared = 0;   ///< comparisons with a constant
    int n_in_arrays = 0;  ///< number of array types whose elements contain addresses
};

class AddressReader {
public:
    explicit AddressReader(std::span<const std::uint32_t> words) {
        spirv_detail::for_each_instruction(
            words,
            [&](std::uint32_t opcode, std::span<const std::uint32_t> operands) { read(opcode, operands); });
        for (const std::uint32_t entry : entries_) address_counts_.n_in_arrays += holds_address(entry);
    }
    Addresses found() const { return address_counts_; }

private:
    enum : std::uint32_t {
        type_array = 28,
        type_runtime_array = 29,
        type_struct = 30,
        type_pointer = 32,
        constant = 43,
        constant_composite = 44,
        function_parameter = 55,
        load = 61,
        bitcast = 124,
        equal = 170,
        not_equal = 171,
        storage = 5349
    };
    std::set<std::uint32_t> addresses_, entries_;  ///< types of addresses and of array elements
    std::map<std::uint32_t, std::vector<std::uint32_t>> members_;
    /// values_ are addresses; bits_ are the same addresses in the form of vectors
    std::set<std::uint32_t> constants_, values_, bits_;
    Addresses address_counts_;

    bool holds_address(std::uint32_t type) const {
        if (addresses_.contains(type)) return true;
        const auto at = members_.find(type);
        return at != members_.end() &&
               std::ranges::any_of(at->second, [&](std::uint32_t member) { return holds_address(member); });
    }
    void read(std::uint32_t opcode, std::span<const std::uint32_t> operands) {
        if (opcode == type_pointer && operands[1] == storage) addresses_.insert(operands[0]);
        if (opcode == type_runtime_array) entries_.insert(operands[1]);
        if (opcode == type_array) members_[operands[0]] = {operands[1]};
        if (opcode == type_struct) members_[operands[0]].assign(operands.begin() + 1, operands.end());
        if (opcode == constant || opcode == constant_composite) constants_.insert(operands[1]);
        if ((opcode == load || opcode == function_parameter) && addresses_.contains(operands[0]))
            values_.insert(operands[1]);
        if (opcode == bitcast && values_.contains(operands[2])) bits_.insert(operands[1]);
        if (opcode != equal && opcode != not_equal) return;
        if ((bits_.contains(operands[2]) && constants_.contains(operands[3])) ||
            (bits_.contains(operands[3]) && constants_.contains(operands[2])))
            ++address_counts_.n_compared;
    }
};

/// Tests that kernels never get address 0. Newer versions of lavapipe read through an
/// address even in a branch that no lane executes. The stream therefore replaces null
/// addresses in the parameters. Arrays must contain no addresses, and kernels must not
/// compare addresses with 0.
TEST(Kernels, GetNoAddressZero) {
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        const Addresses address_counts = AddressReader(kernel.words).found();
        EXPECT_EQ(address_counts.n_compared, 0)
            << kernel.name << ": compares an address with a constant, expected is_null()";
        EXPECT_EQ(address_counts.n_in_arrays, 0)
            << kernel.name << ": reads addresses from memory, which may be 0 there";
    }
}

/// Compares the offsets of addresses with the offsets in the host's struct, written by
/// hand for the parameters of a kernel.
TEST(Kernels, AddressesOfParametersAreFound) {
    const auto addresses = [](std::string_view name) {
        for (const EmbeddedKernel& kernel : embedded_kernels())
            if (kernel.name == name) return gpu::list_pointer_offsets_in_parameter_block(kernel.words);
        return std::vector<std::uint32_t>();
    };
    EXPECT_THAT(addresses("gpu/copy"), testing::ElementsAre(0u, 8u));
    EXPECT_THAT(addresses("scene/activate"),
                testing::ElementsAre(0u, 8u, 16u, 24u, 32u, 40u, 48u, 56u, 64u, 72u, 80u));
    for (const EmbeddedKernel& kernel : embedded_kernels())
        EXPECT_FALSE(gpu::list_pointer_offsets_in_parameter_block(kernel.words).empty()) << kernel.name;
}

}  // namespace
}  // namespace relidar::structure
