// SPDX-License-Identifier: Apache-2.0
// Reports arrays through which the threads of a launch exchange values. On some GPUs,
// each compute unit has a separate cache. On such a GPU, a value that a subgroup stores
// is visible to a different subgroup only if both accesses are coherent, even with
// barriers. The functions read a compiled kernel and return the parameter members that it
// loads and stores, with a barrier in the kernel but without coherent accesses.
#pragma once

#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <string>
#include <vector>

#include "spirv_layout.hpp"

namespace relidar::structure {

namespace spirv_detail {

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
    /// Reads a compiled kernel.
    /// @return members that a kernel with a barrier loads and stores, with at least one
    /// access that is not coherent
    std::vector<std::string> read(std::span<const std::uint32_t> words) {
        for (std::size_t at = kHeaderWords; at < words.size(); at += words[at] >> 16) {
            if (words[at] >> 16 == 0) throw std::runtime_error("reading SPIR-V: an instruction of no words");
            visit(words[at] & 0xffffu, words.subspan(at + 1, (words[at] >> 16) - 1));
        }
        std::vector<std::string> result;
        for (const auto& [member, a] : accesses_)
            if (barrier_ && a.loaded && a.stored && !a.coherent) result.push_back(member);
        return result;
    }

private:
    enum Code : std::uint32_t {
        Name = 5,
        MemberName = 6,
        TypePointer = 32,
        Constant = 43,
        Variable = 59,
        Load = 61,
        Store = 62,
        AccessChain = 65,
        MemberDecorate = 72,
        Bitcast = 124,
        ControlBarrier = 224,
        MemoryBarrier = 225
    };
    static constexpr std::uint32_t kCoherent = 23, kPhysicalStorage = 5349;

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
            case Name:
                names_[operands[0]] = read_string(operands.subspan(1));
                break;
            case MemberName:
                member_names_[operands[0]][operands[1]] = read_string(operands.subspan(2));
                break;
            case MemberDecorate:
                if (operands[2] == kCoherent) coherent_structs_.insert(operands[0]);
                break;
            case OpTypeStruct:
                struct_members_[operands[0]].assign(operands.begin() + 1, operands.end());
                break;
            case TypePointer:
                pointers_[operands[0]] = {operands[1], operands[2]};
                break;
            case Constant:
                constants_[operands[1]] = operands[2];
                break;
            case Variable:
                type_of_[operands[1]] = operands[0];
                break;
            case AccessChain:
                chain(operands);
                break;
            case Load:
                access(operands[2], false);
                type_of_[operands[1]] = operands[0];
                origins_[operands[1]] = origins_[operands[2]];
                origins_[operands[1]].in_array = false;
                origins_[operands[1]].coherent = is_pointer_to_coherent(operands[0]);
                break;
            case Bitcast:  // converts a pointer to a different type, through uvec2
                origins_[operands[1]] = origins_[operands[2]];
                origins_[operands[1]].coherent = is_pointer_to_coherent(operands[0]);
                break;
            case Store:
                access(operands[0], true);
                break;
            case ControlBarrier:
            case MemoryBarrier:
                barrier_ = true;
                break;
            default:
                break;
        }
    }
};

}  // namespace spirv_detail

/// Returns the parameter members through which a kernel exchanges values between its
/// threads without coherent accesses.
inline std::vector<std::string> find_incoherent_exchanges(std::span<const std::uint32_t> words) {
    return spirv_detail::ExchangeReader().read(words);
}

}  // namespace relidar::structure
