// SPDX-License-Identifier: Apache-2.0
// Reads the parameters of a kernel once at its start. Loads through the address in the
// push constant become loads of private variables, which the entry point fills first.
// Recognises code as glslang writes it without optimisation:
//
//   %chain = OpAccessChain %address_in_push %push %int_0
//   %block = OpLoad %pointer_to_block %chain
//   %place = OpAccessChain %pointer %block %int_0 %int_k ...
//   %value = OpLoad %type %place Aligned n
#include <optional>

#include "gpu/spirv.hpp"

namespace relidar::gpu {

namespace {

// Position of a value in the parameter block, as member indices of nested structs.
using MemberPath = std::vector<std::uint32_t>;

struct SpirvModule {
    std::uint32_t bound = 0, block = 0, block_pointer = 0, int_type = 0;
    /// Pointer to the push constant with the address of the parameter block.
    SpirvWords push_chain;
    std::uint32_t entry = 0;
    std::map<std::uint32_t, SpirvWords> types;         ///< Types by id.
    std::map<std::uint32_t, std::uint32_t> constants;  ///< 32-bit integer constants by id.
    std::set<std::uint32_t> addresses;  ///< Ids that contain the address of the parameter block.
    std::map<std::uint32_t, MemberPath> parameter_paths;

    explicit SpirvModule(std::span<const std::uint32_t> words) : bound(words[3]) {
        for_instructions(
            words, [&](std::uint32_t opcode, SpirvInstruction instruction) { collect(opcode, instruction); });
    }

private:
    std::map<std::uint32_t, SpirvWords> chains_;

    void collect(std::uint32_t opcode, SpirvInstruction instruction) {
        if (is_parameter_block_name(opcode, instruction)) block = instruction[1];
        if (opcode == kOpEntryPoint) entry = instruction[2];
        // All OpType... instructions.
        if (opcode >= 19 && opcode <= 39)
            types[instruction[1]] = SpirvWords(instruction.begin(), instruction.end());
        if (opcode == kOpTypePointer && instruction[2] == kPhysicalStorage && instruction[3] == block)
            block_pointer = instruction[1];
        if (opcode == kOpTypeInt && instruction[2] == 32 && !int_type) int_type = instruction[1];
        // The lower half of the first word of an instruction is its opcode.
        if (opcode == kOpConstant && instruction.size() == 4 && types.contains(instruction[1]) &&
            (types.at(instruction[1])[0] & 0xffffu) == kOpTypeInt)
            constants[instruction[2]] = instruction[3];
        if (opcode == kOpAccessChain) store_path(instruction);
        // This instruction loads the address of the parameter block.
        if (opcode == kOpLoad && instruction[1] == block_pointer && block_pointer) {
            addresses.insert(instruction[2]);
            push_chain = chains_[instruction[3]];
        }
    }
    /// Stores the member indices of an access chain into the parameter block. Other
    /// chains are kept, because they may lead to the address in the push constant.
    void store_path(SpirvInstruction instruction) {
        if (!addresses.contains(instruction[3])) {
            chains_[instruction[2]] = SpirvWords(instruction.begin(), instruction.end());
            return;
        }
        MemberPath path;
        for (const std::uint32_t index : instruction.subspan(4)) {
            if (!constants.contains(index)) return;
            path.push_back(constants.at(index));
        }
        parameter_paths[instruction[2]] = path;
    }
};

class ParameterLoadHoister {
public:
    explicit ParameterLoadHoister(const SpirvModule& module) : module_(module), next_(module.bound) {}

    /// Returns true if a private variable can hold a parameter of this type: a number, a
    /// vector, an address, or a struct of these.
    bool is_copyable(std::uint32_t type_id) const {
        const SpirvWords& type = module_.types.at(type_id);
        if ((type[0] & 0xffffu) != kOpTypeStruct) return alignment_bytes(type_id).has_value();
        for (std::size_t k = 2; k < type.size(); ++k)
            if (!is_copyable(type[k])) return false;
        return true;
    }

