// SPDX-License-Identifier: Apache-2.0
// Edits SPIR-V modules. The instructions of a module have a fixed order: capabilities,
// extensions, ..., entry points, execution modes, ... Finds the device addresses in the
// parameter block of a kernel, and the size of the block. Checks modules of programs.
#include "gpu/spirv.hpp"

#include <algorithm>
#include <cstring>

#include "base/fail.hpp"

namespace relidar::gpu {

/// Returns a copy of a module in which each entry point has an additional execution mode.
SpirvWords add_execution_mode(std::span<const std::uint32_t> words, const ExecutionMode& mode) {
    // The instruction OpExtension: number of words and opcode, then the name. The name
    // ends with a zero byte, which may need another word.
    const std::string_view extension_name = mode.extension;
    std::vector<std::uint32_t> extension_words(1 + extension_name.size() / 4 + 1, 0u);
    std::memcpy(extension_words.data() + 1, extension_name.data(), extension_name.size());
    extension_words[0] = static_cast<std::uint32_t>(extension_words.size()) << 16 | kOpExtension;

    std::vector<std::uint32_t> result(words.begin(), words.begin() + kHeaderWords);
    std::vector<std::uint32_t> modes;  // execution modes of the entry points so far
    bool is_extended = false;          // true after OpExtension was inserted
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        // Extensions follow the capabilities and precede all other instructions.
        if (!is_extended && opcode != kOpCapability && opcode != kOpExtension) {
            append_instruction(result, extension_words);
            is_extended = true;
        }
        if (opcode == kOpEntryPoint) {
            append_instruction(modes, kOpExecutionMode, {instruction[2], mode.mode});
        } else {  // Inserts the execution mode after the last entry point, as SPIR-V requires.
            append_instruction(result, modes);
            modes.clear();
        }
        append_instruction(result, instruction);
    });
    return result;
}

/// Decorates all members of a kernel's parameter block as NonWritable, so that the driver
/// can load them early. Each member has an OpMemberDecorate with its offset. The words of
/// this instruction are: 1 type, 2 member, 3 decoration.
SpirvWords mark_params_readonly(std::span<const std::uint32_t> words) {
    std::vector<std::uint32_t> result(words.begin(), words.begin() + kHeaderWords);
    std::uint32_t block = 0;  // Id of the type of the parameter block.
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        if (is_parameter_block_name(opcode, instruction)) block = instruction[1];
        append_instruction(result, instruction);
        if (opcode == kOpMemberDecorate && instruction[1] == block && instruction[3] == kOffset)
            append_instruction(result, kOpMemberDecorate, {block, instruction[2], kNonWritable});
    });
    return result;
}

std::set<std::uint32_t> list_constants(std::span<const std::uint32_t> words) {
    std::set<std::uint32_t> ids;
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        if (opcode == kOpDecorate && instruction[2] == kSpecId) ids.insert(instruction[3]);
    });
    return ids;
}

namespace {

class ParameterTypes {
public:
    explicit ParameterTypes(std::span<const std::uint32_t> words) {
        for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
            store_type(opcode, instruction);
        });
    }

    std::uint32_t block_type() const { return block_; }

    /// Appends the byte offsets of all device addresses in a value at `offset`. The words
    /// of an array type from index 2 are the element type and the id of the length. Those
    /// of a struct type are the member types.
    void append_pointers(std::uint32_t type_id, std::uint32_t offset,
                         std::vector<std::uint32_t>& offsets) const {
        const auto type_entry = types_.find(type_id);
        if (type_entry == types_.end()) return;
        const SpirvInstruction type = type_entry->second;
        switch (type[0] & 0xffffu) {
            case kOpTypePointer: offsets.push_back(offset); break;
            case kOpTypeArray:
                for (std::uint32_t k = 0; k < constants_.at(type[3]); ++k)
                    append_pointers(type[2], offset + k * strides_.at(type_id), offsets);
                break;
            case kOpTypeStruct:
                for (std::uint32_t k = 0; k + 2 < type.size(); ++k)
                    append_pointers(type[k + 2], offset + offsets_.at({type_id, k}), offsets);
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
        const SpirvInstruction type = type_entry->second;
        Extent extent;
        switch (type[0] & 0xffffu) {
            case kOpTypeInt:
            case kOpTypeFloat: return {type[2] / 8, type[2] / 8};
            case kOpTypePointer: return {8, 8};
            case kOpTypeVector:
                extent = find_extent(type[2]);
                return {type[3] * extent.size, extent.alignment};
            case kOpTypeArray:
                if (!constants_.contains(type[3]) || !strides_.contains(type_id)) return {};
                return {constants_.at(type[3]) * strides_.at(type_id), find_extent(type[2]).alignment};
            default: break;
        }
        for (std::uint32_t k = 0; k + 2 < type.size(); ++k) {
            const Extent member = find_extent(type[k + 2]);
            if (member.alignment == 0 || !offsets_.contains({type_id, k})) return {};
            extent.size = std::max(extent.size, offsets_.at({type_id, k}) + member.size);
            extent.alignment = std::max(extent.alignment, member.alignment);
        }
        if (extent.alignment > 0)
            extent.size += (extent.alignment - extent.size % extent.alignment) % extent.alignment;
        return extent;
    }

private:
    std::uint32_t block_ = 0;
    std::map<std::uint32_t, SpirvInstruction> types_;  ///< Pointer, array and struct types.
    std::map<std::uint32_t, std::uint32_t> constants_, strides_;
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> offsets_;

    /// Collects the types, array lengths (constants), array strides and member offsets
    /// that determine the layout of the parameter block.
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
    const auto require = [&](bool is_present, const char* part) {
        if (!is_present) fail("cannot load the kernel {}: found a module without {}", kernel_name, part);
    };
    require(words.size() >= kHeaderWords && words[0] == kMagic, "the magic number of SPIR-V");
    require(words[1] <= kMaxVersion, "a SPIR-V version up to 1.6 (Vulkan 1.3)");
    // The upper half of the first word of an instruction is its number of words, the
    // lower half its opcode.
    for (std::size_t at = kHeaderWords; at < words.size(); at += words[at] >> 16)
        require(words[at] >> 16 > 0 && words[at] >> 16 <= words.size() - at, "its last words (truncated)");
    // Words of OpEntryPoint: 1 execution model, 2 function, then the name. Words of
    // OpDecorate: 1 target, 2 decoration. A kernel gets all data through addresses, so it
    // must not have bindings.
    bool has_main = false, has_bindings = false;
    std::uint32_t last_opcode = 0;
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        last_opcode = opcode;
        if (opcode == kOpEntryPoint && instruction.size() > 4 && instruction[1] == kComputeModel)
            has_main = has_main || std::string_view(read_spirv_string(instruction.subspan(3))) == "main";
        if (opcode == kOpDecorate && instruction.size() > 2 && instruction[2] == kBinding)
            has_bindings = true;
    });
    require(last_opcode == kOpFunctionEnd, "a function at its end (truncated)");
    require(has_main, "a compute entry point main()");
    // Specialisation constant 0 is the workgroup size (relidar/base/kernel.glsl).
    require(!has_bindings && list_constants(words).contains(0), "the interface of relidar/base/kernel.glsl");
    const std::uint32_t size = find_params_size(words);
    require(size > 0, "names (OpName), or without RELIDAR_PARAMS that C++ can share");
    if (size != params_bytes)
        fail<UsageError>(
            "cannot load the kernel {}: its parameter struct has {} bytes, expected {} bytes as in the "
            "program",
            kernel_name, size, params_bytes);
}

}  // namespace relidar::gpu
