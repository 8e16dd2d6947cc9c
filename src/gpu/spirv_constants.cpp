// SPDX-License-Identifier: Apache-2.0
// Removes branches whose conditions depend only on specialisation constants. Evaluates
// the operations that our kernels use in conditions: 32-bit constants, equality and
// logical operators. Other conditions are left to the driver. Keeps a branch if its
// removal requires moving blocks.
#include <algorithm>
#include <optional>

#include "gpu/spirv.hpp"

namespace relidar::gpu {

namespace {

/// Integers and booleans (0 or 1) of a SPIR-V module that depend only on specialisation
/// constants.
class SpirvConstantValues {
public:
    explicit SpirvConstantValues(const SpirvConstants& constants) : constants_(constants) {}

    std::optional<std::uint32_t> find_value(std::uint32_t result) const {
        const auto match = value_by_id_.find(result);
        return match == value_by_id_.end() ? std::nullopt : std::optional(match->second);
    }

    /// Stores the value of an instruction if it is known. Must get the instructions of a
    /// module in their order.
    void evaluate(std::uint32_t opcode, SpirvInstruction instruction) {
        const auto has_type = [&] { return types_.contains(instruction[1]); };
        if (opcode == kOpTypeBool || (opcode == kOpTypeInt && instruction[2] == 32))
            types_.insert(instruction[1]);
        else if (opcode == kOpDecorate && instruction[2] == kSpecId)
            spec_ids_[instruction[1]] = instruction[3];
        else if (opcode == kOpConstantTrue) value_by_id_[instruction[2]] = 1;
        else if (opcode == kOpConstantFalse) value_by_id_[instruction[2]] = 0;
        else if ((opcode == kOpConstant || opcode == kOpSpecConstant) && has_type())
            value_by_id_[instruction[2]] = specialised(instruction);
        else if (opcode == kOpSpecConstantOp) fold(instruction, instruction[3], instruction.subspan(4));
        else if (opcode == kOpLogicalOr || opcode == kOpLogicalAnd || opcode == kOpLogicalNot)
            fold(instruction, opcode, instruction.subspan(3));
    }

private:
    const SpirvConstants& constants_;
    std::set<std::uint32_t> types_;
    std::map<std::uint32_t, std::uint32_t> spec_ids_, value_by_id_;

    /// Returns the value that replaces a specialisation constant, or its default value.
    std::uint32_t specialised(SpirvInstruction constant_instruction) const {
        const auto spec_id = spec_ids_.find(constant_instruction[2]);
        const auto override_value =
            spec_id == spec_ids_.end() ? constants_.end() : constants_.find(spec_id->second);
        return override_value == constants_.end() ? constant_instruction[3] : override_value->second;
    }

    void fold(SpirvInstruction instruction, std::uint32_t operation_opcode, SpirvInstruction operands) {
        if (!types_.contains(instruction[1])) return;
        if (const std::optional<std::uint32_t> value = evaluate_operation(operation_opcode, operands))
            value_by_id_[instruction[2]] = *value;
    }

    /// Returns the value of an instruction, or nothing if it depends on unknown
    /// operands. One known operand can decide `or` and `and`.
    std::optional<std::uint32_t> evaluate_operation(std::uint32_t operation,
                                                    SpirvInstruction operands) const {
        const std::optional<std::uint32_t> a = find_value(operands[0]),
                                           b = operands.size() > 1 ? find_value(operands[1]) : a;
        if (operation == kOpLogicalOr && (a == 1u || b == 1u)) return 1;
        if (operation == kOpLogicalAnd && (a == 0u || b == 0u)) return 0;
        if (!a || !b) return std::nullopt;
        if (operation == kOpLogicalOr) return *a | *b;
        if (operation == kOpLogicalAnd) return *a & *b;
        if (operation == kOpLogicalNot) return 1u - *a;
        if (operation == kOpIEqual) return *a == *b;
        if (operation == kOpINotEqual) return *a != *b;
        return std::nullopt;
    }
};

class ControlFlowGraph {
public:
    /// Collects the successors of each block. The id of a block is the id of its label.
    explicit ControlFlowGraph(std::span<const std::uint32_t> words) {
        std::uint32_t label = 0;
        for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
            if (opcode == kOpLabel) label = instruction[1];
            else if (opcode == kOpPhi) with_phi_.insert(label);
            // Words 1 and 2 are the block after the loop and the continue block.
            else if (opcode == kOpLoopMerge)
                for (const std::size_t word : {1u, 2u}) header_of_[instruction[word]] = label;
            else if (opcode == kOpBranch) next_[label] = {instruction[1]};
            else if (opcode == kOpBranchConditional) next_[label] = {instruction[2], instruction[3]};
            // Words 2, 4, 6 ... are targets: the default, then one after each literal.
            else if (opcode == kOpSwitch)
                for (std::size_t word = 2; word < instruction.size(); word += 2)
                    next_[label].push_back(instruction[word]);
        });
    }

