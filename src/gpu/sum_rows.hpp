// SPDX-License-Identifier: Apache-2.0
// Sums of the rows of an array, the same in every run (gpu/sum_rows).
#pragma once

#include "gpu/kernel.hpp"
#include "shared/gpu.h"

namespace relidar {

class SumRows {
public:
    /// @param most  rows of the longest array @param width  columns
    SumRows(Device& device, std::uint32_t most, std::uint32_t width);
    std::uint32_t most() const { return most_; }
    /// sums[column] += sum over rows[n,width]
    void add(Stream& stream, std::uint64_t rows, std::uint32_t n, std::uint64_t sums);

private:
    std::uint32_t most_, width_;
    Array<float> blocks_;
    Kernel<shared::SumRowsParams> kernel_;
};

}  // namespace relidar