    /// Appends instructions that load one parameter from its private variable. A struct
    /// is loaded member by member and then composed. The words of a struct type from
    /// index 2 are the types of its members.
    /// @param path member indices of the parameter
    /// @param result id of the loaded value
    void append_load(SpirvWords& instructions, std::uint32_t type_id, const MemberPath& path,
                     std::uint32_t result) {
        const SpirvWords& type = module_.types.at(type_id);
        if ((type[0] & 0xffffu) != kOpTypeStruct) {
            append_instruction(instructions, kOpLoad, {type_id, result, declare_private(type_id, path)});
            return;
        }
        SpirvWords construct{std::uint32_t(type.size() + 1) << 16 | kOpCompositeConstruct, type_id, result};
        for (std::size_t k = 2; k < type.size(); ++k) {
            MemberPath member = path;
            member.push_back(std::uint32_t(k - 2));
            construct.push_back(next_++);
            append_load(instructions, type[k], member, construct.back());
        }
        append_instruction(instructions, construct);
    }

    /// Adds the private variables, and at the start of the entry point the copies to
    /// them. New decorations precede the first decoration, as the order of SPIR-V
    /// requires. New types, constants and variables precede the first function.
    /// @param code all functions; they must load parameters from these variables
    SpirvWords make_module(std::span<const std::uint32_t> spirv_words, const SpirvWords& code) {
        const SpirvWords prologue = copy_parameters();
        SpirvWords result(spirv_words.begin(), spirv_words.begin() + kHeaderWords);
        bool in_functions = false, has_decorations = false;
        for_instructions(spirv_words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
            if (opcode == kOpFunction && !in_functions) append_instruction(result, globals_);
            in_functions = in_functions || opcode == kOpFunction;
            if (in_functions) return;
            if (opcode == kOpDecorate && !has_decorations) append_instruction(result, decorations_);
            has_decorations = has_decorations || opcode == kOpDecorate;
            SpirvWords words(instruction.begin(), instruction.end());
            // The interface of an entry point must list all variables that it uses.
            if (opcode == kOpEntryPoint) {
                for (const auto& [path, v] : variables_) words.push_back(v.id);
                words[0] = std::uint32_t(words.size()) << 16 | kOpEntryPoint;
            }
            append_instruction(result, words);
        });
        append_functions(result, code, prologue);
        result[3] = next_;
        return result;
    }

private:
    struct PrivateVariable {
        std::uint32_t id, type;
    };
    const SpirvModule& module_;
    std::uint32_t next_;
    std::map<MemberPath, PrivateVariable> variables_;
    std::map<std::uint32_t, std::uint32_t> private_pointer_, storage_pointer_, index_;
    SpirvWords globals_, decorations_;

