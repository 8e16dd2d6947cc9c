// SPDX-License-Identifier: Apache-2.0
// Finds the device addresses in the parameter block of a kernel, and the size of the
// block, using the types in the SPIR-V module. Checks modules of programs.

#include <algorithm>

#include "base/fail.hpp"
#include "gpu/spirv.hpp"
#include "gpu/spirv_words.hpp"

namespace relidar::gpu {

namespace {

class ParameterTypes {
public:
    explicit ParameterTypes(std::span<const std::uint32_t> words) {
        for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
            store_type(opcode, instruction);
        });
    }

    std::uint32_t block_type() const { return block_; }

    /// Byte offsets of all device addresses in a value at `offset`.
    void append_pointers(std::uint32_t type_id, std::uint32_t offset,
                         std::vector<std::uint32_t>& offsets) const {
        const auto type_entry = types_.find(type_id);
        if (type_entry == types_.end()) return;
        const SpirvInstruction t = type_entry->second;
        switch (t[0] & 0xffffu) {
            case kOpTypePointer: offsets.push_back(offset); break;
            case kOpTypeArray:
                for (std::uint32_t k = 0; k < constants_.at(t[3]); ++k)
                    append_pointers(t[2], offset + k * strides_.at(type_id), offsets);
                break;
            case kOpTypeStruct:
                for (std::uint32_t k = 0; k + 2 < t.size(); ++k)
                    append_pointers(t[k + 2], offset + offsets_.at({type_id, k}), offsets);
                break;
            default: break;
        }
    }

    struct Extent {
        std::uint32_t size = 0, alignment = 0;  ///< In bytes. 0 for a type that C++ cannot share.
    };
    /// Returns the extent of a type in the scalar block layout, which equals that of C++.
    Extent find_extent(std::uint32_t type_id) const {
        const auto type_entry = types_.find(type_id);
        if (type_entry == types_.end()) return {};
        const SpirvInstruction t = type_entry->second;
        switch (t[0] & 0xffffu) {
            case kOpTypeInt:
            case kOpTypeFloat: return {t[2] / 8, t[2] / 8};
            case kOpTypePointer: return {8, 8};
            case kOpTypeVector: {
                const Extent component = find_extent(t[2]);
                return {t[3] * component.size, component.alignment};
            }
            case kOpTypeArray: {
                const auto n = constants_.find(t[3]), stride = strides_.find(type_id);
                if (n == constants_.end() || stride == strides_.end()) return {};
                return {n->second * stride->second, find_extent(t[2]).alignment};
            }
            case kOpTypeStruct: return find_struct_extent(type_id, t);
            default: return {};
        }
    }

private:
    std::uint32_t block_ = 0;
    std::map<std::uint32_t, SpirvInstruction> types_;  ///< Pointer, array and struct types.
    std::map<std::uint32_t, std::uint32_t> constants_, strides_;
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> offsets_;

    Extent find_struct_extent(std::uint32_t type_id, SpirvInstruction type) const {
        Extent extent;
        for (std::uint32_t k = 0; k + 2 < type.size(); ++k) {
            const Extent member = find_extent(type[k + 2]);
            const auto offset = offsets_.find({type_id, k});
            if (member.alignment == 0 || offset == offsets_.end()) return {};
            extent.size = std::max(extent.size, offset->second + member.size);
            extent.alignment = std::max(extent.alignment, member.alignment);
        }
        if (extent.alignment == 0) return {};
        extent.size = (extent.size + extent.alignment - 1) / extent.alignment * extent.alignment;
        return extent;
    }
    void store_type(std::uint32_t opcode, SpirvInstruction instruction) {
        if (is_parameter_block_name(opcode, instruction)) block_ = instruction[1];
        if (opcode == kOpTypeInt || opcode == kOpTypeFloat || opcode == kOpTypeVector ||
            opcode == kOpTypePointer || opcode == kOpTypeArray || opcode == kOpTypeStruct)
            types_[instruction[1]] = instruction;
        if (opcode == kOpConstant) constants_[instruction[2]] = instruction[3];
        if (opcode == kOpDecorate && instruction[2] == kArrayStride)
            strides_[instruction[1]] = instruction[3];
        if (opcode == kOpMemberDecorate && instruction[3] == kOffset)
            offsets_[{instruction[1], instruction[2]}] = instruction[4];
    }
};

}  // namespace

SpirvWords list_pointers(std::span<const std::uint32_t> words) {
    const ParameterTypes types(words);
    std::vector<std::uint32_t> offsets;
    types.append_pointers(types.block_type(), 0, offsets);
    return offsets;
}

std::uint32_t find_params_size(std::span<const std::uint32_t> words) {
    const ParameterTypes types(words);
    return types.find_extent(types.block_type()).size;
}

void check_module(std::span<const std::uint32_t> words, const std::string& kernel_name,
                  std::size_t params_bytes) {
    constexpr std::uint32_t kMagic = 0x07230203, kMaxVersion = 0x00010600, kComputeModel = 5;
    const std::string doing = fmt::format("cannot load the kernel {}", kernel_name);
    if (words.size() < kHeaderWords || words[0] != kMagic)
        fail("{}: found {} words that begin with {:#010x}, expected a SPIR-V module ({:#010x})", doing,
             words.size(), words.empty() ? 0u : words[0], kMagic);
    if (words[1] > kMaxVersion)
        fail("{}: found SPIR-V {}.{}, expected at most 1.6 (Vulkan 1.3)", doing, words[1] >> 16,
             (words[1] >> 8) & 0xffu);
    for (std::size_t at = kHeaderWords; at < words.size(); at += words[at] >> 16)
        if (const std::size_t n = words[at] >> 16; n == 0 || n > words.size() - at)
            fail("{}: the instruction at word {} has {} words, but the module has only {} words", doing, at,
                 n, words.size());
    bool has_main = false, has_bindings = false;
    std::uint32_t last_opcode = 0;
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        last_opcode = opcode;
        has_main = has_main ||
                   (opcode == kOpEntryPoint && instruction.size() > 4 && instruction[1] == kComputeModel &&
                    std::string_view(read_spirv_string(instruction.subspan(3))) == "main");
        has_bindings =
            has_bindings || (opcode == kOpDecorate && instruction.size() > 2 && instruction[2] == kBinding);
    });
    if (last_opcode != kOpFunctionEnd)
        fail("{}: the module ends with instruction {}, expected the end of a function", doing, last_opcode);
    if (!has_main) fail("{}: the module has no compute entry point main()", doing);
    if (has_bindings)
        fail("{}: the module has variables with a binding, expected only buffer references in its parameters",
             doing);
    if (!list_constants(words).contains(0))
        fail(
            "{}: the workgroup size is not the specialisation constant 0, expected that the source includes "
            "relidar/base/kernel.glsl",
            doing);
    const std::uint32_t size = find_params_size(words);
    if (size == 0)
        fail(
            "{}: the module has no parameter struct, expected RELIDAR_PARAMS(...) with numbers, vectors, "
            "arrays and buffer references, and a module with names",
            doing);
    if (size != params_bytes)
        fail<UsageError>("{}: its parameter struct has {} bytes, but that of the program has {} bytes", doing,
                         size, params_bytes);
}

}  // namespace relidar::gpu
