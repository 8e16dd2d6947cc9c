// SPDX-License-Identifier: Apache-2.0
// Kernels must exchange values between threads only through coherent accesses. On some
// GPUs, each compute unit has a separate cache, so that a value that a subgroup stores is
// visible to a different subgroup only if both accesses are coherent, even with barriers.
#include <map>
#include <set>
#include <span>
#include <string>
#include <vector>

#include <gmock/gmock.h>

#include "exchange_coherent.h"
#include "exchange_incoherent.h"
#include "gpu/kernel.hpp"
#include "gpu/spirv.hpp"

namespace relidar::structure {
namespace {

using namespace gpu;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::UnorderedElementsAreArray;

/// Parameter member from which an instruction's result was loaded, and whether the access
/// is coherent.
struct Origin {
    /// Name of the member, such as "keys" or "wide.order". Empty if the origin is no
    /// member.
    std::string member;
    /// true if the result is in the array, false if it is the pointer to the array
    bool in_array = false;
    bool coherent = false;
    /// true if the result is the pointer to the parameter block, or the location of this
    /// pointer in the push constants
    bool parameters = false;
};

struct Accesses {
    bool loaded = false;
    bool stored = false;
    bool coherent = true;  ///< true if all accesses are coherent
};

class ExchangeReader {
public:
    /// @return members that a kernel with a barrier loads and stores, with at least one
    /// access that is not coherent
    std::vector<std::string> read(std::span<const std::uint32_t> words) {
        for_instructions(words,
                         [&](std::uint32_t opcode, SpirvInstruction i) { visit(opcode, i.subspan(1)); });
        std::vector<std::string> result;
        for (const auto& [member, a] : accesses_)
            if (barrier_ && a.loaded && a.stored && !a.coherent) result.push_back(member);
        return result;
    }

private:
    std::map<std::uint32_t, std::string> names_;
    std::map<std::uint32_t, std::map<std::uint32_t, std::string>> member_names_;
    std::set<std::uint32_t> coherent_structs_;
    /// type -> storage class, pointee
    std::map<std::uint32_t, std::pair<std::uint32_t, std::uint32_t>> pointers_;
    std::map<std::uint32_t, std::uint32_t> constants_;
    std::map<std::uint32_t, std::uint32_t> type_of_;
    std::map<std::uint32_t, std::vector<std::uint32_t>> struct_members_;
    std::map<std::uint32_t, Origin> origins_;
    std::map<std::string, Accesses> accesses_;
    bool barrier_ = false;

    bool is_pointer_to_coherent(std::uint32_t type) const {
        const auto p = pointers_.find(type);
        return p != pointers_.end() && p->second.first == kPhysicalStorage &&
               coherent_structs_.count(p->second.second);
    }

    void chain(std::span<const std::uint32_t> operands) {
        Origin from = origins_[operands[2]];
        if (names_[operands[2]] == "push") {
            from.parameters = true;
        } else if (from.parameters) {
            from.parameters = false;
            std::uint32_t type = pointers_[type_of_[operands[2]]].second;
            for (std::size_t k = 3; k < operands.size(); ++k) {
                const std::uint32_t index = constants_[operands[k]];
                // the first member is `value`
                if (k > 3) from.member += (from.member.empty() ? "" : ".") + member_names_[type][index];
                type = struct_members_[type].size() > index ? struct_members_[type][index] : 0;
            }
        } else if (!from.member.empty()) {
            from.in_array = true;
        }
        origins_[operands[1]] = from;
    }

    void access(std::uint32_t pointer, bool store) {
        const Origin& from = origins_[pointer];
        if (!from.in_array) return;
        Accesses& a = accesses_[from.member];
        (store ? a.stored : a.loaded) = true;
        a.coherent = a.coherent && from.coherent;
    }

    void visit(std::uint32_t code, std::span<const std::uint32_t> operands) {
        switch (code) {
            case kOpName: names_[operands[0]] = read_spirv_string(operands.subspan(1)); break;
            case kOpMemberName:
                member_names_[operands[0]][operands[1]] = read_spirv_string(operands.subspan(2));
                break;
            case kOpMemberDecorate:
                if (operands[2] == kCoherent) coherent_structs_.insert(operands[0]);
                break;
            case kOpTypeStruct:
                struct_members_[operands[0]].assign(operands.begin() + 1, operands.end());
                break;
            case kOpTypePointer: pointers_[operands[0]] = {operands[1], operands[2]}; break;
            case kOpConstant: constants_[operands[1]] = operands[2]; break;
            case kOpVariable: type_of_[operands[1]] = operands[0]; break;
            case kOpAccessChain: chain(operands); break;
            case kOpLoad:
                access(operands[2], false);
                type_of_[operands[1]] = operands[0];
                origins_[operands[1]] = origins_[operands[2]];
                origins_[operands[1]].in_array = false;
                origins_[operands[1]].coherent = is_pointer_to_coherent(operands[0]);
                break;
            case kOpBitcast:  // converts a pointer to a different type, through uvec2
                origins_[operands[1]] = origins_[operands[2]];
                origins_[operands[1]].coherent = is_pointer_to_coherent(operands[0]);
                break;
            case kOpStore: access(operands[0], true); break;
            case kOpControlBarrier:
            case kOpMemoryBarrier: barrier_ = true; break;
            default: break;
        }
    }
};

std::vector<std::string> find_incoherent_exchanges(std::span<const std::uint32_t> words) {
    return ExchangeReader().read(words);
}

TEST(Exchange, AccessesThatACacheMayAnswerAreFound) {
    EXPECT_THAT(find_incoherent_exchanges(exchange_incoherent), ElementsAre("keys"));
}
TEST(Exchange, CoherentOnesAreRight) { EXPECT_THAT(find_incoherent_exchanges(exchange_coherent), IsEmpty()); }

/// Kernels that have barriers but exchange no values. Each thread updates only its
/// elements. forward/sort_hits loads all values before its barriers and stores them after
/// its barriers.
struct OwnElements {
    const char* kernel;
    std::vector<std::string> members;
};
const OwnElements kOwnElements[] = {{"diff/accel/bvh_wide_scan", {"tiles"}},
                                    {"diff/forward/sort_hits", {"lists.hits"}},
                                    {"diff/loss/likelihood_loss", {"upstream"}},
                                    {"diff/loss/surfel_loss", {"d_surfels.mean"}},
                                    {"diff/network/conv", {"to.values"}}};

TEST(Exchange, NoKernelDoesSo) {
    for (const EmbeddedKernel& kernel : embedded_kernels()) {
        std::vector<std::string> allowed_members;
        for (const OwnElements& allowed : kOwnElements)
            if (kernel.name.substr(0, kernel.name.find('@')) == allowed.kernel)
                allowed_members = allowed.members;
        EXPECT_THAT(find_incoherent_exchanges(kernel.words), UnorderedElementsAreArray(allowed_members))
            << kernel.name
            << ": an exchange needs coherent accesses (diff/accel/bvh_forest.glsl); own elements a line in "
               "kOwnElements";
    }
}

}  // namespace
}  // namespace relidar::structure