    /// Returns the alignment of a number, vector or address, and nullopt for other types.
    std::optional<std::uint32_t> alignment_bytes(std::uint32_t type_id) const {
        const SpirvWords& type = module_.types.at(type_id);
        switch (type[0] & 0xffffu) {
            case kOpTypeInt:
            case kOpTypeFloat: return type[2] / 8;
            case kOpTypeVector: return alignment_bytes(type[2]);
            case kOpTypePointer: return type[2] == kPhysicalStorage ? std::optional(8u) : std::nullopt;
            default: return std::nullopt;
        }
    }
    /// Returns the pointer type to `type_id` from `types`. Declares it at the first call.
    std::uint32_t declare_pointer(std::map<std::uint32_t, std::uint32_t>& types, std::uint32_t storage_class,
                                  std::uint32_t type_id) {
        const auto [at, is_new] = types.try_emplace(type_id, next_);
        if (is_new) append_instruction(globals_, kOpTypePointer, {next_++, storage_class, type_id});
        return at->second;
    }
    /// Returns a constant of the module with this value, or declares a new one.
    std::uint32_t declare_int(std::uint32_t value) {
        for (const auto& [id, known] : module_.constants)
            if (known == value) return id;
        const auto [at, is_new] = index_.try_emplace(value, next_);
        if (is_new) append_instruction(globals_, kOpConstant, {module_.int_type, next_++, value});
        return at->second;
    }
    /// Returns the private variable of a parameter. Declares it at the first call.
    std::uint32_t declare_private(std::uint32_t type_id, const MemberPath& path) {
        if (const auto existing_variable = variables_.find(path); existing_variable != variables_.end())
            return existing_variable->second.id;
        const std::uint32_t pointer_type = declare_pointer(private_pointer_, kPrivateStorage, type_id),
                            id = next_++;
        append_instruction(globals_, kOpVariable, {pointer_type, id, kPrivateStorage});
        // SPIR-V requires this decoration for variables that contain device addresses.
        if ((module_.types.at(type_id)[0] & 0xffffu) == kOpTypePointer)
            append_instruction(decorations_, kOpDecorate, {id, kAliasedPointer});
        variables_[path] = {id, type_id};
        return id;
    }
    /// Returns the prologue of the entry point. It loads each parameter from the block
    /// and stores it in its private variable.
    SpirvWords copy_parameters() {
        SpirvWords code, chain = module_.push_chain;
        const std::uint32_t block = next_ + 1;
        // Word 2 of an instruction is the id of its result.
        chain[2] = next_;
        append_instruction(code, chain);
        append_instruction(code, kOpLoad, {module_.block_pointer, block, chain[2]});
        next_ += 2;
        for (const auto& [path, v] : variables_) {
            const std::uint32_t to_storage = declare_pointer(storage_pointer_, kPhysicalStorage, v.type);
            // Reserves these ids first, because declare_int() also creates ids.
            const std::uint32_t at = next_++, value = next_++;
            SpirvWords access_chain{std::uint32_t(path.size() + 4) << 16 | kOpAccessChain, to_storage, at,
                                    block};
            for (const std::uint32_t member : path) access_chain.push_back(declare_int(member));
            append_instruction(code, access_chain);
            append_instruction(code, kOpLoad, {v.type, value, at, kAligned, *alignment_bytes(v.type)});
            append_instruction(code, kOpStore, {v.id, value});
        }
        return code;
    }
    /// Appends all functions. In the entry point, inserts `prologue` behind the variable
    /// declarations, where SPIR-V allows the first instruction.
    void append_functions(SpirvWords& module, const SpirvWords& code, const SpirvWords& prologue) const {
        bool in_entry = false, filled = false;
        for (std::size_t at = 0; at < code.size(); at += code[at] >> 16) {
            const std::uint32_t op = code[at] & 0xffffu;
            in_entry = in_entry || (op == kOpFunction && code[at + 2] == module_.entry);
            if (in_entry && !filled && !is_function_head(op)) {
                append_instruction(module, prologue);
                filled = true;
            }
            append_instruction(module, std::span(code).subspan(at, code[at] >> 16));
        }
    }
};

}  // namespace

/// Replaces loads of parameters in all functions by loads of private variables, to which
/// the entry point copies the parameters. Returns the module unchanged if it loads no
/// parameter that can be copied.
SpirvWords hoist_loads(std::span<const std::uint32_t> words) {
    const SpirvModule module(words);
    ParameterLoadHoister hoister(module);
    SpirvWords code;  // the edited functions
    bool in_functions = false, has_hoisted = false;
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        in_functions = in_functions || opcode == kOpFunction;
        if (!in_functions) return;  // make_module() copies the declarations before the functions
        // Words 1 to 3 of a load are its type, the id of its result, and the pointer.
        const auto parameter =
            opcode == kOpLoad ? module.parameter_paths.find(instruction[3]) : module.parameter_paths.end();
        if (parameter == module.parameter_paths.end() || !hoister.is_copyable(instruction[1])) {
            append_instruction(code, instruction);
            return;
        }
        const MemberPath& path = parameter->second;
        hoister.append_load(code, instruction[1], path, instruction[2]);
        has_hoisted = true;
    });
    return has_hoisted ? hoister.make_module(words, code) : SpirvWords(words.begin(), words.end());
}

}  // namespace relidar::gpu
