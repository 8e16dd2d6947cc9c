// SPDX-License-Identifier: Apache-2.0
// Reads the member offsets of structs in a compiled shader, so that tests can compare
// them with offsetof on the host. Also reads the required capabilities. Uses only
// OpCapability, OpName, OpMemberName, OpMemberDecorate Offset and OpTypeStruct of a
// SPIR-V module.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <set>
#include <span>
#include <stdexcept>
#include <string>
#include <vector>

namespace relidar::structure {

/// Member name -> offset in bytes.
using StructLayout = std::map<std::string, std::uint32_t>;

namespace spirv_detail {

constexpr std::uint32_t kMagic = 0x07230203u;
constexpr std::size_t kHeaderWords = 5;
enum Opcode : std::uint32_t {
    OpName = 5,
    OpMemberName = 6,
    OpCapability = 17,
    OpTypeStruct = 30,
    OpMemberDecorate = 72
};
constexpr std::uint32_t kDecorationOffset = 35;

/// Calls read(opcode, operands) for each instruction of a module.
template <class Read>
void for_each_instruction(std::span<const std::uint32_t> words, Read read) {
    if (words.size() < kHeaderWords || words[0] != kMagic)
        throw std::runtime_error("reading SPIR-V: no magic number");
    for (std::size_t at = kHeaderWords; at < words.size();) {
        const std::size_t n_words = words[at] >> 16;
        if (n_words == 0 || at + n_words > words.size())
            throw std::runtime_error("reading SPIR-V: the module is cut");
        read(words[at] & 0xffffu, words.subspan(at + 1, n_words - 1));
        at += n_words;
    }
}

/// Reads a literal string, which is stored as little-endian bytes in words and ends with
/// a zero byte.
inline std::string read_string(std::span<const std::uint32_t> words) {
    std::string text;
    for (const std::uint32_t word : words) {
        for (int byte = 0; byte < 4; ++byte) {
            const char c = static_cast<char>((word >> (8 * byte)) & 0xffu);
            if (c == '\0') return text;
            text += c;
        }
    }
    throw std::runtime_error("reading SPIR-V: a name has no end");
}

/// Declaration of a struct type in a module.
struct Struct {
    std::string name;
    std::size_t n_members = 0;
    std::map<std::uint32_t, std::string> member_name;
    std::map<std::uint32_t, std::uint32_t> member_offset;
};

inline void read_instruction(std::uint32_t opcode, std::span<const std::uint32_t> operands,
                             std::map<std::uint32_t, Struct>& structs) {
    const auto need = [&](std::size_t count) {
        if (operands.size() < count) throw std::runtime_error("reading SPIR-V: an instruction is too short");
    };
    if (opcode == OpName) {
        need(2);
        structs[operands[0]].name = read_string(operands.subspan(1));
    } else if (opcode == OpMemberName) {
        need(3);
        structs[operands[0]].member_name[operands[1]] = read_string(operands.subspan(2));
    } else if (opcode == OpMemberDecorate) {
        need(3);
        if (operands[2] != kDecorationOffset) return;
        need(4);
        structs[operands[0]].member_offset[operands[1]] = operands[3];
    } else if (opcode == OpTypeStruct) {
        need(1);
        structs[operands[0]].n_members = operands.size() - 1;
    }
}

}  // namespace spirv_detail

/// Returns the layouts of the structs with offsets in a module, by their names in the
/// source. glslang emits a second, undecorated copy of a struct that is used as a local
/// variable. These copies are omitted.
/// @param words [n] the module, host byte order
/// @throws std::runtime_error if the module is not SPIR-V, is truncated, or contains two
/// layouts of the same struct
inline std::map<std::string, StructLayout> read_spirv_layouts(std::span<const std::uint32_t> words) {
    using namespace spirv_detail;
    std::map<std::uint32_t, Struct> structs;
    for_each_instruction(words, [&](std::uint32_t opcode, std::span<const std::uint32_t> operands) {
        read_instruction(opcode, operands, structs);
    });
    std::map<std::string, StructLayout> layouts;
    for (const auto& [id, type] : structs) {
        if (type.n_members == 0 || type.member_offset.size() != type.n_members) continue;
        StructLayout layout;
        for (const auto& [member, offset] : type.member_offset) {
            const auto name = type.member_name.find(member);
            layout[name == type.member_name.end() ? "#" + std::to_string(member) : name->second] = offset;
        }
        const auto [known, is_new] = layouts.emplace(type.name, layout);
        if (!is_new && known->second != layout)
            throw std::runtime_error("reading SPIR-V: two layouts of struct " + type.name);
    }
    return layouts;
}

constexpr std::uint32_t kCapabilityInt64 = 11;

/// Returns the capabilities that a module declares, with the numbers of the SPIR-V
/// specification.
inline std::set<std::uint32_t> read_spirv_capabilities(std::span<const std::uint32_t> words) {
    std::set<std::uint32_t> capabilities;
    spirv_detail::for_each_instruction(words,
                                       [&](std::uint32_t opcode, std::span<const std::uint32_t> operands) {
                                           if (opcode == spirv_detail::OpCapability && !operands.empty())
                                               capabilities.insert(operands[0]);
                                       });
    return capabilities;
}

}  // namespace relidar::structure
