// SPDX-License-Identifier: Apache-2.0
// Host and kernels must use the same layout for every shared struct.
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

namespace relidar::structure {
namespace {

using namespace gpu;

using StructLayout = std::map<std::string, std::uint32_t>;

struct Struct {
    std::string name;
    std::size_t n_members = 0;
    std::map<std::uint32_t, std::string> member_name;
    std::map<std::uint32_t, std::uint32_t> member_offset;
};

/// Returns the layouts of the structs with offsets in a module, by their names in the
/// source. glslang emits a second, undecorated copy of a struct that is used as a local
/// variable. These copies are omitted.
std::map<std::string, StructLayout> read_spirv_layouts(std::span<const std::uint32_t> words) {
    std::map<std::uint32_t, Struct> structs;
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction i) {
        if (opcode == kOpName) structs[i[1]].name = read_spirv_string(i.subspan(2));
        if (opcode == kOpMemberName) structs[i[1]].member_name[i[2]] = read_spirv_string(i.subspan(3));
        if (opcode == kOpMemberDecorate && i[3] == kOffset) structs[i[1]].member_offset[i[2]] = i[4];
        if (opcode == kOpTypeStruct) structs[i[1]].n_members = i.size() - 2;
    });
    std::map<std::string, StructLayout> layouts;
    for (const auto& [id, type] : structs) {
        if (type.n_members == 0 || type.member_offset.size() != type.n_members) continue;
        StructLayout layout;
        for (const auto& [member, offset] : type.member_offset) layout[type.member_name.at(member)] = offset;
        EXPECT_EQ(layouts.emplace(type.name, layout).first->second, layout) << "two layouts of " << type.name;
    }
    return layouts;
}

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
    constexpr std::uint32_t kCapabilityInt64 = 11;
    ASSERT_FALSE(embedded_kernels().empty());
    for (const EmbeddedKernel& kernel : embedded_kernels())
        for_instructions(kernel.words, [&](std::uint32_t opcode, SpirvInstruction i) {
            EXPECT_FALSE(opcode == kOpCapability && i[1] == kCapabilityInt64)
                << kernel.name << ": see RELIDAR_DECLARE_POINTER in relidar/base/lang.h";
        });
}

/// Uses of addresses in a module.
struct Addresses {
    int n_compared = 0;   ///< comparisons with a constant
    int n_in_arrays = 0;  ///< number of array types whose elements contain addresses
};

class AddressReader {
public:
    explicit AddressReader(std::span<const std::uint32_t> words) {
        for_instructions(words,
                         [&](std::uint32_t opcode, SpirvInstruction i) { read(opcode, i.subspan(1)); });
        for (const std::uint32_t entry : entries_) address_counts_.n_in_arrays += holds_address(entry);
    }
    Addresses found() const { return address_counts_; }

private:
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
        if (opcode == kOpTypePointer && operands[1] == kPhysicalStorage) addresses_.insert(operands[0]);
        if (opcode == kOpTypeRuntimeArray) entries_.insert(operands[1]);
        if (opcode == kOpTypeArray) members_[operands[0]] = {operands[1]};
        if (opcode == kOpTypeStruct) members_[operands[0]].assign(operands.begin() + 1, operands.end());
        if (opcode == kOpConstant || opcode == kOpConstantComposite) constants_.insert(operands[1]);
        if ((opcode == kOpLoad || opcode == kOpFunctionParameter) && addresses_.contains(operands[0]))
            values_.insert(operands[1]);
        if (opcode == kOpBitcast && values_.contains(operands[2])) bits_.insert(operands[1]);
        if (opcode != kOpIEqual && opcode != kOpINotEqual) return;
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
            if (kernel.name == name) return list_pointers(kernel.words);
        return std::vector<std::uint32_t>();
    };
    EXPECT_THAT(addresses("gpu/copy"), testing::ElementsAre(0u, 8u));
    EXPECT_THAT(addresses("scene/activate"),
                testing::ElementsAre(0u, 8u, 16u, 24u, 32u, 40u, 48u, 56u, 64u, 72u, 80u));
    for (const EmbeddedKernel& kernel : embedded_kernels())
        EXPECT_FALSE(list_pointers(kernel.words).empty()) << kernel.name;
}

}  // namespace
}  // namespace relidar::structure