    /// Returns true if the branch from `from` to `to` can be removed. If it leads
    /// directly to the merge block, the merge block must not have a phi instruction.
    /// Otherwise, the blocks behind the branch become unreachable. They must not lead
    /// back to `from`, and must not end or continue a loop that starts before them.
    /// @param merge block in which both paths of the branch join
    bool can_remove(std::uint32_t from, std::uint32_t to, std::uint32_t merge) const {
        if (to == merge) return !with_phi_.contains(merge);
        std::set<std::uint32_t> behind = {to};
        std::vector<std::uint32_t> open = {to};  // blocks whose successors are not visited yet
        while (!open.empty()) {
            const auto next = next_.find(open.back());
            open.pop_back();
            if (next == next_.end()) continue;  // A block without a successor returns from the function.
            for (const std::uint32_t block : next->second)
                if (block != merge && behind.insert(block).second) open.push_back(block);
        }
        return !behind.contains(from) && std::all_of(behind.begin(), behind.end(), [&](std::uint32_t block) {
            const auto header = header_of_.find(block);
            return header == header_of_.end() || behind.contains(header->second);
        });
    }

private:
    std::map<std::uint32_t, std::vector<std::uint32_t>> next_;
    /// Header block of each loop, by its merge block and its continue block.
    std::map<std::uint32_t, std::uint32_t> header_of_;
    std::set<std::uint32_t> with_phi_;
};

/// Returns the target that a conditional branch always takes. Returns nothing if its
/// condition is not known, or if the other target cannot be removed.
/// @param block,join_block blocks in which the branch is and in which both paths join
std::optional<std::uint32_t> find_only_target(SpirvInstruction branch, const SpirvConstantValues& values,
                                              const ControlFlowGraph& blocks, std::uint32_t block,
                                              std::uint32_t join_block) {
    const std::optional<std::uint32_t> condition = values.find_value(branch[1]);
    if (!condition) return std::nullopt;
    const std::uint32_t if_true = branch[2], if_false = branch[3];
    const std::uint32_t taken = *condition ? if_true : if_false, removed = *condition ? if_false : if_true;
    return blocks.can_remove(block, removed, join_block) ? std::optional(taken) : std::nullopt;
}

}  // namespace

/// Replaces conditional branches whose condition is known by unconditional ones. Also
/// removes the selection merge: the instruction before such a branch, which names the
/// block in which both paths join. Blocks that become unreachable stay in the module.
SpirvWords remove_branches(std::span<const std::uint32_t> words, const SpirvConstants& constants) {
    std::vector<std::uint32_t> result(words.begin(), words.begin() + kHeaderWords);
    SpirvConstantValues values(constants);
    const ControlFlowGraph blocks(words);
    std::uint32_t block = 0;     // id of the current block
    SpirvInstruction merge;      // the last instruction if it is a selection merge
    std::size_t last_start = 0;  // position of the last instruction in `result`
    for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
        values.evaluate(opcode, instruction);
        if (opcode == kOpLabel) block = instruction[1];
        std::optional<std::uint32_t> target;
        if (opcode == kOpBranchConditional && !merge.empty())
            target = find_only_target(instruction, values, blocks, block, merge[1]);
        if (target) {
            result.resize(last_start);  // removes the merge
            append_instruction(result, kOpBranch, {*target});
            merge = {};
            return;
        }
        merge = opcode == kOpSelectionMerge ? instruction : SpirvInstruction();
        last_start = result.size();
        append_instruction(result, instruction);
    });
    return result;
}

}  // namespace relidar::gpu
