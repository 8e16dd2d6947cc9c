// SPDX-License-Identifier: Apache-2.0
// Adds a zero to every array index. The compiler does not know that the value is always
// zero, so it assumes that the index differs between lanes:
//   %lane_zero = LocalInvocationIndex & push.nothing.x & 255
//   %place = OpAccessChain %pointer %array %int_0 (%index + %lane_zero)
//
// The second line replaces `%index` with the sum. The result of the first line is zero
// because `nothing` is a multiple of 256 (relidar/base/kernel.glsl).

#include "gpu/spirv.hpp"

namespace relidar::gpu {

namespace {

class LaneIndexRewriter {
public:
    /// Word 3 of the header is the bound of all ids, so new ids start there.
    explicit LaneIndexRewriter(std::span<const std::uint32_t> words) : words_(words), next_(words[3]) {
        for_instructions(words, [&](std::uint32_t opcode, SpirvInstruction instruction) {
            collect_ids(opcode, instruction);
        });
        // The module declares no gl_LocalInvocationIndex, so the rewriter declares it.
        is_new_lane_ = lane_ == 0;
        for (std::uint32_t* id : {&input_pointer_, &private_pointer_, &push_pointer_, &zero_, &constant_0_,
                                  &constant_1_, &constant_255_})
            *id = next_++;
        if (is_new_lane_) lane_ = next_++;
    }

    std::vector<std::uint32_t> rewrite() {
        result_.assign(words_.begin(), words_.begin() + kHeaderWords);
        for_instructions(words_, [&](std::uint32_t opcode, SpirvInstruction instruction) {
            emit_edited(opcode, instruction);
        });
        result_[3] = next_;
        return result_;
    }

private:
    std::span<const std::uint32_t> words_;
    std::vector<std::uint32_t> result_;
    std::uint32_t next_, uint_ = 0, entry_ = 0, push_ = 0, lane_ = 0, block_ = 0, block_pointer_ = 0;
    std::uint32_t input_pointer_ = 0, private_pointer_ = 0, push_pointer_ = 0, zero_ = 0, constant_0_ = 0,
                  constant_1_ = 0, constant_255_ = 0;
    /// Ids of types that are pointers to device memory, and ids of values that contain
    /// the address of the parameter block.
    std::set<std::uint32_t> storage_pointers_, parameters_;
    bool is_new_lane_ = false, decorated_ = false, declared_ = false, in_entry_ = false, filled_ = false;

    /// Collects the ids of the declarations that the new instructions refer to.
    void collect_ids(std::uint32_t opcode, SpirvInstruction instruction) {
        if (is_parameter_block_name(opcode, instruction)) block_ = instruction[1];
        if (opcode == kOpEntryPoint) entry_ = instruction[2];
        if (opcode == kOpTypeInt && instruction[2] == 32 && instruction[3] == 0) uint_ = instruction[1];
        if (opcode == kOpTypePointer && instruction[2] == kPhysicalStorage)
            storage_pointers_.insert(instruction[1]);
        if (opcode == kOpTypePointer && instruction[2] == kPhysicalStorage && instruction[3] == block_)
            block_pointer_ = instruction[1];
        if (opcode == kOpVariable && instruction[3] == kPushConstant) push_ = instruction[2];
        if (opcode == kOpDecorate && instruction[2] == kBuiltIn && instruction[3] == kLocalInvocationIndex)
            lane_ = instruction[1];
        if (opcode == kOpLoad && instruction[1] == block_pointer_) parameters_.insert(instruction[2]);
    }

    void emit(std::uint32_t opcode, std::initializer_list<std::uint32_t> operands) {
        append_instruction(result_, opcode, operands);
    }

    void emit_types() {
        emit(kOpTypePointer, {input_pointer_, kInput, uint_});
        emit(kOpTypePointer, {private_pointer_, kPrivateStorage, uint_});
        emit(kOpTypePointer, {push_pointer_, kPushConstant, uint_});
        emit(kOpConstant, {uint_, constant_0_, 0});
        emit(kOpConstant, {uint_, constant_1_, 1});
        emit(kOpConstant, {uint_, constant_255_, 255});
        emit(kOpVariable, {private_pointer_, zero_, kPrivateStorage});
        if (is_new_lane_) emit(kOpVariable, {input_pointer_, lane_, kInput});
    }

    /// Stores LocalInvocationIndex & push.nothing.x & 255 in the private variable
    /// `zero_`. The value is always 0, but the compiler does not know this.
    void emit_zero() {
        const std::uint32_t member_pointer = next_, nothing = next_ + 1, low = next_ + 2, lane = next_ + 3,
                            value = next_ + 4;
        next_ += 5;
        // The low word (component 0) of push.nothing (member 1).
        emit(kOpAccessChain, {push_pointer_, member_pointer, push_, constant_1_, constant_0_});
        emit(kOpLoad, {uint_, nothing, member_pointer});
        emit(kOpBitwiseAnd, {uint_, low, nothing, constant_255_});
        emit(kOpLoad, {uint_, lane, lane_});
        emit(kOpBitwiseAnd, {uint_, value, lane, low});
        emit(kOpStore, {zero_, value});
    }

    /// Writes one instruction to the result, with the declarations that belong before it.
    /// Adds the zero to the index of an access to device memory. The words of such an
    /// OpAccessChain are: 1 type, 2 result, 3 pointer, 4 member 0 (the array), 5 index.
    void emit_edited(std::uint32_t opcode, SpirvInstruction instruction) {
        if (opcode == kOpDecorate && !decorated_) {
            if (is_new_lane_) emit(kOpDecorate, {lane_, kBuiltIn, kLocalInvocationIndex});
            decorated_ = true;
        }
        if (opcode == kOpFunction && !declared_) {
            emit_types();
            declared_ = true;
        }
        in_entry_ = in_entry_ || (opcode == kOpFunction && instruction[2] == entry_);
        if (in_entry_ && !filled_ && !is_function_head(opcode)) {
            emit_zero();
            filled_ = true;
        }
        const std::size_t start = result_.size();  // of this instruction
        if (opcode == kOpAccessChain && instruction.size() >= 6 &&
            storage_pointers_.contains(instruction[1]) && !parameters_.contains(instruction[3])) {
            const std::uint32_t zero = next_++, index = next_++;
            emit(kOpLoad, {uint_, zero, zero_});
            emit(kOpIAdd, {uint_, index, instruction[5], zero});
            append_instruction(result_, instruction);
            result_[result_.size() - instruction.size() + 5] = index;
            return;
        }
        append_instruction(result_, instruction);
        if (opcode != kOpEntryPoint) return;
        // The interface of an entry point must list all variables that it uses.
        result_.push_back(zero_);
        if (is_new_lane_) result_.push_back(lane_);
        result_[start] = std::uint32_t(result_.size() - start) << 16 | kOpEntryPoint;
    }
};

}  // namespace

SpirvWords make_nonuniform(std::span<const std::uint32_t> words) {
    return LaneIndexRewriter(words).rewrite();
}

}  // namespace relidar::gpu
