// SPDX-License-Identifier: Apache-2.0
// Finds the device addresses in the parameter block of a kernel, using the types in the
// SPIR-V module.

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
            default:
                for (std::uint32_t k = 0; k + 2 < t.size(); ++k)
                    append_pointers(t[k + 2], offset + offsets_.at({type_id, k}), offsets);
        }
    }

private:
    std::uint32_t block_ = 0;
    std::map<std::uint32_t, SpirvInstruction> types_;  ///< Pointer, array and struct types.
    std::map<std::uint32_t, std::uint32_t> constants_, strides_;
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> offsets_;

    void store_type(std::uint32_t opcode, SpirvInstruction instruction) {
        if (is_parameter_block_name(opcode, instruction)) block_ = instruction[1];
        if (opcode == kOpTypePointer || opcode == kOpTypeArray || opcode == kOpTypeStruct)
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

}  // namespace relidar::gpu
